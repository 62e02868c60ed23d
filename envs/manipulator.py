"""Manipulator: the upright soft arm, bent by changes of its natural curvature, that FollowTarget,
InverseKinematics and ReachObstacles share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend import shown

from .actuators import Actuator, driven
from .config import BeamEnvConfig
from .episodes import Episodes
from .reach import distance
from .sensors import Observed
from .task import Task

SEGMENTS = 5  # of the arm, each with a natural curvature of its own
SEEN = 10  # nodes that are observed, of a mesh that has them
OWN = "section", "actuators", "force", "beam", "supports"
BOX = (-0.6, 0.6), (-0.6, 0.6), (0.3, 0.9)  # m, where targets are
NEAR = 0.05  # m, of the bonuses


@dataclass(frozen=True, kw_only=True)
class ManipulatorConfig(BeamEnvConfig):
    """radius (m), young (Pa), density (kg/m^3), change and bend (rad), smooth (m): see
    `FollowTargetVectorEnv`; the rest as in `BeamEnvConfig`.
    """

    length: float = 1.0
    elements: int = 20
    direction: Sequence[float] = (0.0, 0.0, 1.0)
    radius: float = 0.05
    young: float = 10e6
    density: float = 1000.0
    change: float = 0.05
    bend: float = 2.0
    smooth: float = 0.0
    gravity: Sequence[float] | None = (0.0, 0.0, -9.8)
    damping: float | None = 0.05
    delay: int = 0
    control_interval: float = 0.1
    control_cost: float = 0.0
    failure_reward: float | None = -10.0  # as published
    sensors: str | Observed | Sequence[str | Observed] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("radius", "young", "density", "change", "bend", above=0.0)
        self.check_numbers("smooth", least=0.0)
        for name in OWN:
            if self.is_given(name):
                raise ValueError(f"{name} was given; the manipulator has its own, none is wanted")
        if self.elements % SEGMENTS:
            raise ValueError(
                f"elements = {self.elements} was given; a multiple of {SEGMENTS}, the arm's "
                "segments, is wanted"
            )
        if self.form != "nodal":
            raise ValueError(f"form = {shown(self.form)} was given; 'nodal' is wanted")


class Manipulator(Task):
    """An upright arm whose actions change the natural curvature of its segments.

    The command (n, a) rad, an angle by which a segment is to turn along its length for each action,
    is what `memory` begins with. It changes by `change` times the action, within +-`limits` (a,),
    evenly over the interval.
    """

    Config = ManipulatorConfig
    PLANE = "xz"
    MESHED = False
    HOLDS = False  # an action changes the curvature; none holds it
    VIEW = (-1.15, 1.15, 1.15)
    TWIST = False  # whether segments are twisted too

    def __init__(self, config: ManipulatorConfig) -> None:
        super().__init__(config)
        self.low, self.high = torch.tensor(BOX, dtype=self.dtype, device=self.device).T
        twists = SEGMENTS if self.TWIST else 0
        bends = self.low.new_full((self.actions - twists,), config.bend)
        self.limits = torch.cat((bends, self.low.new_full((twists,), math.pi / 2)))

    def beam(self) -> tb.Beam:
        c = self.config
        up = (1.0, 0.0, 0.0) if c.up is None else c.up
        section = tb.Section.circle(c.radius, c.young, 0.5, c.density)
        return tb.Beam.straight(c.length, c.elements, section, c.direction, up)

    def actuators(self) -> tuple[Actuator, ...]:
        """One: the natural curvature of all elements, by angles of the segments."""
        c = self.config
        normal = () if self.plane is None else (3 - self.axes[0],)  # of the plane, in section axes
        axes = normal or (1, 2)
        of_segment = torch.eye(SEGMENTS).repeat_interleave(c.elements // SEGMENTS, 1)  # (s, N)
        frame = torch.eye(3)
        bends = torch.einsum("sn,ij->sinj", of_segment, frame[list(axes)]).flatten(0, 1)
        twists = torch.einsum("sn,j->snj", of_segment, frame[0]) if self.TWIST else bends[:0]
        gain = torch.cat((bends, twists)).flatten(1) * SEGMENTS / self.length
        bent = tb.Actuation(curvature=tb.PerElement(tb.Input("curvature", 3 * c.elements)))
        return (Actuator(bent, gain),)

    # The command

    def command(self, now: Episodes) -> Tensor:
        """(n, a) rad, the angles of the segments."""
        return now.memory[:, : self.actions]

    def commanded(self, now: Episodes, action: Tensor) -> Tensor:
        """The command at the end of an interval with an action (n, a)."""
        after = self.command(now) + self.config.change * action
        return torch.minimum(torch.maximum(after, -self.limits), self.limits)

    def inputs(
        self, action: Tensor, now: Episodes | None = None
    ) -> dict[str, Tensor] | list[dict[str, Tensor]]:
        """The mean of each substep, as the curvature changes evenly over the interval; in statics,
        an action is a share of the limits.
        """
        if now is None:
            return driven(self.drives, self.limits * action)
        before, count = self.command(now), self.config.substeps
        change = self.commanded(now, action) - before
        return [driven(self.drives, before + (i + 0.5) / count * change) for i in range(count)]

    def initial_memory(self, goal: Tensor) -> Tensor:
        return goal.new_zeros(len(goal), self.actions)

    def next_memory(self, now: Episodes, action: Tensor) -> Tensor:
        return self.commanded(now, action)

    def tip_jacobian(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 3, a) m and (n, 3, a) rad: how a change of the command (rad) moves and turns the tip
        of an arm whose strain follows it, frame a.
        """
        x, q = now.beam.position, now.beam.rotation
        R = quat.matrix(quat.half_way(q[:, :-1], q[:, 1:]))
        gain = self.drives[0].gain.unflatten(1, (self.elements, 3))  # (a, N, 3) 1/m
        turn = torch.einsum("nejk,aek->naej", R, gain) * self.length / self.elements
        arm = x[:, -1:] - (x[:, :-1] + x[:, 1:]) / 2
        moved = torch.linalg.cross(turn, arm[:, None].expand_as(turn)).sum(2)
        return moved.mT, turn.sum(2).mT

    # What is seen

    def observed(self) -> list[tuple[Observed, str]]:
        """Places and velocities of every second node of twenty, tip included."""
        if self.config.sensors is not None:
            return super().observed()
        step = max(1, self.elements // SEEN)
        nodes = range(self.elements % step or step, self.elements + 1, step)
        places = [self._seen(tb.sensors.NodePosition(node), 2.0) for node in nodes]
        return places + [self._seen(tb.sensors.NodeVelocity(node), 20.0) for node in nodes]

    def _seen(self, sensor: Any, high: float) -> tuple[Observed, str]:
        whole = self.plane is None
        return Observed(sensor if whole else sensor[self.vector], 1.0, high), ""

    # What it is worth

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {"distance": distance(now.target[:, 0], now.beam.position[:, -1])}

    def cost(self, now: Episodes) -> Tensor:
        d = now.measures["distance"]
        return d.square() - 1.5 * self.below(d, NEAR) - 0.5 * self.below(d, 2 * NEAR)

    def below(self, x: Tensor, bound: float) -> Tensor:
        """1 where x (...) is below the bound, else 0; or a logistic function of width `smooth`."""
        width = self.config.smooth
        if width:
            return torch.sigmoid((bound - x) / width)
        return (x < bound).to(x)

    def in_box(self, stream: np.random.Generator) -> np.ndarray:
        """(3,) m, uniform."""
        drawn = stream.uniform(*np.transpose(BOX))
        return drawn if self.plane is None else drawn * [1, 0, 1]
