"""TorqueArm: the soft arm of Elastica-RL-control, driven by torques along it, that TrackTarget,
ReachPose and ReachBehind share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import SPIN, VELOCITY, LoadEffect, LoadPoint, Value, leaf
from torchbeam.extend import quaternions as quat

from .actuators import Actuator, driven
from .episodes import Episodes
from .sensors import Observed
from .soft_arm import SoftArm, SoftArmConfig, clamped_over

FAST = 100.0  # m/s, a bound of what is seen of the tip
SEEN = 10  # parts between the nodes that are observed, of a mesh that has them


@dataclass(frozen=True)
class Viscous(LoadEffect):
    """A force -c v and a couple -c omega per length of a beam, of the same number.

    c  (...) N s/m^2, and N s: by the absolute motion, in all directions alike
    """

    c: Value = leaf(0, nonnegative=True, name="c")

    node = None
    by_place = False
    depends = frozenset({VELOCITY, SPIN})

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Any) -> tuple[Tensor, Tensor]:
        c = self.c[..., None, None]
        return -c * point.velocity, -c * point.spin


@dataclass(frozen=True, kw_only=True)
class TorqueArmConfig(SoftArmConfig):
    """torque (N m), points, rate (1/s), viscous (N s/m^2): see `TrackTargetVectorEnv`; the rest as
    in `SoftArmConfig`.
    """

    direction: Sequence[float] = (0.0, 1.0, 0.0)
    up: Sequence[float] | None = (1.0, 0.0, 0.0)
    torque: float = 75.0
    points: Sequence[float] = tuple(k / 7 for k in range(1, 7))
    rate: float = math.inf
    viscous: float = 30.0
    gravity: Sequence[float] | None = None
    damping: float | None = None
    control_interval: float = 1.4e-3
    substeps: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("torque", above=0.0)
        self.check_numbers("viscous", least=0.0)
        if not self.rate > 0:
            raise ValueError(f"rate = {self.rate} was given; a positive number is wanted")
        if (np.diff((0.0, *self.points, 1.0)) <= 0).any() or len(self.points) < 2:
            raise ValueError(
                f"points = {tuple(self.points)} was given; two or more that grow from above 0 to "
                "below 1 are wanted"
            )
        if self.planar:
            raise ValueError("planar = True was given; the arm moves in space, False is wanted")


class TorqueArm(SoftArm):
    """An arm whose actions are values of splines along it, one for each of `DRIVEN`, axes of the
    sections, which give the couples on its elements.

    What acts (n, a) is what `memory` begins with: it follows the action by at most `rate`.
    """

    Config = TorqueArmConfig
    BOX = (-0.6, 0.6), (0.3, 0.9), (-0.6, 0.6)
    VIEW = (-1.15, 1.15, 1.15)
    DRIVEN: ClassVar[tuple[int, ...]] = (1, 2)  # normal, binormal; 0: tangent
    ROOT: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)

    def __init__(self, config: TorqueArmConfig) -> None:
        super().__init__(config)
        self.limits = self.low.new_ones(self.actions)

    def beam(self) -> tb.Beam:
        c = self.config
        G, area = c.young / 1.5, math.pi * c.radius**2
        second = area * c.radius**2 / 4
        section = tb.Section.from_stiffness(
            EA=c.young * area,
            GA=4 / 3 * G * area,
            GJ=2 * G * second,
            EI=c.young * second,
            mass=c.density * area,
            inertia=c.density * second,
        )
        made = tb.Beam.straight(c.length, c.elements, section, c.direction, c.up, self.ROOT)
        # the published clamp holds the first element's axes at its middle
        return clamped_over(made, 0.5 / c.elements)

    def actuators(self) -> tuple[Actuator, ...]:
        """One: couples per length on the elements, by values at the points."""
        c, ends = self.config, np.arange(1, self.elements + 1) / self.elements
        shares = torch.as_tensor(spline(c.points, ends))  # (p, N)
        density = c.torque * self.elements / self.length * shares
        gain = torch.einsum("pn,dj->dpnj", density, torch.eye(3).to(density)[list(self.DRIVEN)])
        torque = tb.PerElement(tb.Input("torque", 3 * self.elements))
        return (Actuator(tb.LineLoad(moment=torque, follower=True), gain.flatten(2).flatten(0, 1)),)

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        return (Viscous(self.config.viscous),)

    # What acts

    def command(self, now: Episodes) -> Tensor:
        """(n, a), in shares of the largest torque."""
        return now.memory[:, : self.actions]

    def inputs(
        self, action: Tensor, now: Episodes | None = None
    ) -> dict[str, Tensor] | list[dict[str, Tensor]]:
        """The mean of each substep, as what acts goes to the action by `rate`."""
        c = self.config
        if now is None or math.isinf(c.rate):
            return driven(self.drives, action)
        before, h = self.command(now), c.control_interval / c.substeps
        change = action - before
        arrives = change.abs() / c.rate  # s

        def passed(t: float) -> Tensor:
            """Integral of what has changed, over the time t, by `rate`."""
            going = arrives.clamp(max=t)
            return change.sign() * (going**2 / 2 + arrives * (t - going))

        return [
            driven(self.drives, before + c.rate / h * (passed((k + 1) * h) - passed(k * h)))
            for k in range(c.substeps)
        ]

    def initial_memory(self, goal: Tensor) -> Tensor:
        return goal.new_zeros(len(goal), self.actions)

    def next_memory(self, now: Episodes, action: Tensor) -> Tensor:
        before, most = self.command(now), self.config.rate * self.config.control_interval
        return before + (action - before).clamp(-most, most)

    def tip_jacobian(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """Of an arm at rest."""
        return self.tip_moved(now, self._turns(now))

    def standing(self, now: Episodes, damping: float) -> Tensor:
        """(n, a): the command whose couples would hold the arm as it stands, by least squares whose
        squares are damped by a share of the largest.
        """
        q = now.beam.rotation
        turns = quat.logarithm(quat.multiply(q[:, 1:], quat.conjugate(q[:, :-1])))
        by = self._turns(now).transpose(2, 3).flatten(1, 2)  # (n, 3 N, a)
        square = by.mT @ by
        most = square.diagonal(dim1=-2, dim2=-1).amax(-1)[:, None, None]
        square = square + damping * most * torch.eye(self.actions).to(square)
        held = torch.linalg.solve(square, by.mT @ turns.flatten(1)[..., None])[..., 0]
        return held.clamp(-1.0, 1.0)

    def _turns(self, now: Episodes) -> Tensor:
        """(n, N, a, 3) rad, frame a: how far elements of an arm at rest turn along themselves, by
        actions of 1: an element bends by all couples beyond it.
        """
        gain = self.drives[0].gain.unflatten(1, (self.elements, 3)) * self.length / self.elements
        R = self.axes_of_elements(now)
        couples = torch.einsum("nejk,aek->neaj", R, gain)  # N m
        beyond = couples.flip(1).cumsum(1).flip(1) - couples / 2
        compliance = self.usual.compliance[..., 3:, 3:] * self.length / self.elements
        return (R @ (compliance @ (R.mT @ beyond.mT))).mT

    # What is seen

    def observed(self) -> list[tuple[Observed, str]]:
        """Places of eleven nodes, the base and the tip among them."""
        if self.config.sensors is not None:
            return super().observed()
        step = max(1, self.elements // SEEN)
        nodes = range(self.elements % step, self.elements + 1, step)
        return [self._seen(tb.sensors.NodePosition(node), 2.0) for node in nodes]

    def target_high(self) -> np.ndarray:
        return np.array([FAST, 1, 1, 1, 1, 1, 1])

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        return torch.cat((moving(now.beam.velocity[:, -1]), now.target[:, 0]), -1)


def moving(velocity: Tensor) -> Tensor:
    """(n, 4): speed (m/s) and unit direction of velocities (n, 3); zero where there is none."""
    square = velocity.square().sum(-1, keepdim=True)
    still = square == 0
    speed = torch.where(still, 1.0, square).sqrt()
    return torch.cat((torch.where(still, 0.0, speed), velocity / speed), -1)


def spline(points: Sequence[float], places: np.ndarray) -> np.ndarray:
    """(p, m): values at places (m,) in [0, 1] of the cubic splines that are 1 at one of p points
    and 0 at the others, 0 and 1: interpolating ones, whose third derivative does not jump at the
    second knot and the last but one (not-a-knot, de Boor 1978).
    """
    knots = np.array([0.0, *points, 1.0])

    def powers(x: np.ndarray) -> np.ndarray:
        jumps = [np.maximum(x - knot, 0.0) ** 3 for knot in knots[2:-2]]
        return np.stack([x**0, x, x**2, x**3, *jumps], -1)

    return np.linalg.solve(powers(knots).T, powers(np.asarray(places)).T)[1:-1]
