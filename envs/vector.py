"""EpisodesVectorEnv: Gymnasium's side of n episodes: reset, step, seeds, autoreset, what comes in and what goes out."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from .episodes import Episodes

OUTPUTS = ("numpy", "torch")
RENDER_MODES = ("rgb_array", "human")


class EpisodesVectorEnv(VectorEnv):
    """n episodes stepped as one batch; what they are about is a derived class's, which defines
        advance(before, action, active)     -> (`Episodes` one interval later, reward (n,), failed (n,) bool)
        renew(episodes, mask, **options)    -> the episodes with those in the mask started afresh; all, where there are none yet
        options(given)                      -> the keyword arguments of renew from the options of a reset, checked
        measures(now)                       -> what goes into `info`, name -> (n,)
        parameters_of(now)                  -> likewise, into info["params"]
    """

    OPTIONS: tuple[str, ...] = ("reset_mask",)
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012
    renderer: Any = None  # also of an env that was refused: gymnasium up to 1.3 closes what it deletes

    def __init__(self, num_envs: int, observation_space: Box, action_space: Box, *, dtype: torch.dtype, device: torch.device,
                 max_episode_steps: int | None, autoreset_mode: str | AutoresetMode, output: str, render_mode: str | None,
                 render_fps: int) -> None:
        for name, value, wanted in (("output", output, OUTPUTS), ("render_mode", render_mode, (None, *RENDER_MODES))):
            if value not in wanted:
                raise ValueError(f"{name} = {value!r} was given; {' or '.join(map(repr, wanted))} is wanted")
        self.num_envs, self.dtype, self.device = num_envs, dtype, device
        self.max_episode_steps, self.output, self.render_mode = max_episode_steps, output, render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "render_fps": render_fps, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = observation_space, action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        self.high = torch.as_tensor(observation_space.high, dtype=dtype, device=device)
        self.streams: list[np.random.Generator] = []
        self.seeds: list[int] = []
        self.episodes: Episodes | None = None

    # The Gymnasium interface

    def reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict]:
        """Fresh episodes for all, or for those in options["reset_mask"], (n,) bool.

        seed     s gives sub-env i the stream s + i; a list gives one each; None goes on with the streams there are
        options  beside the mask: "params": name -> number or (n,), parameters of these episodes; "goal": (GOAL,) or (n, GOAL),
                 instead of the one that is drawn. What is drawn at random is drawn all the same: the rest does not change
        """
        self._open()
        options = dict(options or {})
        mask = self._mask(options)
        options = self.options(options)
        self._seed(seed, mask)
        with self._gradient():
            self.episodes = self.renew(self.episodes, mask, **options)
            info = self._info(self.episodes, self.episodes.failed, torch.zeros_like(mask), mask, mask)
        self._shown(mask)
        return self._out(self.episodes.observation), self._out(info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict]:
        """One control interval. Actions (n, a) are clipped to [-1, 1]; a row that is not finite counts as zeros."""
        self._open()
        before = self._running()
        action, invalid = self._action(actions)
        with self._gradient():
            next_step = self.autoreset_mode is AutoresetMode.NEXT_STEP
            fresh = before.done if next_step else torch.zeros_like(before.done)
            if fresh.any():
                before = self.renew(before, fresh)
            active = ~(before.done | fresh)
            after, reward, failed = self.advance(before, action, active)
            info = self._info(after, failed, invalid & active, active, active | fresh)
            terminated, truncated = after.terminated, after.truncated
            if self.autoreset_mode is AutoresetMode.SAME_STEP and after.done.any():
                fresh = after.done
                info.update(final_obs=after.observation, _final_obs=fresh, final_info=dict(info), _final_info=fresh)
                after = self.renew(after, fresh)
        self.episodes = after
        self._shown(fresh)
        return (self._out(after.observation), self._out(reward, np.float64), self._out(terminated), self._out(truncated),
                self._out(info))

    def render(self) -> tuple[np.ndarray, ...] | None:
        """By "rgb_array" a picture of each sub-env, (height, width, 3) uint8; by "human" a window shows `tiled`, and None."""
        now = self._running()
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called without a render_mode; give render_mode='rgb_array'")
            return None
        return self.renderer.frames(now, self.num_envs) if self.render_mode == "rgb_array" else self.renderer.show(now)

    def tiled(self) -> np.ndarray:
        """The first 16 sub-envs in one picture, (height, width, 3) uint8; ValueError without a render_mode."""
        now = self._running()
        if self.renderer is None:
            raise ValueError("tiled() was called without a render_mode; render_mode='rgb_array' is wanted")
        return self.renderer.tiled(now)

    def close_extras(self, **kwargs: Any) -> None:
        if self.renderer is not None:
            self.renderer.close()

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

    def _mask(self, options: dict[str, Any]) -> Tensor:
        for name in options:
            if name not in self.OPTIONS:
                raise ValueError(f"the reset option {name!r} was given; there are {', '.join(map(repr, self.OPTIONS))}")
        if options.get("reset_mask") is None:
            return torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        mask = torch.as_tensor(options["reset_mask"], device=self.device)
        if mask.dtype != torch.bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"reset_mask = {mask.tolist()} was given; {self.num_envs} bools, not all False, are wanted")
        if not mask.all():
            self._running()
        return mask

    def _action(self, actions: Any) -> tuple[Tensor, Tensor]:
        action = torch.as_tensor(actions, dtype=self.dtype, device=self.device)
        if action.shape != self.action_space.shape:
            raise ValueError(f"actions of shape {tuple(action.shape)} were given; {self.action_space.shape} is wanted")
        invalid = ~torch.isfinite(action).all(-1)
        return torch.where(invalid[:, None], 0.0, action.clamp(-1, 1)), invalid

    def _info(self, now: Episodes, failed: Tensor, invalid: Tensor, moved: Tensor, begun: Tensor) -> dict[str, Any]:
        """Values with their masks: where the sub-env moved, and for parameters also where it began."""
        info = {**self.measures(now), "solver_failed": failed, "action_invalid": invalid}
        info |= {f"_{name}": moved for name in info}
        params = self.parameters_of(now)
        return {**info, "params": params, "_params": begun} if params else info

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

    def _open(self) -> None:
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError("reset or step was asked for after close(); make a new env")

    def _shown(self, fresh: Tensor) -> None:
        """Let the renderer follow what it draws a trace of."""
        if self.render_mode is None:
            return
        if self.renderer is None:
            from .rendering import Renderer  # pygame is needed by none but those who look

            self.renderer = Renderer(self)
        self.renderer.follow(self.episodes, fresh)
        if self.render_mode == "human":
            self.render()

    def _gradient(self) -> torch.autograd.grad_mode.set_grad_enabled:
        return torch.set_grad_enabled(self.output == "torch" and torch.is_grad_enabled())

    def _out(self, value: Any, dtype: Any = np.float32) -> Any:
        if isinstance(value, dict):
            return {name: self._out(x, dtype) for name, x in value.items()}
        if self.output == "torch":
            return value
        array = value.detach().cpu().numpy()
        return array.astype(dtype) if array.dtype.kind == "f" else array.copy()
