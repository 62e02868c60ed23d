"""Springs: a node tied to a point, and an elastic clamp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.declared import optional, parameter, plain
from ...core.leaves import leaf, with_values
from ...core.validation import Value, as_tensor, axis_last, common_dtype, refusal
from ...math import quaternions as quat
from ...math.quaternions import cross, skew
from ...math.shapes import broadcast_shapes
from ..parts import Place
from .drag import norm, outer
from .load_point import POSITION, ROTATION, SPIN, VELOCITY, LoadEffect, LoadPoint, Pose, Wrench
from .loads import at_offset
from .values import Inputs, Rate, load_value, value_at


@dataclass(frozen=True)
class Spring(LoadEffect):
    """Spring between a node and a point.

    The force is -(k (|d| - length) + c d|d|/dt) d/|d|. The vector d goes from the point to the
    node, or to the place at `offset` from it.

    Args:
        node: counts from the root, -1 is the tip
        stiffness: (...) k, N/m
        to: the point: (..., 3) m, frame a, or a function t -> (..., 3); it moves with frame a. None
            = the initial place of the node or its offset
        length: (...) m unstretched; None, or the number 0, makes it linear: -k d - c d', d' the
            rate of d in frame a
        damping: (...) c, N s/m; forward mode gives the rate of a point that is a function, so write
            it in torch. None, or the number 0: none
        offset: (..., 3) m from the node to where it pulls, section axes; None = at the node. On a
            body, node = (name, point in its axes) says the same

    Raises:
        ValueError: for a negative stiffness, length or damping.

    Examples:
        >>> tied = tb.Scene(
        ...     beam,
        ...     [tb.TipLoad(force=(0, 0, 1.0)), tb.Spring(-1, stiffness=100.0, to=(1.0, 0, -0.5))],
        ... )
        >>> tb.equilibrium(tied).tip.position[2] < tb.equilibrium(scene).tip.position[2]
        tensor(True)
    """

    node: Place = field()
    stiffness: Value = leaf(0, nonnegative=True)
    to: Value | Callable[[Tensor], Tensor] | None = leaf(1, default=None, check=load_value)
    length: Value | None = leaf(0, default=None, check=optional)
    damping: Value | None = leaf(0, default=None, check=optional)
    offset: Value | None = leaf(1, default=None, kw_only=True, size=3)
    moving: Rate | None = leaf(1, default=None, init=False)
    as_drawn: bool = field(default=False, init=False)

    resists = True

    def __post_init__(self) -> None:
        at_offset(self)
        super().__post_init__()
        moving = Rate(self.to, "a Spring's point") if self.damped and callable(self.to) else None
        object.__setattr__(self, "moving", moving)

    def drawn_at(self, position: Tensor, rotation: Tensor) -> Spring:
        """Itself, in a scene whose node is drawn at position (..., 3) m with rotation (..., 4): one
        without a point is tied to where that, or what has its offset, is.
        """
        if self.to is not None and not self.as_drawn:
            return self
        if self.offset is not None:
            offset = torch.as_tensor(self.offset).to(position)
            position = position + quat.rotate(rotation, offset)
        return with_values(self, to=position, as_drawn=True)

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor:
        return length.square() * self.stiffness

    @property
    def linear(self) -> bool:
        return self.length is None

    @property
    def damped(self) -> bool:
        return self.damping is not None

    @property
    def conservative(self) -> bool:
        return not (self.damped and callable(self.to))

    @property
    def anchor(self) -> Tensor | None:
        return None if callable(self.to) else self.to

    @property
    def wants_frame(self) -> bool:
        return self.damped

    def in_free_vibration(self) -> LoadEffect:
        return self

    @property
    def depends(self) -> frozenset[str]:
        lever = (ROTATION, SPIN) if self.damped else (ROTATION,)
        return frozenset(
            (POSITION,) + (VELOCITY,) * self.damped + lever * (self.offset is not None)
        )

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        if self.offset is None:
            return self._pull(point, t, inputs), None
        return point.carried((self._pull(point.at(self.offset), t, inputs), None), self.offset)

    def _pull(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """Force (..., 3) N at the point where it pulls."""
        k, length, c = (
            None if v is None else v[..., None] for v in (self.stiffness, self.length, self.damping)
        )
        d = point.position - value_at(self.to, t, inputs, point.R)
        if self.linear:
            return -k * d - (c * self._rate(point, t, inputs) if self.damped else 0)
        n, r = _direction(d)
        tension = k * (r - length)
        if self.damped:
            tension = tension + c * (n * self._rate(point, t, inputs)).sum(-1, keepdim=True)
        return -tension * n

    def _rate(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """d' (..., 3) in frame a."""
        (origin, omega), rate = point.frame, point.velocity
        if origin is not None:
            rate = rate - origin
        if omega is not None:
            rate = rate - cross(omega, point.position)
        return rate if self.moving is None else rate - value_at(self.moving, t, inputs, point.R)

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Undamped, at the node: -k (I - length/|d| (I - n n^T))."""
        if self.offset is not None or (self.damped and not self.linear):
            return super().tangent(point, t, inputs)
        k, length, c = (
            None if v is None else v[..., None, None]
            for v in (self.stiffness, self.length, self.damping)
        )
        eye = torch.eye(3, dtype=point.R.dtype, device=point.R.device)
        by_r = -k * eye
        if not self.linear:
            n, r = _direction(point.position - value_at(self.to, t, inputs, point.R))
            by_r = by_r + k * length / r[..., None] * (eye - outer(n, n))
        if self.damped and point.frame[1] is not None:
            by_r = by_r + c * skew(point.frame[1])
        derivatives = {POSITION: by_r, **({VELOCITY: -c * eye} if self.damped else {})}
        return {name: torch.cat((d, torch.zeros_like(d)), -2) for name, d in derivatives.items()}


def _direction(d: Tensor) -> tuple[Tensor, Tensor]:
    """d/|d| and |d| (..., 1); at d = 0 no direction, and a length of 1."""
    r = norm(d)
    r = torch.where(r > 0, r, torch.ones_like(r))
    return d / r, r


def _six(name: str, value: Value) -> Value:
    """Six values (..., 6), not negative, from six, or a pair of numbers, (..., 1) or (..., 3)."""
    if isinstance(value, (list, tuple)) and len(value) == 2:
        parts = [as_tensor(p, *common_dtype(value)) for p in value]
        for p in parts:
            if p.ndim and p.shape[-1] not in (1, 3):
                raise refusal(
                    f"{name} with a part of shape {tuple(p.shape)}",
                    "one number, (..., 1) of a batch, or (..., 3)",
                )
        lead = broadcast_shapes(*(p.shape[:-1] for p in parts))
        value = torch.cat([p.expand(*lead, 3) for p in parts], -1)
    return parameter(name, axis_last(name, plain(value), 6))


@dataclass(frozen=True)
class RootSpring(LoadEffect):
    """An elastic, damped clamp: six springs between node 0 and its support.

    Their energy is 1/2 d^T k d + 1/2 phi^T k phi. Node 0 has the displacement d and the rotation
    vector phi (|phi| < pi) from its support. Both are in the support's axes, which are the
    section's at rest. The support stays at the beam's node 0, or moves as the scene's root does.
    A `Support` of node 0 beside it holds components rigidly, whose springs then carry nothing: with
    `Support(0, rotation="xz")` and `RootSpring((0.0, k))` the clamp gives way about y alone.

    Args:
        stiffness: (..., 6) N/m and N m/rad along and about the support's axes, or a pair (forces,
            moments) of numbers, (..., 1) or triples (..., 3)
        damping: the same, N s/m and N m s/rad, on the motion against the support; None = none

    Raises:
        ValueError: for a negative or infinite stiffness or damping.

    Examples:
        >>> sprung = tb.Scene(
        ...     beam,
        ...     [
        ...         tb.RootSpring(stiffness=(1e4, 1e4, 1e4, 5.0, 5.0, 5.0)),
        ...         tb.TipLoad(force=(0, 0, 1.0)),
        ...     ],
        ... )
        >>> tb.equilibrium(sprung).nodes[0, 2]  # m, by which the foot gives way
        tensor(0.0001)
    """

    stiffness: Value = leaf(1, check=_six)
    damping: Value | None = leaf(1, default=None, check=_six)

    node = 0
    resists = True
    frees_root = True
    wants_support = True

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor:
        force, moment = (k.amax(-1) for k in (self.stiffness[..., :3], self.stiffness[..., 3:]))
        return torch.maximum(length.square() * force, moment)

    conservative = True

    def in_free_vibration(self) -> LoadEffect:
        return self

    @property
    def depends(self) -> frozenset[str]:
        return frozenset(
            {POSITION, ROTATION, *((VELOCITY, SPIN) if self.damping is not None else ())}
        )

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        """force -k d; moment -T^-T k phi, T^-1 spin = d(phi)/dt: T^-T = I + ~phi/2 + c ~phi^2."""
        support = _spread(point)
        back = support.R.mT
        k = self.stiffness
        arm = point.position - support.position
        turn = _Turn.of(back @ point.R)
        force = k[..., :3, None] * (back @ arm[..., None])
        moment = turn.back @ (k[..., 3:, None] * turn.phi[..., None])
        if self.damping is not None:
            v, spin = point.velocity, point.spin
            v = v if support.velocity is None else v - support.velocity
            if support.spin is not None:
                v = v - cross(support.spin, arm)
                spin = spin - support.spin
            c = self.damping
            force = force + c[..., :3, None] * (back @ v[..., None])
            moment = moment + c[..., 3:, None] * (back @ spin[..., None])
        return tuple(-(support.R @ w)[..., 0] for w in (force, moment))

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """With p = k phi:  d(T^-T p) = (T^-T k - ~p/2 - c (~(phi x p) + ~phi ~p) + 2 c' (phi x
        (phi x p)) phi^T) T^-1 spin.
        """
        support = _spread(point)
        k = self.stiffness
        turn = _Turn.of(support.R.mT @ point.R)
        p = k[..., 3:] * turn.phi
        tilde, across = skew(turn.phi), torch.linalg.cross(turn.phi, p)
        twice = (tilde @ across[..., None])[..., 0]
        by_phi = (turn.back * k[..., None, 3:] - skew(p) / 2
                  - turn.c[..., None] * (skew(across) + tilde @ skew(p))
                  + 2 * outer(turn.slope * twice, turn.phi))  # fmt: skip
        derivatives = {
            POSITION: _turned(support.R, torch.diag_embed(k[..., :3])),
            ROTATION: _turned(support.R, by_phi @ turn.back.mT),
        }
        if self.damping is not None:
            c = torch.diag_embed(self.damping.unflatten(-1, (2, 3)))
            both = (_turned(support.R, part) for part in c.unbind(-3))
            derivatives[VELOCITY], derivatives[SPIN] = both
            if support.spin is not None:
                turning = derivatives[VELOCITY] @ skew(support.spin)
                derivatives[POSITION] = derivatives[POSITION] - turning
        pads = {POSITION: (0, 3), VELOCITY: (0, 3), ROTATION: (3, 0), SPIN: (3, 0)}
        return {name: -pad(part, (0, 0, *pads[name])) for name, part in derivatives.items()}


def _spread(point: LoadPoint) -> Pose:
    """The support with the site's batch axes: one matrix times a batch would round otherwise."""
    shape = broadcast_shapes(point.support.R.shape, point.R.shape)
    return point.support._replace(R=point.support.R.expand(shape))


class _Turn(NamedTuple):
    """A rotation by |phi| < pi: its vector phi (..., 3); T^-T (..., 3, 3); with x = |phi|/2 and
    y = |phi|^2 the coefficient c = (1 - x cot x)/y and its slope dc/dy (..., 1).
    """

    phi: Tensor
    back: Tensor
    c: Tensor
    slope: Tensor

    @classmethod
    def of(cls, R: Tensor) -> _Turn:
        q = quat.from_matrix(R)
        phi = quat.logarithm(q)
        y, s2 = phi.square().sum(-1, keepdim=True), q[..., 1:].square().sum(-1, keepdim=True)
        g = quat.arc_ratio(q[..., :1].abs(), s2)
        u, small = g * q[..., :1].abs(), y < 1e-3  # x cot x
        safe = torch.where(small, torch.ones_like(y), y)
        c = torch.where(small, 1 / 12 + y / 720 + y * y / 30240, (1 - u) / safe)
        slope = torch.where(small, 1 / 720 + y / 15120, (g * g - u) / (2 * safe * safe) - c / safe)
        tilde = skew(phi)
        eye = torch.eye(3, dtype=R.dtype, device=R.device)
        return cls(phi, eye + tilde / 2 + c[..., None] * tilde @ tilde, c, slope)


def _turned(R: Tensor, matrix: Tensor) -> Tensor:
    """R matrix R^T."""
    return R @ matrix.expand_as(R) @ R.mT
