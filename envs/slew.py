"""Slew: turn a flexible arm by an angle and leave no vibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat

from .actuators import Actuator, TipForce
from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter
from .reach import distance, rounded
from .single import SingleEnv
from .task import Task


@dataclass(frozen=True, kw_only=True)
class SlewConfig(BeamEnvConfig):
    """angle (rad), torque (N m), inertia (kg m^2) of the hub: see `SlewVectorEnv`; the rest as in
    `BeamEnvConfig`.
    """

    angle: float = math.pi / 2
    torque: float = 1.0
    inertia: float = 0.05
    force: Sequence[float] = (0.3, 0.3)
    gravity: None = None
    max_episode_steps: int | None = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("angle", above=0.0, most=math.pi / 2)
        self.check_numbers("torque", "inertia", above=0.0)
        if self.gravity is not None or self.form != "nodal":
            raise ValueError(
                "gravity or another form was given; Slew is without gravity and in the form 'nodal'"
            )


class Slew(Task):
    """Turn the arm by an angle and leave no vibration: `SlewVectorEnv` has the specification."""

    Config = SlewConfig
    GOAL = 1
    HOLDS = False  # the hub rests at any angle
    VIEW = (-1.15, 1.15, 1.15)
    UNITS = {"distance": "m", "angle": "rad"}  # noqa: RUF012

    def parameters(self) -> dict[str, Parameter]:
        inertia = self.config.inertia
        return {"inertia": Parameter(inertia, inertia / 2, 1.5 * inertia), **super().parameters()}

    def supports(self) -> Any:
        return (
            (tb.Support(0, position="xyz", rotation="xy"),)
            if self.config.supports is None
            else self.config.supports
        )

    def actuators(self) -> tuple[Actuator, ...]:
        hub = Actuator(
            tb.PointLoad(0, moment=tb.Input("torque", 3)), [[0.0, 0.0, self.config.torque]]
        )
        across = torch.eye(3, dtype=self.dtype, device=self.device)[self.axes]
        return (hub, TipForce(gain=self.force[:, None] * across, follower=True))

    def effects(self, params: dict[str, Tensor]) -> tuple:
        none, frames = torch.zeros_like(params["inertia"]), self.usual.frames
        # a disc, turned about z
        flat = torch.stack((params["inertia"] / 2, params["inertia"] / 2, params["inertia"]), -1)
        R = quat.matrix(frames.reshape(-1, *frames.shape[-2:])[0, 0])
        # in section axes
        return (tb.PointMass(none, inertia=R.mT @ torch.diag_embed(flat) @ R, node=0),)

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 1) rad: the angles."""
        most = self.config.angle
        drawn = [[stream.uniform(-most, most)] for stream in streams]
        return torch.tensor(drawn, dtype=self.dtype, device=self.device)

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        """Tip position of the arm at rest, turned by the goal about the hub's axis."""
        root = now.start.position[:, 0]
        x, y, z = (now.start.position[:, -1] - root).unbind(-1)
        c, s = torch.cos(now.goal[:, 0]), torch.sin(now.goal[:, 0])
        tip = root + torch.stack((c * x - s * y, s * x + c * y, z), -1)
        return tip[:, None].expand(-1, ahead + 1, -1)

    def resting(self, now: Episodes) -> tb.State:
        """The straight arm at the goal's angle."""
        start, root = now.start, now.start.position[:, :1]
        half, zero = now.goal / 2, torch.zeros_like(now.goal)
        q = torch.cat((torch.cos(half), zero, zero, torch.sin(half)), -1)[:, None]
        return replace(
            start,
            position=root + quat.rotate(q, start.position - root),
            rotation=quat.multiply(q, start.rotation),
        )

    def target_high(self) -> np.ndarray:
        return np.array([*[4.0] * self.directions, 2 * np.pi, 20.0])

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        angle, rate = self.tracking_error(now)
        return torch.cat((self.gap(now, now.target[:, 0], tip), angle, rate), -1)

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        # in frame a
        turned = quat.multiply(now.beam.rotation[:, 0], quat.conjugate(now.start.rotation[:, 0]))
        angle = now.goal[:, 0] - quat.logarithm(turned)[:, 2]  # to go, in (-3 pi / 2, 3 pi / 2]
        return {"distance": distance(now.target[:, 0], now.beam.position[:, -1]), "angle": angle}

    def tracking_error(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """The hub's: angle to go (rad), and rate over omega."""
        beam = now.beam
        rate = quat.rotate(beam.rotation[:, 0], beam.spin[:, 0])[:, 2:] / self.of(now, self.omega)
        return now.measures["angle"][:, None], rate


class SlewVectorEnv(BeamVectorEnv):
    """`num_envs` flexible arms on hubs that turn, stepped as one batch.

    ## Description
    Turn a flexible arm by an angle, with its tip at rest at the end. The arm is 1.5 m of aluminium
    flat bar, 3 mm x 10 mm. A hub holds one end and turns freely about the vertical z axis, with
    inertia: J d(spin)/dt = torque + root moment of the strip. The actions are a torque on the hub
    and a small force across the tip, which turns with it. The strip's first frequency on a held hub
    is 1.1 Hz, and an episode lasts 2 s. No gravity (it acts along the axis).

    ## Action space
    `Box(-1, 1, (3,), float32)`, held over an interval, `delay` intervals later. Values outside are
    clipped; a row that is not finite counts as zeros.

    | index | action | at 1 |
    |---|---|---|
    | 0 | torque on the hub about z | torque = 1 N m |
    | 1 | tip force along the section's y | force[0] = 0.3 N |
    | 2 | tip force along the section's z | force[1] = 0.3 N |

    ## Observation space
    `Box(-high, high, (17 + 3 delay,), float32)`: lengths over the length L, rates over the first
    frequency omega of the strip on a held hub.

    | index | observation | high |
    |---|---|---|
    | 0-2 | where the tip is to be - tip, x y z | 4 |
    | 3 | angle to go: target - hub's, rad | 2 pi |
    | 4 | rate of the hub, over omega | 20 |
    | 5-16 | tip and mid-span displacement and velocity, as in TipReach (or the `sensors` given) | |
    | then 3 delay | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d the distance from the tip to that of the straight arm at the target
    angle:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000

    ## Starting state
    Straight along x, at rest. The angle is drawn uniformly from [-angle, angle], from the sub-env's
    own generator.

    ## Episode end
    As in TipReach, after 100 steps.

    ## Information
    `distance` (m) of the tip from its target, `angle` (rad) to go, `solver_failed`,
    `action_invalid`; masks as in TipReach.

    ## Arguments
    The fields of `BeamEnvConfig` (see `envs/config.py`), with its defaults but no gravity,
    force = (0.3, 0.3) and max_episode_steps = 100, and

    - `angle`: rad, pi / 2: of the largest turn, up to pi / 2
    - `torque`: N m, 1
    - `inertia`: kg m^2, 0.05: of the hub about z (the strip's own about the hub is 0.091)

    "torchbeam/SlewPlanar-v1" is this with planar=True: the horizontal plane, two actions.

    ## Parameters
    inertia (half to one and a half times the usual, kg m^2), and those of TipReach but offset. The
    goal, for options={"goal": ...}, is the angle (rad).

    ## Version history v1: a failure costs all remaining intervals, see TipReach; in v0 it cost 100,
    less than doing nothing. v0: first version.

    Examples:
        >>> env = envs.SlewVectorEnv(2, elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 14), (2,))
    """

    task_type = Slew


class SlewEnv(SingleEnv):
    """One flexible arm to turn: `SlewVectorEnv` with one member, see there for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.SlewEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((14,), (2,))
    """

    vector = SlewVectorEnv
