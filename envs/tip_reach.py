"""TipReach: bring the tip of a flexible cantilever to a point and hold it there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from torch import Tensor

import torchbeam as tb

from .core import BeamVectorEnv
from .reach import Reach
from .single import SingleEnv

FORCE = (1.2, 2.0)  # N, along y and z
AXES = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SOFT = 1e-3  # of the length: below it the distance in the reward is rounded off


def aluminium_strip(dtype: torch.dtype = torch.float64) -> tb.Section:
    """6061-T6 flat bar, 3 mm (along y) by 10 mm (along z): E = 68.9 GPa, nu = 0.33, density 2700 kg/m^3, yield 276 MPa."""
    values = (torch.tensor(v, dtype=dtype) for v in (3e-3, 10e-3, 68.9e9, 0.33, 2700.0))
    return tb.Section.rectangle(*values)


def silicone_rod(dtype: torch.dtype = torch.float64) -> tb.Section:
    """Round rod of silicone rubber, radius 10 mm: E = 1 MPa, nu = 0.45, density 1100 kg/m^3. Waves are slow enough in it for
    an explicit method: a fixed step of 0.5 ms is stable with two elements in 0.3 m.
    """
    values = (torch.tensor(v, dtype=dtype) for v in (0.01, 1e6, 0.45, 1100.0))
    return tb.Section.circle(*values)


SECTIONS = {"aluminium strip": aluminium_strip, "silicone rod": silicone_rod}


class TipReachVectorEnv(BeamVectorEnv):
    """`num_envs` flexible cantilevers, stepped as one batch.

    ## Description
    An aluminium strip is clamped at one end and reaches out along x; gravity pulls along -z. A bounded force on the
    free end, across the undeformed strip, is to bring the tip to a target and to hold it there. The target changes with
    the episode and is a point that a static force within the bounds holds.

    By default the strip is 1.5 m of 6061-T6 flat bar, 3 mm x 10 mm: soft sideways (y: first frequency 1.1 Hz, a static
    force of 1.2 N moves the tip by 0.67 m) and eleven times stiffer up and down (z: 3.6 Hz), with the two directions
    coupled through bending and torsion at these deflections. It stays elastic: statically the bounds stress it to about
    160 of 276 MPa. An episode is 1 s, little more than one period. The strip is geometrically exact (torchbeam's nodal
    form), with implicit steps of control_interval / substeps, unless `form` and `method` say otherwise.

    ## Action space
    `Box(-1, 1, (2,), float32)`: the tip force, held over one control interval; it keeps its direction in space. It acts
    `delay` intervals later: sensing, computing and actuating take time. Until then no force acts.

    | index | action | at 1 |
    |---|---|---|
    | 0 | tip force along y | force[0] = 1.2 N |
    | 1 | tip force along z | force[1] = 2 N |

    Values outside are clipped. An action that holds NaN or infinity counts as (0, 0) for that sub-env alone, and
    `info["action_invalid"]` says so.

    ## Observation space
    `Box(-high, high, (15 + 2 delay,), float32)`: lengths over the strip's length L, velocities over L omega with omega
    its first natural frequency (L omega = 10.3 m/s by default), clipped to the bounds, which motion within reach does
    not touch.

    | index | observation | high |
    |---|---|---|
    | 0-2 | target - tip, x y z | 4 |
    | 3-5 | tip displacement since the start, x y z | 2 |
    | 6-8 | tip velocity, x y z | 20 |
    | 9-11 | displacement of node elements // 2 (mid span), x y z | 2 |
    | 12-14 | velocity of that node, x y z | 20 |
    | 15-16 ... | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d = |target - tip| at its end and a the clipped action given:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000
    so 15 cm from the target cost 1 a step. A failed solve gives failure_reward instead.

    ## Starting state
    Always the same: at rest under gravity, without tip force. The target is the static tip position under a force drawn
    uniformly from the ellipse with the half axes reach * force, from the sub-env's own generator (see `envs/reach.py`).

    ## Episode end
    Truncation after `max_episode_steps` intervals. Termination only where the solver fails (`info["solver_failed"]`):
    the observation is then the last finite one, and the other sub-envs do not notice.

    ## Information
    `distance` (m) from tip to target, `solver_failed`, `action_invalid`; each (num_envs,) with a mask `_name`, False for
    sub-envs that did not move. SAME_STEP adds `final_obs` (num_envs, 17) and `final_info` with their masks.

    ## Arguments
    num_envs           sub-envs
    length             m, of the strip: 1.5
    section            `torchbeam.Section`, or "aluminium strip" (above) or "silicone rod" (see `silicone_rod`). Its dtype and
                       device are those of the simulation; batch axes (num_envs,) give every sub-env its own
    damping            s, or None; tau in [F; M] = S^-1 (strain + tau strain rate): 1e-3, 0.3 % of critical in the first mode
    gravity            (3,) m/s^2, or None
    elements           6; at least 2
    control_interval   s, 0.02;  substeps: calls of the stepper in one, 2
    form, method       "nodal" and "midpoint" (implicit); or, for a soft section, a form and a method of torchdiffeq as in
                       `torchbeam.ExplicitStepper`. "torchbeam/TipReachBlockRate-v0" is the silicone rod, 0.3 m, in two elements
                       of the index-reduced block rate form, by rk4, without gravity and damping
    solver             more arguments for the stepper, by name
    delay              1, control intervals from an action to its effect
    force              (2,) N along y and z: (1.2, 2)
    reach              0.8: share of the force bounds that targets need at most, above 0 and up to 1
    control_cost       1e-3;  failure_reward: -100
    max_episode_steps  50; None = no end
    autoreset_mode     "NextStep" (default): the step after an episode's last one resets it; its action is ignored and its
                       reward 0. "SameStep". "Disabled": an episode that is over stands still, reward 0 and flags kept,
                       until reset(options={"reset_mask": (num_envs,) bool})
    output             "numpy", or "torch": tensors, differentiable through as many steps as wanted; `state`,
                       `set_state`, `detach` and `initialize_trajectory` are what a training loop needs

    ## Version history
    v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, *, length: float = 1.5, section: tb.Section | str = "aluminium strip",
        damping: float | None = 1e-3,
        gravity: tuple[float, float, float] | None = (0.0, 0.0, -9.81), elements: int = 6, control_interval: float = 0.02,
        substeps: int = 2, form: str = "nodal", method: str = "midpoint", solver: dict[str, Any] | None = None,
        delay: int = 1, force: tuple[float, float] = FORCE, reach: float = 0.8, control_cost: float = 1e-3,
        failure_reward: float = -100.0, max_episode_steps: int | None = 50,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP, output: str = "numpy",
    ) -> None:
        if elements < 2:
            raise ValueError(f"elements = {elements} was given; at least 2 are wanted, for a node at mid span")
        if not 0 < reach <= 1:
            raise ValueError(f"reach = {reach} was given; a share above 0 and up to 1 is wanted")
        if len(force) != 2 or not all(0 < f < math.inf for f in force):
            raise ValueError(f"force = {force} was given; two positive finite numbers (N, along y and z) are wanted")
        if not control_cost >= 0:
            raise ValueError(f"control_cost = {control_cost} was given; a non-negative number is wanted")
        if isinstance(section, str):
            if section not in SECTIONS:
                raise ValueError(f"section = {section!r} was given; a Section is wanted, or one of {', '.join(SECTIONS)}")
            section = SECTIONS[section]()
        if form != "nodal" and gravity is not None:
            raise ValueError(f"gravity with form = {form!r} was given; episodes of that form start undeformed: gravity=None")
        beam = tb.Beam.straight(torch.as_tensor(length, dtype=section.compliance.dtype, device=section.compliance.device),
                                elements, section)
        named = () if damping is None else (tb.Damping(damping),)
        named += () if gravity is None else (tb.Gravity(gravity),)
        scene = tb.Scene(beam, [tb.TipLoad(force=tb.Input("force", 3)), *named])
        high = np.repeat(np.float32([4, 2, 20, 2, 20, 1]), [3, 3, 3, 3, 3, 2 * max(delay, 0)])
        super().__init__(
            num_envs, scene, Box(-high, high), Box(-1, 1, (2,)), control_interval=control_interval, substeps=substeps,
            form=form, method=method, solver=solver, delay=delay, max_episode_steps=max_episode_steps,
            failure_reward=failure_reward,
            autoreset_mode=autoreset_mode, output=output,
        )
        self.length, self.control_cost = length, control_cost
        self.force = torch.tensor(force, dtype=self.dtype, device=self.device)
        self.axes = torch.tensor(AXES, dtype=self.dtype, device=self.device)
        self.middle = elements // 2
        self.speed = (length * first_frequency(section, length))[..., None]  # m/s, (1,) or (num_envs, 1)
        self.reach = Reach.of(scene, reach * self.force, self.axes)
        still = torch.zeros(num_envs, 3, dtype=self.dtype, device=self.device)
        self.start = tb.equilibrium(scene, force=still) if form == "nodal" else self.stepper.rest((num_envs,))

    def begin(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 3) m: targets that forces in the ellipse hold."""
        radius, turn = np.array([stream.random(2) for stream in streams]).T
        disc = np.sqrt(radius) * np.array([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])
        return self.reach.tip(torch.as_tensor(disc.T, dtype=self.dtype, device=self.device), rows)

    def inputs(self, action: Tensor) -> dict[str, Tensor]:
        return {"force": (action * self.force) @ self.axes}

    def observe(self, beam: tb.State, goal: Tensor, pending: Tensor) -> Tensor:
        position, velocity, start = beam.position, beam.velocity, self.start.position
        lengths = [goal - position[:, -1], *(position[:, i] - start[:, i] for i in (-1, self.middle))]
        speeds = [velocity[:, i] / self.speed for i in (-1, self.middle)]
        gap, tip, middle = (x / self.length for x in lengths)
        return torch.cat((gap, tip, speeds[0], middle, speeds[1], pending.flatten(1)), -1)

    def reward(self, beam: tb.State, goal: Tensor, action: Tensor) -> Tensor:
        soft = SOFT * self.length
        far = ((goal - beam.position[:, -1]).square().sum(-1) + soft**2).sqrt() - soft
        return -far / (0.1 * self.length) - self.control_cost * action.square().sum(-1)

    def measures(self, beam: tb.State, goal: Tensor) -> dict[str, Tensor]:
        return {"distance": torch.linalg.vector_norm(goal - beam.position[:, -1], dim=-1)}


class TipReachEnv(SingleEnv):
    """One flexible cantilever whose tip is to reach a point: `TipReachVectorEnv` with one member, see there for everything.

    `gymnasium.make` ends the episode after 50 steps (`max_episode_steps` there); made directly, it does not end by itself.
    """

    vector = TipReachVectorEnv
    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012


def first_frequency(section: tb.Section, length: float) -> Tensor:
    """rad/s, (...): of the softer direction of a uniform cantilever, 1.8751^2 sqrt(EI / (m L^4))."""
    flexibility = section.compliance.diagonal(dim1=-2, dim2=-1)[..., 4:].amax(-1)
    return 1.875104**2 / (flexibility * section.mass[..., 0, 0] * length**4).sqrt()

