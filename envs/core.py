"""BeamVectorEnv: what every task shares. A task is one file that says where episodes start and what is seen and wanted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from torch import Tensor

import torchbeam as tb

from . import noise as random
from .episodes import Episodes
from .plant import Parameter, Parameters, Plant, cantilever, first_frequency, section_named, stepper, varied
from .rows import replaced
from .sensors import Sensors
from .vector import EpisodesVectorEnv


class BeamVectorEnv(EpisodesVectorEnv):
    """n episodes of one task of a cantilever with a force on its tip, stepped as one batch. Tensors inside; nothing is written
    in place.

    A task derives from this, hands the arguments below on, with its own defaults, and defines what differs of
        PLANE, GOAL, AIM, HUB, ...     the plane of planar=True; size of `goal`; bounds of `aim`; see below
        parameters()                   -> name -> `Parameter`, what may change with the episode
        held()                         -> arguments of the scene beside beam and effects, where it is not clamped
        effects(params)                -> loads of the scene, beside damping and gravity
        begin(streams, rows)           -> goal (k, GOAL) of fresh episodes of the sub-envs rows (k,), each from its own stream
        launch(beam, goal)             -> the state that episodes start in, of the beam at rest
        inputs(action, now)            -> what the stepper is given over one control interval: from the action (n, a) that acts
        aim(now, tip)                  -> (n, size of AIM), what is seen beside the sensors; `tip` as the sensors have it
        cost(now)                      -> (n,), of an interval, at its end
        lost(now)                      -> (n,) bool, or None: whether nothing is left to do; it costs what a failure does
        measures(now)                  -> what goes into `info`, name -> (n,)
        sketch(now)                    -> what a picture shows beside the beam: see `envs/rendering.py`
    where `now` is an `Episodes`.

    Arguments that every task has (defaults are those of `torchbeam/TipReach-v0`)
    num_envs           sub-envs
    length             m
    section            `torchbeam.Section`, or "aluminium strip" or "silicone rod" (see `envs/plant.py`). Its dtype and device
                       are those of the simulation; batch axes (num_envs,) give every sub-env its own
    damping            s, or None; tau in [F; M] = S^-1 (strain + tau strain rate)
    gravity            (3,) m/s^2, or None
    elements           at least 2
    control_interval   s;  substeps: calls of the stepper in one
    form, method       "nodal" and "midpoint" (implicit); or, for a soft section, a form and a method of torchdiffeq as in
                       `torchbeam.ExplicitStepper`
    solver             more arguments for the stepper, by name
    delay              control intervals from an action to its effect
    force              N along y and z at an action of 1, for the 2 (in a plane: 1) axes across the beam
    planar             motion, force and observation in the plane of the task alone; gravity across it is left out
    sensors            one or more of "tip", "middle", "gauges", "full": see `envs/sensors.py`
    noise              standard deviation, in units of the observation, of white noise on each entry of the sensors
    randomize          what is drawn uniformly at each reset, from the sub-env's generator: name -> (low, high); True = every
                       parameter, from its documented range; None
    control_cost       per interval and |action|^2
    failure_reward     of the interval in which the solver fails, or the task is lost
    max_episode_steps  None = no end
    autoreset_mode     "NextStep": the step after an episode's last one resets it; its action is ignored and its reward 0.
                       "SameStep". "Disabled": an episode that is over stands still, reward 0 and flags kept, until
                       reset(options={"reset_mask": (num_envs,) bool})
    output             "numpy": float32 observations, float64 rewards, no gradient. "torch": tensors in the section's dtype,
                       with gradient from actions (and parameters) to observations and rewards, over as many steps as
                       `detach()` is not called
    render_mode        "rgb_array", "human" or None

    Parameters of every task: stiffness and mass (factors on the section's), damping (s), offset (m, from the last node to the
    point beyond it where the force acts).
    """

    OPTIONS = ("reset_mask", "params", "goal")
    PLANE: ClassVar[str] = "xy"
    GOAL: ClassVar[int] = 0
    AIM: ClassVar[tuple[float, ...]] = ()
    HUB: ClassVar[int] = 0  # actions before those of the tip force
    VIEW: ClassVar[tuple[float, float, float]] = (-0.12, 1.12, 0.6)  # of a picture, in lengths: x from, to; half its height
    UNITS: ClassVar[dict[str, str]] = {"distance": "m"}  # of what is measured

    def __init__(
        self, num_envs: int = 1, *, length: float = 1.5, section: tb.Section | str = "aluminium strip",
        damping: float | None = 1e-3, gravity: tuple[float, float, float] | None = (0.0, 0.0, -9.81), elements: int = 6,
        control_interval: float = 0.02, substeps: int = 2, form: str = "nodal", method: str = "midpoint",
        solver: dict[str, Any] | None = None, delay: int = 1, force: Sequence[float] = (1.2, 2.0), planar: bool = False,
        sensors: str | Sequence[str] = ("tip", "middle"), noise: float = 0.0,
        randomize: bool | dict[str, Sequence[float]] | None = None, control_cost: float = 1e-3, failure_reward: float = -100.0,
        max_episode_steps: int | None = 50, autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        output: str = "numpy", render_mode: str | None = None,
    ) -> None:
        for name, value, least in (("num_envs", num_envs, 1), ("substeps", substeps, 1), ("elements", elements, 2),
                                   ("delay", delay, 0), ("max_episode_steps", max_episode_steps, 1)):
            whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= least
            if not whole and not (name == "max_episode_steps" and value is None):
                raise ValueError(f"{name} = {value!r} was given; a whole number of at least {least} is wanted")
        if not math.isfinite(failure_reward):
            raise ValueError(f"failure_reward = {failure_reward!r} was given; a finite number is wanted")
        for name, value in (("control_interval", control_interval), ("length", length)):
            if not 0 < value < math.inf:
                raise ValueError(f"{name} = {value!r} was given; a positive finite number is wanted")
        for name, value in (("control_cost", control_cost), ("noise", noise)):
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} = {value!r} was given; a finite non-negative number is wanted")
        if form != "nodal" and gravity is not None:
            raise ValueError(f"gravity with form = {form!r} was given; episodes of that form start undeformed: gravity=None")
        self.plane = self.PLANE if planar else None
        across = [1, 2] if self.plane is None else ["xyz".index(self.plane[1])]
        if len(force) == 2:
            force = [force[i - 1] for i in across]
        if len(force) != len(across) or not all(0 < f < math.inf for f in force):
            raise ValueError(f"force = {tuple(force)} was given; two positive finite numbers (N, along y and z) are wanted")
        self.section = section_named(section)
        self.length, self.elements, self.damping, self.gravity = length, elements, damping, self._in_plane(gravity)
        self.control_interval, self.substeps, self.delay, self.form = control_interval, substeps, delay, form
        self.method, self.solver, self.noise = method, solver or {}, noise
        self.control_cost, self.failure_reward = control_cost, failure_reward
        self.sensors = Sensors(sensors, elements, self.plane, form)
        actions = self.HUB + len(across)
        high = np.concatenate((self.aim_high(), self.sensors.high, np.ones(delay * actions))).astype(np.float32)
        compliance = self.section.compliance
        super().__init__(num_envs, Box(-high, high), Box(-1, 1, (actions,)), dtype=compliance.dtype, device=compliance.device,
                         max_episode_steps=max_episode_steps, autoreset_mode=autoreset_mode, output=output,
                         render_mode=render_mode, render_fps=round(1 / control_interval))
        self.force = torch.tensor(force, dtype=self.dtype, device=self.device)
        self.axes = torch.eye(3, dtype=self.dtype, device=self.device)[across]
        self.omega = first_frequency(self.section, length)[..., None]  # rad/s, (1,) or (num_envs, 1)
        self.speed = length * self.omega  # m/s
        self.varying: set[str] = set()  # parameters that have a value for each sub-env
        self.known = Parameters(self.parameters() if form == "nodal" else {})
        self.plant = self._plant({}, torch.arange(num_envs, device=self.device))  # the usual one
        self.rest = self._settled(self.plant, num_envs)
        self.ranges = self.known.ranges(randomize)  # name -> (low, high)
        self.varying |= set(self.ranges)  # grows when a reset is given values for others

    # What tasks define

    def parameters(self) -> dict[str, Parameter]:
        own = {"stiffness": Parameter(1.0, 0.8, 1.2, above=True), "mass": Parameter(1.0, 0.8, 1.2, above=True),
               "offset": Parameter(0.0, -0.02 * self.length, 0.02 * self.length, least=-math.inf)}
        return own if self.damping is None else {**own, "damping": Parameter(self.damping, self.damping / 2, 2 * self.damping)}

    def held(self) -> dict[str, Any]:
        return {}

    def effects(self, params: dict[str, Tensor]) -> tuple:
        moment = tb.Input("moment", 3) if "offset" in self.varying else None
        return (tb.TipLoad(force=tb.Input("force", 3), moment=moment),)

    def begin(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        return self.high.new_zeros(len(rows), self.GOAL)

    def launch(self, beam: tb.State, goal: Tensor) -> tb.State:
        return beam

    def inputs(self, action: Tensor, now: Episodes) -> dict[str, Tensor]:
        force = (action[:, self.HUB:] * self.force) @ self.axes
        if "moment" not in now.plant.scene.inputs:
            return {"force": force}
        along = now.beam.tip.rotation[..., 0] * now.plant.params["offset"][:, None]  # held over the interval, like the force
        return {"force": force, "moment": torch.linalg.cross(along, force)}

    def pushed(self, now: Episodes) -> Tensor:
        """(n, 3) N: the tip force of the action that acts, along its axes."""
        return (now.acting[:, self.HUB:] * self.force) @ self.axes

    def aim_high(self) -> np.ndarray:
        """Bounds of what `aim` returns; by default AIM, in each direction of the motion."""
        d = 3 if self.plane is None else 2
        return np.repeat(np.array(self.AIM), d)

    def aim(self, now: Episodes, tip: Tensor | None) -> Tensor:
        raise NotImplementedError

    def gap(self, now: Episodes, target: Tensor, tip: Tensor | None) -> Tensor:
        """(n, d): from the tip, or where no sensor sees it from its start, to the target (n, 3) m, over the length."""
        far = ((target - now.start.position[:, -1]) / self.length)[:, self.sensors.vector]
        return far if tip is None else far - tip

    def cost(self, now: Episodes) -> Tensor:
        raise NotImplementedError

    def lost(self, now: Episodes) -> Tensor | None:
        return None

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {}

    def sketch(self, now: Episodes) -> dict[str, Any]:
        return {}

    @property
    def scene(self) -> tb.Scene:
        """What is simulated now, with the inputs of the task; before the first reset, at the usual parameters."""
        return (self.plant if self.episodes is None else self.episodes.plant).scene

    @property
    def start(self) -> tb.State:
        """What displacements are counted from, batch (n,)."""
        return self.rest[0] if self.episodes is None else self.episodes.start

    # Inside: steps

    def advance(self, before: Episodes, action: Tensor, active: Tensor) -> tuple[Episodes, Tensor, Tensor]:
        """The active episodes one control interval later: (episodes, reward (n,), failed (n,) bool)."""
        beam, acting, pending = before.beam, before.acting, before.pending
        if active.any():
            queue = torch.cat((pending, action[:, None]), 1)
            acting = torch.where(active[:, None], queue[:, 0], acting)
            pending = torch.where(active[:, None, None], queue[:, 1:], pending)
            given = self.inputs(queue[:, 0], before)
            for _ in range(self.substeps):
                beam = before.plant.stepper(beam, active=active, **given)
        steps = before.steps + active
        after = replace(before, beam=beam, acting=acting, pending=pending, steps=steps)
        observation = self._observation(after)
        failed = active & (after.failed | ~torch.isfinite(observation).all(-1))
        good = active & ~failed
        if not good.all():
            observation = torch.where(good[:, None], observation, before.observation)
        lost = self.lost(after)
        ended = failed if lost is None else failed | (good & lost)
        reward = -self.cost(after) - self.control_cost * action.square().sum(-1)
        reward = torch.where(active, torch.where(ended, self.failure_reward, reward), 0.0)
        over = before.terminated | ended
        late = torch.zeros_like(active) if self.max_episode_steps is None else steps >= self.max_episode_steps
        after = replace(after, observation=observation, terminated=over, truncated=before.truncated | (good & late & ~over))
        return after, reward, failed

    def _observation(self, now: Episodes) -> Tensor:
        omega = self.of(now, self.speed)
        seen = self.sensors.read(now.beam, now.start, self.length, omega)
        if self.noise:
            seen = seen + self.noise * random.normal(now.key, now.steps, seen.shape[-1], self.dtype)
        tip = None if self.sensors.tip is None else seen[:, self.sensors.tip]
        whole = torch.cat((self.aim(now, tip), seen, now.pending.flatten(1)), -1)
        return whole.clamp(-self.high, self.high)

    def of(self, now: Episodes, value: Tensor) -> Tensor:
        """Rows of a constant (num_envs, 1) that belong to these episodes; one of shape (1,) is everybody's."""
        return value[now.member] if value.ndim > 1 else value

    # Inside: resets

    def renew(self, episodes: Episodes | None, mask: Tensor, params: dict[str, Tensor] | None = None,
              goal: Tensor | None = None) -> Episodes:
        """The episodes with those in the mask started afresh: built and solved for these alone, then put in their rows."""
        episodes = self._with_room(episodes, set(params or {}))
        rows = mask.nonzero()[:, 0]
        streams = [self.streams[i] for i in rows.tolist()]
        drawn = self.begin(streams, rows)  # first: neither parameters nor noise change the goals
        goal = drawn if goal is None else goal[rows]
        values = {name: [stream.uniform(*self.ranges[name]) for stream in streams] for name in self.ranges}
        values = {name: torch.tensor(each, dtype=self.dtype, device=self.device) for name, each in values.items()}
        values |= {name: given[rows] for name, given in (params or {}).items()}
        plant = self._plant(values, rows) if self.varying else self.plant
        start, first = self._at_rest(plant, rows)
        key = torch.tensor([int(s.integers(2**63)) for s in streams] if self.noise else [0] * len(rows), device=self.device)
        zero = torch.zeros(len(rows), dtype=torch.long, device=self.device)
        idle = self.high.new_zeros(len(rows), *self.single_action_space.shape)
        now = Episodes(plant, rows, start, self.launch(first, goal), goal, key, idle, idle[:, None].expand(-1, self.delay, -1),
                       zero, zero.bool(), zero.bool(), idle)
        now = replace(now, observation=self._observation(now))
        return now if episodes is None else replaced(episodes, now, rows, self.num_envs)

    def _plant(self, values: dict[str, Tensor], rows: Tensor) -> Plant:
        """Of the sub-envs rows (k,), with values (k,) of parameters; those that vary and are not given have their usual one."""
        params = {name: torch.tensor(p.value, dtype=self.dtype, device=self.device) for name, p in self.parameters().items()}
        params |= {name: params[name].expand(len(rows)) for name in self.varying}
        params |= values
        scene = cantilever(self.length, self.elements, varied(self.section, params, rows), self.effects(params), params,
                           self.gravity, self.plane, **self.held())
        return Plant(params, stepper(scene, self.control_interval / self.substeps, self.form, self.method, self.solver))

    def _at_rest(self, plant: Plant, rows: Tensor) -> tuple[tb.State, tb.State]:
        if plant is not self.plant:
            return self._settled(plant, len(rows))
        return self.rest if len(rows) == self.num_envs else tuple(state[rows] for state in self.rest)

    def _settled(self, plant: Plant, count: int) -> tuple[tb.State, tb.State]:
        """The beam in equilibrium without action, and the same with what the method remembers of a step without action."""
        still = {name: self.high.new_zeros(count, size) for name, size in plant.scene.inputs.items()}
        if self.gravity is None or self.form != "nodal":
            start = plant.stepper.rest((count,))
        else:
            start = tb.equilibrium(plant.scene, throw=False, **still)
        return start, plant.stepper.begin(start, **still) if isinstance(plant.stepper, tb.Stepper) else start

    def _with_room(self, episodes: Episodes | None, names: set[str]) -> Episodes | None:
        """The episodes with room for values of these parameters in their plants."""
        self.varying |= names
        if episodes is None or all(episodes.plant.params[name].ndim for name in self.varying):
            return episodes
        kept = {name: value for name, value in episodes.plant.params.items() if value.ndim}
        return replace(episodes, plant=self._plant(kept, torch.arange(self.num_envs, device=self.device)))

    # Inside: arguments

    def options(self, given: dict[str, Any]) -> dict[str, Any]:
        """Parameters by name (n,) and goals (n, GOAL) from the options of a reset, checked."""
        params = {name: self.known.given(name, value, self.num_envs, self.high)
                  for name, value in given.get("params", {}).items()}
        goal, shape = given.get("goal"), (self.num_envs, self.GOAL)
        if goal is not None:
            goal = torch.as_tensor(goal, dtype=self.dtype, device=self.device)
            if goal.shape not in (shape[1:], shape) or not torch.isfinite(goal).all():
                raise ValueError(f"a goal of shape {tuple(goal.shape)} was given; finite {shape} or {shape[1:]} is wanted")
            goal = goal.expand(shape)
        return {"params": params, "goal": goal}

    def parameters_of(self, now: Episodes) -> dict[str, Tensor]:
        return {name: now.plant.params[name] for name in sorted(self.varying)}

    def _in_plane(self, vector: Sequence[float] | None) -> tuple[float, ...] | None:
        """(3,) without its component across the plane; None where nothing is left."""
        if vector is None or self.plane is None:
            return vector
        kept = tuple(v if axis in self.plane else 0.0 for axis, v in zip("xyz", vector, strict=True))
        return kept if any(kept) else None
