"""BeamVectorEnv: what every task shares. A task is one file that says where episodes start and what is seen and wanted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from torchbeam import ExplicitStepper, MixedState, Scene, State, Stepper
from torchbeam.integrate.stepper import METHODS as IMPLICIT_METHODS

OUTPUTS = ("numpy", "torch")
HALVINGS = 2  # a failed step is made again in 2 and 4 parts; more would cost the whole batch more than the episode is worth


@dataclass(frozen=True)
class Episodes:
    """Where n episodes stand; everything that `set_state` needs to go on from here.

    beam         `torchbeam.State` with batch (n,)
    goal         (n, g) what the task drew at reset
    pending      (n, delay, a) actions that have not acted yet, the next one first
    steps        (n,) long, steps since reset
    terminated, truncated  (n,) bool, once an episode is over and until it is reset
    observation  (n, o) the last one; finite
    """

    beam: State
    goal: Tensor
    pending: Tensor
    steps: Tensor
    terminated: Tensor
    truncated: Tensor
    observation: Tensor

    @property
    def done(self) -> Tensor:
        return self.terminated | self.truncated

    def detach(self) -> Episodes:
        return Episodes(**{name: value.detach() for name, value in vars(self).items()})


class BeamVectorEnv(VectorEnv):
    """n episodes of one beam task, stepped as one batch. Tensors inside; nothing is written in place.

    A task derives from this, calls `__init__` with its `Scene` and spaces, and defines
        start                          the `State` that episodes start in, batch (n,)
        begin(streams, rows)           -> goal (k, g) of k fresh episodes of the sub-envs rows (k,), each from its own generator
        inputs(action)                 -> what the stepper is given over one control interval: from the action (n, a) that acts
        observe(beam, goal, pending)   -> (n, o)
        reward(beam, goal, action)     -> (n,), from the action that was given
        measures(beam, goal)           -> what goes into `info`, name -> (n,)

    output="numpy": float32 observations, float64 rewards, no gradient. output="torch": tensors in the scene's dtype, with
    gradient from actions to observations and rewards, over as many steps as `detach()` is not called.
    """

    start: State | MixedState

    def __init__(self, num_envs: int, scene: Scene, observation_space: Box, action_space: Box, *, control_interval: float,
                 substeps: int, form: str, method: str, solver: dict[str, Any] | None, delay: int,
                 max_episode_steps: int | None, failure_reward: float, autoreset_mode: str | AutoresetMode,
                 output: str) -> None:
        for name, value in (("num_envs", num_envs), ("substeps", substeps), ("max_episode_steps", max_episode_steps)):
            whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= 1
            if not whole and not (name == "max_episode_steps" and value is None):
                raise ValueError(f"{name} = {value!r} was given; a whole number of at least 1 is wanted")
        if not isinstance(delay, (int, np.integer)) or isinstance(delay, bool) or delay < 0:
            raise ValueError(f"delay = {delay!r} was given; a whole number of control intervals, 0 or more, is wanted")
        if output not in OUTPUTS:
            raise ValueError(f"output = {output!r} was given; {' or '.join(map(repr, OUTPUTS))} is wanted")
        if not np.isfinite(failure_reward):
            raise ValueError(f"failure_reward = {failure_reward!r} was given; a finite number is wanted")
        if not 0 < control_interval < np.inf:
            raise ValueError(f"control_interval = {control_interval!r} was given; a positive finite number (s) is wanted")
        self.num_envs, self.scene, self.control_interval, self.substeps = num_envs, scene, control_interval, substeps
        self.delay = delay
        self.stepper = stepper(scene, control_interval / substeps, form, method, solver or {})
        self.max_episode_steps, self.failure_reward, self.output = max_episode_steps, failure_reward, output
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = observation_space, action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        self.dtype, self.device = scene.dtype, scene.device
        self.low, self.high = (torch.as_tensor(x, dtype=self.dtype, device=self.device)
                               for x in (observation_space.low, observation_space.high))
        self.streams: list[np.random.Generator] = []
        self.seeds: list[int] = []
        self.episodes: Episodes | None = None

    # The Gymnasium interface

    def reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict]:
        """Fresh episodes for all, or for those in options["reset_mask"], (n,) bool.

        seed  s gives sub-env i the stream s + i; a list gives one each; None goes on with the streams there are
        """
        mask = self._reset_mask(options)
        self._seed(seed, mask)
        with self._gradient():
            self.episodes = self._fresh() if mask.all() else self._renew(self.episodes, mask)
            info = self._info(self.episodes, torch.zeros_like(mask), torch.zeros_like(mask), mask)
        return self._out(self.episodes.observation), self._out(info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict]:
        """One control interval. Actions (n, a) are clipped to [-1, 1]; a row that is not finite counts as zeros."""
        before = self._running()
        action, invalid = self._action(actions)
        none = torch.zeros_like(before.done)
        with self._gradient():
            fresh = before.done if self.autoreset_mode is AutoresetMode.NEXT_STEP else none
            if fresh.any():
                before = self._renew(before, fresh)
            active = ~(before.done | fresh)
            after, reward, failed = self._advance(before, action, active)
            info = self._info(after, failed, invalid & active, active)
            terminated, truncated = after.terminated, after.truncated
            if self.autoreset_mode is AutoresetMode.SAME_STEP and after.done.any():
                over = after.done
                info.update(final_obs=after.observation, _final_obs=over, final_info=dict(info), _final_info=over)
                after = self._renew(after, over)
        self.episodes = after
        return (self._out(after.observation), self._out(reward, np.float64), self._out(terminated), self._out(truncated),
                self._out(info))

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """The generators of the sub-envs."""
        if not self.streams:
            self._seed(None, np.ones(self.num_envs, dtype=bool))
        return tuple(self.streams)

    @property
    def np_random_seed(self) -> tuple[int, ...]:
        return tuple(self.seeds)

    # Differentiable use

    @property
    def state(self) -> Episodes:
        """Where all episodes stand: tensors, in the graph."""
        return self._running()

    def set_state(self, state: Episodes) -> Any:
        """Go on from a state got earlier; returns its observation. The streams of random numbers stay where they are."""
        if not isinstance(state, Episodes) or len(state.steps) != self.num_envs:
            raise ValueError(f"a state of {type(state).__name__} was given; Episodes of {self.num_envs} sub-envs are wanted")
        self.episodes = state
        return self._out(state.observation)

    def detach(self) -> None:
        """Cut the graph here: gradients of what follows do not reach what was before."""
        self.episodes = self._running().detach()

    def initialize_trajectory(self) -> Any:
        """Start a window: detach, and return the observation it starts with."""
        self.detach()
        return self._out(self.episodes.observation)

    # Inside

    def _advance(self, before: Episodes, action: Tensor, active: Tensor) -> tuple[Episodes, Tensor, Tensor]:
        """The active episodes one control interval later: (episodes, reward (n,), failed (n,) bool)."""
        beam = before.beam
        queue = torch.cat((before.pending, action[:, None]), 1)
        pending = torch.where(active[:, None, None], queue[:, 1:], before.pending)
        if active.any():
            given = self.inputs(queue[:, 0])
            for _ in range(self.substeps):
                beam = self.stepper(beam, active=active, **given)
        observation = self._observation(beam, before.goal, pending)
        finite = torch.isfinite(observation).all(-1)
        failed = active & ((beam.status != 0) | ~finite)
        if not (active & ~failed).all():
            observation = torch.where((active & ~failed)[:, None], observation, before.observation)
        reward = torch.where(failed, self.failure_reward, self.reward(beam, before.goal, action))
        reward = torch.where(active, reward, 0.0)
        steps = before.steps + active
        late = torch.zeros_like(active) if self.max_episode_steps is None else steps >= self.max_episode_steps
        after = replace(before, beam=beam, pending=pending, steps=steps, observation=observation,
                        terminated=before.terminated | failed, truncated=before.truncated | (active & late & ~failed))
        return after, reward, failed

    def _fresh(self) -> Episodes:
        goal = self.begin(self.streams, torch.arange(self.num_envs, device=self.device))
        self.first = self.start
        if isinstance(self.stepper, Stepper):  # with what the method remembers of a step without action
            still = self.high.new_zeros(self.num_envs, *self.single_action_space.shape)
            self.first = self.stepper.begin(self.start, **self.inputs(still))
        pending = self.high.new_zeros(self.num_envs, self.delay, *self.single_action_space.shape)
        zero = torch.zeros(self.num_envs, dtype=torch.long, device=self.device)
        observation = self._observation(self.first, goal, pending)
        return Episodes(self.first, goal, pending, zero, zero.bool(), zero.bool(), observation)

    def _renew(self, episodes: Episodes, mask: Tensor) -> Episodes:
        """The episodes with those in the mask started afresh; the cost is that of a selection, not of a solve."""
        rows = mask.nonzero()[:, 0]
        goal = episodes.goal.index_copy(0, rows, self.begin([self.streams[i] for i in rows.tolist()], rows))
        beam = self.first.map(lambda new, old: torch.where(mask[(...,) + (None,) * (new.ndim - 1)], new, old), episodes.beam)
        pending = torch.where(mask[:, None, None], 0.0, episodes.pending)
        observation = torch.where(mask[:, None], self._observation(beam, goal, pending), episodes.observation)
        return Episodes(beam, goal, pending, torch.where(mask, 0, episodes.steps), episodes.terminated & ~mask,
                        episodes.truncated & ~mask, observation)

    def _observation(self, beam: State, goal: Tensor, pending: Tensor) -> Tensor:
        return self.observe(beam, goal, pending).clamp(self.low, self.high)

    def _action(self, actions: Any) -> tuple[Tensor, Tensor]:
        action = torch.as_tensor(actions, dtype=self.dtype, device=self.device)
        if action.shape != self.action_space.shape:
            raise ValueError(f"actions of shape {tuple(action.shape)} were given; {self.action_space.shape} is wanted")
        invalid = ~torch.isfinite(action).all(-1)
        return torch.where(invalid[:, None], 0.0, action.clamp(-1, 1)), invalid

    def _info(self, episodes: Episodes, failed: Tensor, invalid: Tensor, mask: Tensor) -> dict[str, Tensor]:
        info = {**self.measures(episodes.beam, episodes.goal), "solver_failed": failed, "action_invalid": invalid}
        return {**info, **{f"_{name}": mask for name in info}}

    def _reset_mask(self, options: dict[str, Any] | None) -> Tensor:
        unknown = set(options or {}) - {"reset_mask"}
        if unknown:
            raise ValueError(f"the reset option {unknown.pop()!r} was given; there is 'reset_mask'")
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        mask = torch.as_tensor(mask, device=self.device)
        if mask.dtype != torch.bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"reset_mask = {mask.tolist()} was given; {self.num_envs} bools, not all False, are wanted")
        if not mask.all():
            self._running()
        return mask

    def _seed(self, seed: int | list[int | None] | None, mask: Any) -> None:
        if seed is None or isinstance(seed, (int, np.integer)):
            seed = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds were given; {self.num_envs} are wanted, one for each sub-env")
        if not self.streams:
            self.streams, self.seeds = map(list, zip(*(seeding.np_random() for _ in seed), strict=True))
        for i, one in enumerate(seed):
            if one is not None and mask[i]:
                self.streams[i], self.seeds[i] = seeding.np_random(one)

    def _running(self) -> Episodes:
        if self.episodes is None:
            raise gymnasium.error.ResetNeeded("step or state was asked for before reset(); call reset() first")
        return self.episodes

    def _gradient(self) -> torch.autograd.grad_mode.set_grad_enabled:
        return torch.set_grad_enabled(self.output == "torch" and torch.is_grad_enabled())

    def _out(self, value: Any, dtype: Any = np.float32) -> Any:
        if isinstance(value, dict):
            return {name: self._out(x, dtype) for name, x in value.items()}
        if self.output == "torch":
            return value
        array = value.detach().cpu().numpy()
        return array.astype(dtype) if array.dtype.kind == "f" else array.copy()


def stepper(scene: Scene, dt: float, form: str, method: str, solver: dict[str, Any]) -> Stepper | ExplicitStepper:
    """What advances the beam by dt (s): the implicit step (form "nodal", method "midpoint"), or torchdiffeq in any form."""
    if form == "nodal" and method in IMPLICIT_METHODS:
        return Stepper(scene, dt, method, **{"halvings": HALVINGS, **solver})
    return ExplicitStepper(scene, dt, method, form, **solver)
