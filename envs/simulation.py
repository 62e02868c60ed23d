"""Simulation: episodes of a task begun and advanced as one batch. Tensors in, tensors out; nothing
is written in place.
"""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import BatchSubset, shown, with_values

from . import imperfections
from .episodes import Episodes
from .imperfections import beside_the_beam, erroneous, lagging, late_action
from .parameters import Parameters
from .plant import Plant, stepper
from .sensors import Observer
from .task import Task

FAILED = 1  # a status
# sub-envs up to which native code finds the equilibria of all in less time than it takes to make
# another scene, of a few of them
TOGETHER = 256


class Simulation:
    """`count` episodes of a task.

    Attributes:
        plant: of the usual parameters
        rest: states at the start of episodes: an equilibrium, and the same with the method's memory
            of a step without action
        observer: sensors of the beam
        high: (o,) bounds of whole observations: of each frame target, sensors, actions still to act
        bounds: lower and upper ones of one frame
        known: names of the parameters
        usual: name -> () their usual values
        ranges: name -> (low, high) of those drawn at each reset
        spare: intervals by which actions may be late
        worst: largest cost of an interval; None if a failure has another cost
        varying: names of the parameters that have a value for each sub-env; grows when a reset is
            given values for others

    Examples:
        >>> sim = envs.functional.simulation(envs.TipReachVectorEnv, 2, elements=2, planar=True)
        >>> now = envs.functional.reset(sim, seed=0)
        >>> sim.count, sim.task.actions
        (2, 1)
    """

    def __init__(self, task: Task, count: int) -> None:
        self.task, self.count = task, count
        c = self.config = task.config
        if task.usual.batch_shape not in ((), (count,)):
            raise ValueError(
                f"a beam or section with the batch axes {tuple(task.usual.batch_shape)} was given "
                f"for {count} sub-envs; none, or one of that many, are wanted"
            )
        self.varying: set[str] = set()
        own = task.parameters() if c.form == "nodal" else {}
        self.known = Parameters(own | imperfections.PARAMETERS)
        self.usual = {
            name: torch.tensor(p.value, dtype=task.dtype, device=task.device)
            for name, p in (task.parameters() | imperfections.PARAMETERS).items()
        }
        self.members = torch.arange(count, device=task.device)
        self.plant = self._plant(self.usual)
        start = (
            self._settled(self.plant.scene, count, False)
            if task.settles
            else self.plant.stepper.rest((count,))
        )
        self.rest = start, self._begun(self.plant, start, self.members)
        self.ranges = self.known.ranges(c.randomize)
        self.spare = imperfections.spare(self.ranges)
        most = c.control_cost * task.actions
        self.worst = task.worst_cost() + most if c.failure_reward is None else None
        self.varying |= set(self.ranges)
        task.prepare(self.plant)
        self.observer = Observer(task.observed(), self.rest[0])
        high = np.concatenate(
            (task.target_high(), self.observer.high, np.ones(c.delay * task.actions))
        )
        high = torch.as_tensor(high.astype(np.float32), dtype=task.dtype, device=task.device)
        self.bounds, self.high = (-high, high), high.repeat(c.frames)

    def advance(
        self, before: Episodes, action: Tensor, active: Tensor | None
    ) -> tuple[Episodes, Tensor, Tensor | None]:
        """The active (n,) episodes (None = all, of which none is over) one control interval later:
        (episodes, reward (n,), failed (n,) bool, None = none has).
        """
        beam, acting, pending, everyone = before.beam, before.acting, before.pending, active is None
        memory, late = before.memory, before.late
        if everyone or active.any():
            now, waiting, later = self.acting(before, action)
            gain = before.plant.params["gain"]
            done = gain[:, None] * now if gain.ndim else now
            beam = before.plant.advance(
                beam, self.config.substeps, active, self.task.inputs(done, before)
            )
            memory = self.task.next_memory(before, done)
            if everyone:
                acting, pending, late = now, waiting, later
            else:
                acting = torch.where(active[:, None], now, acting)
                pending = torch.where(active[:, None, None], waiting, pending)
                memory = torch.where(active[:, None], memory, before.memory)
                if late is not None:
                    late = torch.where(active[:, None, None], later, late)
        steps = before.steps + (1 if everyone else active)
        moved = dict(beam=beam, acting=acting, pending=pending, steps=steps, memory=memory)
        after = self._told(with_values(before, **moved, late=late))
        observation = self._observation(after, before.observation)
        reward = -torch.add(
            self.task.cost(after), action.square().sum(-1), alpha=self.config.control_cost
        )
        over, limit = self.task.task_failed(after), self.config.max_episode_steps
        late = None if limit is None else steps >= limit
        # what is infinite has been clipped
        well = not (after.beam.status.any() or isnan(observation.sum().item()))
        if everyone and well and (over is None or not over.any()):
            truncated = before.truncated if late is None else late
            return with_values(after, observation=observation, truncated=truncated), reward, None
        active = torch.ones_like(before.done) if everyone else active
        failed = active & (after.failed | observation.isnan().any(-1))
        good = active & ~failed
        observation = torch.where(good[:, None], observation, before.observation)
        ended = failed if over is None else failed | (good & over)
        reward = torch.where(active, torch.where(ended, self._failure_reward(before), reward), 0.0)
        terminated, truncated = before.terminated | ended, before.truncated
        if late is not None:
            truncated = truncated | (good & late & ~terminated)
        return (
            with_values(after, observation=observation, terminated=terminated, truncated=truncated),
            reward,
            failed,
        )

    def renew(
        self,
        episodes: Episodes | None,
        mask: Tensor,
        streams: list[np.random.Generator],
        params: dict[str, Tensor] | None = None,
        goal: Tensor | None = None,
    ) -> Episodes:
        """Restart the episodes in the mask (n,), in their rows. A start does not depend on other
        resets.

        Args:
            streams: a generator for each sub-env
            params: name -> (n,)
            goal: (n, g), in place of a drawn goal
        """
        params = params or {}
        self.varying |= params.keys()
        rows = mask.nonzero()[:, 0]
        few = None if len(rows) == self.count else BatchSubset(rows, self.count)
        own = [streams[i] for i in rows.tolist()]
        # first: neither parameters nor noise change the goals
        drawn = self.task.sample_goal(own, rows)
        goal = drawn if goal is None else goal[rows]
        values = self._values(
            self._drawn(own) | {name: x[rows] for name, x in params.items()}, rows
        )
        random = self.config.noise or self.task.RANDOM or "bias" in self.varying
        key = torch.tensor(
            [int(s.integers(2**63)) for s in own] if random else [0] * len(rows), device=rows.device
        )
        plant = self.plant
        if self.varying:
            plant = self._plant(values if few is None else self._merged(episodes, values, rows))
        start, first = self._at_rest(plant, values, rows)
        beam = self.task.initial_state(start, goal)
        beam = first if beam is start else self._begun(plant, beam, rows)
        zero = torch.zeros(len(rows), dtype=torch.long, device=rows.device)
        idle = self.high.new_zeros(len(rows), self.task.actions)
        now = Episodes(
            plant,
            rows,
            start,
            beam,
            goal,
            key,
            idle,
            idle[:, None].expand(-1, self.config.delay, -1),
            zero,
            zero.bool(),
            zero.bool(),
            self.high.expand(len(rows), -1),  # until it is seen
            late=idle[:, None].expand(-1, self.spare, -1) if self.spare else None,
            measures={},
            memory=self.task.initial_memory(goal),
        )
        if few is None:
            now = self._told(now)
            return with_values(now, observation=self._observation(now))
        now = self._told(episodes.merge(few, now))
        observation = torch.where(mask[:, None], self._observation(now), episodes.observation)
        return with_values(now, observation=observation)

    def sensors(self, episodes: Episodes | None) -> tb.sensors.Stack:
        """The sensors of these episodes, or of the usual start where there are none."""
        return self.observer.sensors(self.rest[0] if episodes is None else episodes.start)

    def acting(self, before: Episodes, action: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """Actions (n, a) of the next interval, before the actuators' gain, and the actions that
        then wait: pending, late.
        """
        pending, late, params = before.pending, before.late, before.plant.params
        now = action
        if self.config.delay or late is not None:
            queue = torch.cat((*(() if late is None else (late,)), pending, action[:, None]), 1)
            now, pending = queue[:, self.spare], queue[:, self.spare + 1 :]
            if late is not None:
                now = late_action(queue, params["latency"], self.spare)
                late = queue[:, 1 : self.spare + 1]
        if params["lag"].ndim:
            now = lagging(before.acting, now, params["lag"], self.config.control_interval)
        return now, pending, late

    # Inside

    def _drawn(self, streams: list[np.random.Generator]) -> dict[str, Tensor]:
        """name -> (k,), of the parameters that vary by themselves, uniform in their ranges."""
        if not self.ranges:
            return {}
        low, high = np.array([*self.ranges.values()]).T
        drawn = low + (high - low) * np.array([stream.random(len(low)) for stream in streams])
        values = torch.as_tensor(drawn.T.copy(), dtype=self.task.dtype, device=self.task.device)
        return dict(zip(self.ranges, values.unbind(), strict=True))

    def _failure_reward(self, before: Episodes) -> Tensor:
        """() or (n,), of an interval in which episodes fail that stand as `before` at its start."""
        c = self.config
        if self.worst is None:
            return before.observation.new_tensor(c.failure_reward)
        left = (c.intervals - before.steps).clamp(min=1)
        return -self.worst * left.to(before.observation)

    def _told(self, now: Episodes) -> Episodes:
        """With what the task says of them."""
        now = with_values(now, target=self.task.target(now, self.task.preview))
        return with_values(now, measures=self.task.measures(now))

    def _observation(self, now: Episodes, past: Tensor | None = None) -> Tensor:
        """(n, o) of all frames, the last of them of now; past: what was observed before (n, o)."""
        frame = self._frame(now)
        if self.config.frames == 1:
            return frame
        if past is None:
            return frame.repeat(1, self.config.frames)
        return torch.cat((past[:, frame.shape[-1] :], frame), -1)

    def _frame(self, now: Episodes) -> Tensor:
        seen = self.observer.read(now.beam, now.start, self.task.of(now, self.observer.scale))
        seen = erroneous(seen, self.config.noise, now.plant.params["bias"], now.key, now.steps)
        tip = None if self.observer.tip is None else seen[:, self.observer.tip]
        parts = self.task.target_observation(now, tip), seen
        whole = torch.cat((*parts, now.pending.flatten(1)) if self.config.delay else parts, -1)
        if whole.shape[-1] != self.bounds[1].shape[-1]:
            more = self.bounds[1].shape[-1] - whole.shape[-1] + parts[0].shape[-1]
            raise ValueError(
                f"target_high of {more} numbers was given for a target_observation of "
                f"{parts[0].shape[-1]}; as many are wanted (of a vector in a plane "
                "`self.directions`)"
            )
        return whole.clamp(*self.bounds)

    def _values(self, given: dict[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
        """name -> () or, where it varies, (k,), of all parameters of the sub-envs rows (k,); those
        that vary and are not given have their usual value.
        """
        others = self.varying - given.keys()
        return self.usual | {name: self.usual[name].expand(len(rows)) for name in others} | given

    def _merged(
        self, episodes: Episodes, values: dict[str, Tensor], rows: Tensor
    ) -> dict[str, Tensor]:
        """Parameters of all sub-envs, with these values in the rows (k,)."""
        varying, before = [*self.varying], episodes.plant.params
        old = torch.stack([before[name].expand(self.count) for name in varying])
        new = old.index_copy(1, rows, torch.stack([values[name] for name in varying]))
        return values | dict(zip(varying, new.unbind(), strict=True))

    def _scene(self, params: dict[str, Tensor], rows: Tensor) -> tb.Scene:
        """Of the sub-envs rows (k,), with parameters () or (k,)."""
        scene = self.task.scene(params, rows, self.varying)
        return scene if scene.dtype == self.task.dtype else scene.to(self.task.dtype)

    def _plant(self, params: dict[str, Tensor]) -> Plant:
        """Of all sub-envs, with parameters () or (n,)."""
        c = self.config
        if self.varying and beside_the_beam(self.varying):
            return Plant(params, self.plant.stepper)
        scene = self._scene(params, self.members)
        return Plant(
            params,
            stepper(
                scene, c.control_interval / c.substeps, c.form, c.method, c.solver or {}, c.engine
            ),
        )

    def _at_rest(
        self, plant: Plant, values: dict[str, Tensor], rows: Tensor
    ) -> tuple[tb.State, tb.State]:
        """What the sub-envs rows (k,) start from, with these parameters: see `rest`."""
        usual, whole = plant.stepper is self.plant.stepper, len(rows) == self.count
        if usual or self.task.STARTS_ALIKE:
            start = self.rest[0]
        elif not self.task.settles:
            start = plant.stepper.rest((self.count,))
        elif whole or (plant.native and self.count <= TOGETHER):
            start = self._settled(plant.scene, self.count, plant.native)
        else:
            start = self._settled(self._scene(values, rows), len(rows), plant.native)
            return start, self._begun(plant, start, rows)
        first = self.rest[1] if usual else self._begun(plant, start, self.members)
        if whole:
            return start, first
        part = start[rows]
        return part, part if first is start else first[rows]

    def _settled(self, scene: tb.Scene, count: int, native: bool) -> tb.State:
        """The beam (count,) in equilibrium without action."""
        engine = "compiled" if native else "auto"
        return tb.equilibrium(scene, throw=False, inputs=self._idle(scene, count), engine=engine)

    def _begun(self, plant: Plant, beam: tb.State, rows: Tensor) -> tb.State:
        """A state (k,) of the sub-envs rows with what the method remembers of a step from there
        without action.
        """
        if not isinstance(plant.stepper, tb.Stepper):
            return beam
        idle = self._idle(plant.scene, self.count)
        if len(rows) == self.count:
            return plant.stepper.begin(beam, **idle)
        # the others count as failed: nothing is checked of them, and nothing tried
        place = torch.zeros_like(self.members).index_copy(0, rows, self.members[: len(rows)])
        own = torch.zeros_like(place, dtype=torch.bool).index_fill(0, rows, True)
        whole = beam[place]
        whole = with_values(whole, status=torch.where(own, whole.status, FAILED))
        return plant.stepper.begin(whole, **idle)[rows]

    def _idle(self, scene: tb.Scene, count: int) -> dict[str, Tensor]:
        """The scene's inputs without action."""
        own, like = self.task.idle_inputs(), self.task.speed
        return {
            name: own[name].expand(count, size) if name in own else like.new_zeros(count, size)
            for name, size in scene.inputs.items()
        }

    def options(self, given: dict[str, Any]) -> dict[str, Any]:
        """Parameters by name (n,) and goals (n, g) from the options of a reset, checked."""
        params = self.known.given(given.get("params"), self.count, self.high)
        if "latency" in params and (most := params["latency"].detach().max().item()) > self.spare:
            raise ValueError(
                f"latency = {most:g} was given where the largest that randomize draws is "
                f"{self.spare}; no more is wanted"
            )
        goal, shape = given.get("goal"), (self.count, self.task.goal_size)
        if goal is not None:
            try:
                goal = torch.as_tensor(goal, dtype=self.task.dtype, device=self.task.device)
            except (TypeError, ValueError, RuntimeError, OverflowError):
                raise ValueError(
                    f"goal = {shown(goal)} was given; numbers of shape {shape} or {shape[1:]} "
                    "are wanted"
                ) from None
            if goal.shape not in (shape[1:], shape) or not torch.isfinite(goal).all():
                raise ValueError(
                    f"a goal of shape {tuple(goal.shape)} was given; finite {shape} or "
                    f"{shape[1:]} is wanted"
                )
            goal = goal.expand(shape)
        if (
            "clamp" in params
            and "clamp" not in self.varying
            and not torch.as_tensor(given.get("reset_mask", True)).all()
        ):
            raise ValueError(
                "clamp was given for some episodes of an env that does not vary it, where others "
                "go on with a rigid one; randomize of it, or a reset of all, is wanted"
            )
        return {"params": params, "goal": goal}

    def parameters_of(self, now: Episodes) -> dict[str, Tensor]:
        """name -> (n,), of those that vary."""
        return {
            name: now.plant.params[name].expand(len(now.steps)) for name in sorted(self.varying)
        }
