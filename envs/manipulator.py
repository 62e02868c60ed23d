"""Manipulator: the upright soft arm, bent by changes of its natural curvature, that FollowTarget,
InverseKinematics and ReachObstacles share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

import torchbeam as tb

from .actuators import Actuator, driven
from .episodes import Episodes
from .sensors import Observed
from .soft_arm import SoftArm, SoftArmConfig, clamped_over, overlaps

SEGMENTS = 5  # of the arm, each with a natural curvature of its own
# Where they begin and end, in shares of the length. The published arm bends at the nodes between
# its twenty edges, the clamp holds the first of them, a node's bend is half on each side of it.
BENDS = tuple(k / 40 for k in (1, 7, 15, 23, 31, 39))
SEEN = 10  # nodes that are observed, of a mesh that has them


@dataclass(frozen=True, kw_only=True)
class ManipulatorConfig(SoftArmConfig):
    """change and bend (rad): see `FollowTargetVectorEnv`; the rest as in `SoftArmConfig`."""

    direction: Sequence[float] = (0.0, 0.0, 1.0)
    change: float = 0.05
    bend: float = 2.0
    gravity: Sequence[float] | None = (0.0, 0.0, -9.8)
    damping: float | None = 0.043
    control_interval: float = 0.1
    failure_reward: float | None = -10.0  # as published

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("change", "bend", above=0.0)
        if self.elements % SEGMENTS:
            raise ValueError(
                f"elements = {self.elements} was given; a multiple of {SEGMENTS}, the arm's "
                "segments, is wanted"
            )


class Manipulator(SoftArm):
    """An upright arm whose actions change the natural curvature of its segments.

    The command (n, a) rad, an angle by which a segment is to turn along its length for each action,
    is what `memory` begins with. It changes by `change` times the action, within +-`limits` (a,),
    evenly over the interval.
    """

    Config = ManipulatorConfig
    PLANE = "xz"
    HOLDS = False  # an action changes the curvature; none holds it
    BOX = (-0.6, 0.6), (-0.6, 0.6), (0.3, 0.9)
    VIEW = (-1.15, 1.15, 1.15)
    TWIST = False  # whether segments are twisted too

    def __init__(self, config: ManipulatorConfig) -> None:
        super().__init__(config)
        self.change = config.change
        twists = SEGMENTS if self.TWIST else 0
        bends = self.low.new_full((self.actions - twists,), config.bend)
        self.limits = torch.cat((bends, self.low.new_full((twists,), math.pi / 2)))

    def beam(self) -> tb.Beam:
        c = self.config
        up = (1.0, 0.0, 0.0) if c.up is None else c.up
        section = tb.Section.circle(c.radius, c.young, 0.5, c.density)
        made = tb.Beam.straight(c.length, c.elements, section, c.direction, up)
        return clamped_over(made, BENDS[0])

    def actuators(self) -> tuple[Actuator, ...]:
        """One: the natural curvature of all elements, by angles of the segments."""
        c = self.config
        normal = () if self.plane is None else (3 - self.axes[0],)  # of the plane, in section axes
        axes = normal or (1, 2)
        along = overlaps(c.elements, BENDS)  # (s, N)
        of_segment = along / along.sum(1, keepdim=True) * c.elements / SEGMENTS
        frame = torch.eye(3).to(of_segment)
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
        after = self.command(now) + self.change * action
        return torch.minimum(torch.maximum(after, -self.limits), self.limits)

    def inputs(
        self, action: Tensor, now: Episodes | None = None
    ) -> dict[str, Tensor] | list[dict[str, Tensor]]:
        """The mean of each substep, as the curvature changes evenly over the interval, and damping
        times its rate; in statics, an action is a share of the limits.
        """
        if now is None:
            return driven(self.drives, self.limits * action)
        before, count = self.command(now), self.config.substeps
        change = self.commanded(now, action) - before
        # damping is of what the arm bends by beyond its natural curvature, not of that
        lead = (self.config.damping or 0.0) / self.config.control_interval
        shares = [(i + 0.5) / count + lead for i in range(count)]
        return [driven(self.drives, before + share * change) for share in shares]

    def initial_memory(self, goal: Tensor) -> Tensor:
        return goal.new_zeros(len(goal), self.actions)

    def next_memory(self, now: Episodes, action: Tensor) -> Tensor:
        return self.commanded(now, action)

    def held(self, now: Episodes) -> Tensor:
        return torch.zeros_like(self.command(now))

    def tip_jacobian(self, now: Episodes) -> tuple[Tensor, Tensor]:
        gain = self.drives[0].gain.unflatten(1, (self.elements, 3))  # (a, N, 3) 1/m
        R, each = self.axes_of_elements(now), self.length / self.elements
        return self.tip_moved(now, torch.einsum("nejk,aek->neaj", R, gain) * each)

    # What is seen

    def observed(self) -> list[tuple[Observed, str]]:
        """Places and velocities of every second node of twenty, tip included."""
        if self.config.sensors is not None:
            return super().observed()
        step = max(1, self.elements // SEEN)
        nodes = range(self.elements % step or step, self.elements + 1, step)
        places = [self._seen(tb.sensors.NodePosition(node), 2.0) for node in nodes]
        return places + [self._seen(tb.sensors.NodeVelocity(node), 20.0) for node in nodes]
