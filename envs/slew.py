"""Slew: turn a flexible arm by an angle and leave no vibration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam import quaternions as quat

from .core import BeamVectorEnv
from .episodes import Episodes
from .plant import Parameter
from .reach import distance, rounded
from .single import SingleEnv


class SlewVectorEnv(BeamVectorEnv):
    """`num_envs` flexible arms on hubs that turn, stepped as one batch.

    ## Description
    A strip of aluminium (1.5 m of 3 mm x 10 mm flat bar) is held at one end by a hub that turns freely about the vertical z
    axis and has inertia: J d(spin)/dt = torque + root moment of the strip. A torque on the hub and a small force across
    the tip, which turns with it, are to turn the arm by an angle, with its tip at rest at the end: the strip's first frequency
    on a held hub is 1.1 Hz, and an episode lasts 2 s. No gravity (it acts along the axis).

    ## Action space
    `Box(-1, 1, (3,), float32)`, held over an interval, `delay` intervals later. Values outside are clipped; a row that is not
    finite counts as zeros.

    | index | action | at 1 |
    |---|---|---|
    | 0 | torque on the hub about z | torque = 1 N m |
    | 1 | tip force along the section's y | force[0] = 0.3 N |
    | 2 | tip force along the section's z | force[1] = 0.3 N |

    ## Observation space
    `Box(-high, high, (17 + 3 delay,), float32)`: lengths over the length L, rates over the first frequency omega of the strip
    on a held hub.

    | index | observation | high |
    |---|---|---|
    | 0-2 | where the tip is to be - tip, x y z | 4 |
    | 3 | angle to go: target - hub's, rad | 2 pi |
    | 4 | rate of the hub, over omega | 20 |
    | 5-16 | tip and mid-span displacement and velocity, as in TipReach (or the `sensors` given) | |
    | then 3 delay | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d the distance from the tip to where the straight arm at the target angle has it:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000

    ## Starting state
    Straight along x, at rest. The angle is drawn uniformly from [-angle, angle], from the sub-env's own generator.

    ## Episode end
    As in TipReach, after 100 steps.

    ## Information
    `distance` (m) of the tip from its target, `angle` (rad) to go, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments
    Those of `BeamVectorEnv` (see `envs/core.py`), with its defaults but no gravity, force = (0.3, 0.3) and max_episode_steps =
    100, and
    angle    rad, pi / 2: of the largest turn, up to pi / 2
    torque   N m, 1
    inertia  kg m^2, 0.05: of the hub about z (the strip's own about the hub is 0.091)

    "torchbeam/SlewPlanar-v0" is this with planar=True: the horizontal plane, two actions.

    ## Parameters
    inertia (half to one and a half times the usual, kg m^2), and those of TipReach but offset. The goal, for
    options={"goal": ...}, is the angle (rad).

    ## Version history
    v0: first version.
    """

    GOAL = 1
    HUB = 1
    VIEW = (-1.15, 1.15, 1.15)
    UNITS = {"distance": "m", "angle": "rad"}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, *, angle: float = math.pi / 2, torque: float = 1.0, inertia: float = 0.05,
                 force: tuple[float, ...] = (0.3, 0.3), gravity: None = None, max_episode_steps: int | None = 100,
                 **arguments: Any) -> None:
        for name, value, most in (("angle", angle, math.pi / 2), ("torque", torque, math.inf), ("inertia", inertia, math.inf)):
            if not (0 < value <= most and math.isfinite(value)):
                raise ValueError(f"{name} = {value!r} was given; a positive finite number, an angle up to pi / 2, is wanted")
        if gravity is not None or arguments.get("form", "nodal") != "nodal":
            raise ValueError("gravity or another form was given; Slew is without gravity and in the form 'nodal'")
        self.angle, self.torque, self.inertia = angle, torque, inertia
        super().__init__(num_envs, force=force, gravity=None, max_episode_steps=max_episode_steps, **arguments)

    def parameters(self) -> dict[str, Parameter]:
        shared = {name: p for name, p in super().parameters().items() if name != "offset"}
        return {"inertia": Parameter(self.inertia, self.inertia / 2, 1.5 * self.inertia), **shared}

    def held(self) -> dict[str, Any]:
        return {"supports": (tb.Support(0, position="xyz", rotation="xy"),)}

    def effects(self, params: dict[str, Tensor]) -> tuple:
        none = torch.zeros_like(params["inertia"])
        about_z = torch.diag_embed(torch.stack((none, none, params["inertia"]), -1))  # (k, 3) would be a matrix where k = 3
        hub = tb.PointMass(none, inertia=about_z, node=0)
        return (tb.TipLoad(force=tb.Input("force", 3), follower=True), tb.PointLoad(0, moment=tb.Input("torque", 3)), hub)

    def inputs(self, action: Tensor, now: Episodes) -> dict[str, Tensor]:
        axis = torch.tensor([0.0, 0.0, 1.0], dtype=self.dtype, device=self.device)
        return {**super().inputs(action, now), "torque": self.torque * action[:, :1] * axis}

    def begin(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 1) rad: the angles."""
        drawn = [[stream.uniform(-self.angle, self.angle)] for stream in streams]
        return torch.tensor(drawn, dtype=self.dtype, device=self.device)

    def aim_high(self) -> np.ndarray:
        return np.array([*[4.0] * (3 if self.plane is None else 2), 2 * np.pi, 20.0])

    def aim(self, now: Episodes, tip: Tensor | None) -> Tensor:
        rate = now.beam.node(0).spin[:, 2:] / self.of(now, self.omega)
        return torch.cat((self.gap(now, self._target(now), tip), self._to_go(now), rate), -1)

    def cost(self, now: Episodes) -> Tensor:
        return rounded(self._target(now) - now.beam.position[:, -1], self.length)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {"distance": distance(self._target(now), now.beam.position[:, -1]), "angle": self._to_go(now)[:, 0]}

    def sketch(self, now: Episodes) -> dict[str, Any]:
        turned = (now.beam.tip.rotation @ self.pushed(now)[..., None])[..., 0]
        return {"target": self._target(now), "hinge": True, "force": turned}

    def _target(self, now: Episodes) -> Tensor:
        """(n, 3) m."""
        return self.length * torch.cat((torch.cos(now.goal), torch.sin(now.goal), torch.zeros_like(now.goal)), -1)

    def _to_go(self, now: Episodes) -> Tensor:
        """(n, 1) rad, in (-3 pi / 2, 3 pi / 2]."""
        turned = quat.multiply(quat.conjugate(now.start.rotation[:, 0]), now.beam.rotation[:, 0])
        return now.goal - quat.logarithm(turned)[:, 2:]


class SlewEnv(SingleEnv):
    """One flexible arm to turn: `SlewVectorEnv` with one member, see there for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it does not end by itself.
    """

    vector = SlewVectorEnv
