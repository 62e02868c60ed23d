"""Balls, joints that leave all turns about a point: where they are, and what acts in them, by the
relative rotation D = F_a^T F_b of their parts' axes F.

Each law acts by numbers C (3, 3) conjugate to D: the moment -M on b, and its opposite on a, with

    ~M = X - X^T        X = F_a C F_b^T, F the means of the axes over a step

As D is made of products of directors, this does the work -C : (D_{n+1} - D_n) over the step (see
`joints`), and keeps both momenta. With the rotation vector phi = f(c) y of `rotation_vector`:

    spring    V = phi K phi/2: P of y, Q of c, with P dy + Q dc = V_{n+1} - V_n exactly:
              P = (f_n + f_{n+1})/2 K (phi_n + phi_{n+1})/2
              Q = (phi_n + phi_{n+1})/2 K (y_n + y_{n+1})/2 (f_{n+1} - f_n)/(c_{n+1} - c_n)
              C = (~P + Q I)/2
    limit     V(beta) as of a hinge, of the angle beta by which the axis e swings, cos beta = e D e:
              C = (V_{n+1} - V_n)/(cos beta_{n+1} - cos beta_n) e e^T
    moments   m on a, in its axes, C = ~m (D_n + D_{n+1})/4, does the work -m . y of the step's turn
              E = D_{n+1} D_n^T:
              damping   c 2 y/((1 + c) dt), the Cayley vector of E
              friction  mu r/sqrt(|r|^2 + s^2) w, r = 2 phi(E)/dt - r_n at the end of the step
              torque    -tau w, where w = 1/cos(|phi(E)|/2)

so that each is that of a hinge where all turns are about one axis. At rest before and after are
one, and there is neither damping nor friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf, map_leaves
from ..math.quaternions import cross, skew
from .joint_laws import CoordinateStep, Losses, limit_slope
from .joint_motion import Pose
from .rotation_vector import Turn, arc, arc_slope, axial, changes


class BallStep(NamedTuple):
    """Relative rotations (..., B, 3, 3) before and after; dt (..., 1) s, None = at rest; spin of b
    against a before, or at an instant, and the torque that is given (..., B, 3), axes of a, None =
    none.
    """

    before: Tensor
    after: Tensor
    dt: Tensor | None = None
    spin: Tensor | None = None
    torque: Tensor | None = None


@dataclass(frozen=True)
class BallLaws(Losses):
    """Of balls (..., B, *), zero where one has none, None where none has one: see `Ball`."""

    stiffness: Tensor | None = leaf(3)
    damping: Tensor | None = leaf(1)
    friction: Tensor | None = leaf(1)
    slip_speed: Tensor | None = leaf(1)
    axis: Tensor | None = leaf(2)
    limit: Tensor | None = leaf(1)
    limit_stiffness: Tensor | None = leaf(1)

    def conjugate(self, step: BallStep, by: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """C (..., B, 3, 3), and its change by those of D after the step, by (..., B, n, 3, 3); at
        rest by those of D.
        """
        parts = [self._spring, self._limit, self._moments]
        conjugates = [x for part in parts if (x := part(step, by)) is not None]
        if not conjugates:
            zero = torch.zeros_like(step.after)
            return zero, None if by is None else torch.zeros_like(by)
        C = sum(x for x, _ in conjugates)
        return C, None if by is None else sum(x for _, x in conjugates)

    def _spring(self, step: BallStep, by: Tensor | None) -> tuple[Tensor, Tensor | None] | None:
        if self.stiffness is None:
            return None
        K, eye = self.stiffness, torch.eye(3, dtype=step.after.dtype, device=step.after.device)

        def times(v: Tensor) -> Tensor:
            return (K @ v[..., None])[..., 0]

        def conjugate(P: Tensor, Q: Tensor) -> Tensor:
            return (skew(P) + Q[..., None, None] * eye) / 2

        now, before = Turn.of(step.after), Turn.of(step.before)
        f, f_by, _ = arc(now.c)
        f_before = arc(before.c)[0]
        slope, slope_by = arc_slope(now.c, before.c)
        mean, y = (f + f_before) / 2, (now.y + before.y) / 2
        phi = (f[..., None] * now.y + f_before[..., None] * before.y) / 2
        push, pull = times(phi), times(y)
        along = (push * y).sum(-1)
        C = conjugate(mean[..., None] * push, along * slope)
        if by is None:
            return C, None
        dy, dc = changes(by)
        f, f_by, mean, slope, slope_by, along = (
            x[..., None] for x in (f, f_by, mean, slope, slope_by, along)
        )
        push, pull = push[..., None, :], pull[..., None, :]
        dphi = (f[..., None] * dy + (f_by * dc)[..., None] * now.y[..., None, :]) / 2
        dpush = (K[..., None, :, :] @ dphi[..., None])[..., 0]
        dP = (f_by * dc / 2)[..., None] * push + mean[..., None] * dpush
        dalong = (dphi * pull).sum(-1) + (push * dy).sum(-1) / 2
        twice = 2.0 if step.dt is None else 1.0  # at rest what is before changes as well
        return C, twice * conjugate(dP, dalong * slope + along * slope_by * dc)

    def _limit(self, step: BallStep, by: Tensor | None) -> tuple[Tensor, Tensor | None] | None:
        if self.limit_stiffness is None:
            return None
        e = self.axis
        line = e[..., :, None] * e[..., None, :]
        beta, before = (_swing(D, e) for D in (step.after, step.before))
        angles = torch.ones_like(beta, dtype=torch.bool)
        limit = torch.where(self.limit > 0, self.limit, torch.pi)
        slope, slope_by = limit_slope(beta, before, limit, self.limit_stiffness, 2 * limit)
        # (beta_{n+1} - beta_n)/(cos beta_{n+1} - cos beta_n) = -arc/sin of the mean
        ratio, ratio_by = CoordinateStep(before, beta, angles, None, None).arc()
        mean = (beta + before) / 2
        # where either is beyond the limit
        sine = torch.where(mean >= limit / 2, torch.sin(mean), 1.0)
        weight = -slope * ratio / sine
        C = weight[..., None, None] * line
        if by is None:
            return C, None
        weight_by = -(slope_by * ratio + slope * ratio_by) / sine + slope * ratio * torch.cos(
            mean
        ) / (2 * sine**2)
        own = torch.where(beta > 0, torch.sin(beta), 1.0)
        # d(beta) = -d(cos beta)/sin beta
        change = -(weight_by / own)[..., None] * (by * line[..., None, :, :]).sum((-1, -2))
        twice = 2.0 if step.dt is None else 1.0
        return C, twice * change[..., None, None] * line[..., None, :, :]

    def _moments(self, step: BallStep, by: Tensor | None) -> tuple[Tensor, Tensor | None] | None:
        if step.dt is None:
            return self._moments_at_rest(step, by)
        if not self.dissipative and step.torque is None:
            return None
        turn = Turn.of(step.after @ step.before.mT)
        dy, dc = (None, None) if by is None else changes(by @ step.before[..., None, :, :].mT)
        m, dm = 0.0, 0.0
        if self.damping is not None:
            rate = 2 * self.damping / (step.dt * (1 + turn.c))
            m = m + rate[..., None] * turn.y
            if by is not None:
                y, c = turn.y[..., None, :], (1 + turn.c)[..., None, None]
                dm = dm + rate[..., None, None] * (dy - dc[..., None] * y / c)
        push, dpush = 0.0, 0.0
        if self.friction is not None:
            f, f_by, _ = arc(turn.c)
            twice = 2 / step.dt[..., None]
            r = twice * f[..., None] * turn.y - step.spin
            size = torch.sqrt((r * r).sum(-1, keepdim=True) + self._slip[..., None] ** 2)
            force = self.friction[..., None] / size
            push = push + force * r
            if by is not None:
                y, axis = turn.y[..., None, :], r[..., None, :]
                dphi = f[..., None, None] * dy + (f_by[..., None] * dc)[..., None] * y
                dr = twice[..., None] * dphi
                across = (axis * dr).sum(-1, keepdim=True) / size[..., None, :] ** 2
                dpush = dpush + force[..., None, :] * (dr - across * axis)
        if step.torque is not None:
            push = push - step.torque
        if not isinstance(push, float):
            w = torch.sqrt(2 / (1 + turn.c))[..., None]
            m = m + w * push
            if by is not None:
                fall = dc[..., None] / (2 * (1 + turn.c)[..., None, None])
                dm = dm + w[..., None, :] * (dpush - fall * push[..., None, :])
        mean = (step.before + step.after) / 2
        C = skew(m) @ mean / 2
        if by is None:
            return C, None
        m = skew(m)[..., None, :, :]
        return C, (skew(dm) @ mean[..., None, :, :] + m @ by / 2) / 2

    def _moments_at_rest(
        self, step: BallStep, by: Tensor | None
    ) -> tuple[Tensor, Tensor | None] | None:
        """Those of dampers at an instant of a motion, and the torque."""
        m = None if step.torque is None else -step.torque
        if step.spin is not None and self.dissipative:
            push = self.damper[..., None] * step.spin
            m = push if m is None else m + push
        if m is None:
            return None
        C = skew(m) @ step.after / 2
        return C, None if by is None else skew(m)[..., None, :, :] @ by / 2


@dataclass(frozen=True)
class SmallBallLaws(BallLaws):
    """Those of small rotations, D = I + ~phi: C = ~P/2 with what acts on a, P = K phi + c phi' -
    tau, phi at the middle of a step. There is neither friction nor a limit.
    """

    def conjugate(self, step: BallStep, by: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        phi, before = axial(step.after) / 2, axial(step.before) / 2
        P, dP = torch.zeros_like(phi), None if by is None else torch.zeros_like(axial(by))
        share = 1.0 if step.dt is None else 0.5
        if self.stiffness is not None:
            P = P + (self.stiffness @ (phi + before)[..., None] / 2)[..., 0]
            dP = None if by is None else dP + share * axial(by) @ self.stiffness.mT / 2
        if self.damping is not None and step.dt is not None:
            c = self.damping[..., None] / step.dt
            P = P + c * (phi - before)
            dP = None if by is None else dP + c[..., None] * axial(by) / 2
        elif self.damping is not None and step.spin is not None:
            P = P + self.damping[..., None] * step.spin
        P = P if step.torque is None else P - step.torque
        return skew(P) / 2, None if by is None else skew(dP) / 2


def _swing(D: Tensor, e: Tensor) -> Tensor:
    """(...) rad between an axis e (..., 3) and D e."""
    turned = (D @ e[..., None])[..., 0]
    across = cross(e, turned)
    square = (across * across).sum(-1)
    some = square > 0
    sine = torch.where(some, torch.sqrt(torch.where(some, square, 1.0)), 0.0)
    return torch.atan2(sine, (e * turned).sum(-1))


def moment(C: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """M (..., 3), frame a, of C between the axes of both parts (..., 3, 3)."""
    return axial(a @ C @ b.mT)


class Axes(NamedTuple):
    """Of both parts (..., B, 3, 3), columns, frame a. small: D of small rotations, of which both
    are as drawn; None = rotations are large.
    """

    a: Tensor
    b: Tensor
    small: Tensor | None = None

    @property
    def relative(self) -> Tensor:
        return self.a.mT @ self.b if self.small is None else self.small


@dataclass(frozen=True)
class Balls(Tree):
    """at: their places among the J joints; ground (J, 2, 1, 1) 1 where a part is the ground; own
    (..., J, 2, 3, 3) the joint's axes in those of its nodes; laws of all J joints; torques: whether
    one is given.
    """

    at: tuple[int, ...]
    ground: Tensor = leaf(4)
    own: Tensor = leaf(4)
    laws: BallLaws
    torques: bool

    @property
    def act(self) -> bool:
        laws = self.laws
        some = laws.stiffness, laws.damping, laws.friction, laws.limit_stiffness
        return self.torques or any(x is not None for x in some)

    def of(self, x: Tensor, axis: int) -> Tensor:
        """Of all joints (axis, counted from the last): those of balls."""
        if len(self.at) == x.shape[axis]:
            return x
        return x.index_select(axis, torch.tensor(self.at, device=x.device))

    def to_joints(self, x: Tensor, axis: int, count: int) -> Tensor:
        """The inverse, zero elsewhere."""
        if len(self.at) == count:
            return x
        shape = list(x.shape)
        shape[axis] = count
        return x.new_zeros(shape).index_copy(axis, torch.tensor(self.at, device=x.device), x)

    @property
    def own_laws(self) -> BallLaws:
        """Those of balls alone."""
        return map_leaves(lambda x, axes: self.of(x, -axes), self.laws)

    def axes(self, pose: Pose) -> Axes:
        eye = torch.eye(3, dtype=pose.R.dtype, device=pose.R.device)
        R = pose.R if pose.drawn is None else pose.drawn
        fixed = self.of(self.own, -4)
        a, b = ((self.of(R, -4) + self.of(self.ground, -4) * eye) @ fixed).unbind(-3)
        if pose.drawn is None:
            return Axes(a, b)
        by_a, by_b = (self.of(pose.R, -4) @ fixed).unbind(-3)
        return Axes(a, b, eye + by_b - by_a)

    def spin(self, pose: Pose, spins: Tensor) -> Tensor:
        """(..., B, 3) rad/s of b against a, axes of a; spins (..., J, 2, 3), frame a."""
        first, second = self.of(spins, -3).unbind(-2)
        return (self.axes(pose).a.mT @ (second - first)[..., None])[..., 0]

    def turn(self, pose: Pose) -> Tensor:
        """(..., B, 3) rad, the rotation vectors."""
        return Turn.of(self.axes(pose).relative).vector

    def conjugate(self, step: BallStep) -> Tensor:
        return self.own_laws.conjugate(step)[0]

    def moment(self, C: Tensor, acting: Pose) -> Tensor:
        """M (..., B, 3), frame a: on a; on b its opposite."""
        axes = self.axes(acting)
        return moment(C, axes.a, axes.b)

    def moment_by(self, step: BallStep, acting: Pose, end: Pose, rate: float) -> Tensor:
        """(..., B, 3, 6): M by half the spins of both ends, of which the end takes `rate`."""
        axes, ends = self.axes(acting), self.axes(end)
        unit = skew(torch.eye(3, dtype=end.R.dtype, device=end.R.device))  # by each component
        a, b = ((unit @ x[..., None, :, :]) for x in (ends.a, ends.b))  # (..., B, 3, 3, 3)
        relative = ends.a.mT[..., None, :, :] @ b  # by a spin of b; of a its opposite
        C, by = self.own_laws.conjugate(step, rate * relative)
        C, to_a, to_b = C[..., None, :, :], axes.a[..., None, :, :], axes.b.mT[..., None, :, :]
        bent = to_a @ by @ to_b
        if ends.small is not None:  # of what acts along axes as drawn
            a, b = 0 * a, 0 * b
        first, second = a @ C @ to_b - bent, to_a @ C @ b.mT + bent
        return axial(torch.cat(torch.broadcast_tensors(first, second), -3)).mT

    def spin_rows(self, pose: Pose) -> Tensor:
        """(..., B, 3, 12): the spin by displacement and spin of both ends."""
        a = self.axes(pose).a.mT
        none = torch.zeros_like(a)
        return torch.cat((none, -a, none, a), -1)
