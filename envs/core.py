"""Vector environment: Gymnasium's interface to episodes of a task (reset, step, autoreset)."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import count, one_thread, shown, warn

from .accuracy import resolved
from .config import BeamEnvConfig
from .episodes import Episodes
from .output import converted
from .plant import Plant
from .rendering import Renderer
from .simulation import Simulation
from .streams import Streams
from .task import Task

OUTPUTS = ("numpy", "torch")
RENDER_MODES = ("rgb_array", "human")
OPTIONS = ("reset_mask", "params", "goal")
PARAMS = (
    "info['params'], what an episode's parameters are, is left out from the next minor version on; "
    "params_in_info=True asks for it, params_in_info=False leaves it out now"
)


class BeamVectorEnv(VectorEnv):
    """n episodes of a task, stepped as one batch, behind Gymnasium's vector interface.

    It combines a `Task`, the `Simulation` of its beams and a `Renderer`. A derived class names its
    task; its docstring is the task's specification.

    Args:
        num_envs: sub-envs
        config: the task's configuration, a frozen dataclass (`BeamEnvConfig` or a task's own). Its
            fields may be given as keywords, instead of it or to replace single ones
        autoreset_mode: "NextStep": the step after an episode's last one resets it; its action is
            ignored and its reward 0. "SameStep". "Disabled": an episode that is over stands still,
            reward 0 and flags kept, until reset(options={"reset_mask": (num_envs,) bool})
        output: "numpy": float32 observations, float64 rewards and information, no gradient.
            "torch": tensors in the simulation's dtype, float64; a network in PyTorch's float32
            takes `observation.float()`, or ask for dtype=torch.float32. They have gradients from
            actions (and parameters) to observations and rewards, over all steps since the last
            `detach()`
        render_mode: "rgb_array", "human" or None

    Its parts are `task`, `config` and `simulation`. `scene` is the simulated scene and `state` the
    present state of the episodes. `sensors` are the `torchbeam.sensors` of the observation, to be
    called with any state. env.sensors(env.state.beam) / env.scale is the beam's part of the
    observation, without noise.

    Raises:
        ValueError: for a value of the wrong kind or out of bounds.
        TypeError: for a keyword that does not exist.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True, output="torch")
        >>> observation, _ = env.reset(seed=0)
        >>> push = torch.zeros(2, 1, requires_grad=True)
        >>> observation, reward, *_ = env.step(push)
        >>> torch.autograd.grad(observation.sum(), push)[0].shape
        torch.Size([2, 1])
    """

    task_type: ClassVar[type[Task]] = Task
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012
    # also of an env that was refused: gymnasium up to 1.3 closes what it deletes
    renderer: Renderer | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """help() and editors show the fields of the configuration as keywords."""
        super().__init_subclass__(**kwargs)
        signature = inspect.signature(BeamVectorEnv.__init__)
        named = [
            p
            for p in list(signature.parameters.values())[1:]
            if p.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        named += [
            p.replace(kind=p.KEYWORD_ONLY)
            for p in inspect.signature(cls.task_type.Config).parameters.values()
        ]
        cls.__signature__ = signature.replace(parameters=named)

    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: BeamEnvConfig | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        output: str = "numpy",
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        count("num_envs", num_envs, 1)
        for name, value, wanted in (
            ("output", output, OUTPUTS),
            ("render_mode", render_mode, (None, *RENDER_MODES)),
        ):
            if not isinstance(value, (str, type(None))) or value not in wanted:
                raise ValueError(
                    f"{name} = {shown(value)} was given; {' or '.join(map(repr, wanted))} is wanted"
                )
        modes = {mode.value: mode for mode in AutoresetMode}
        if autoreset_mode not in (*modes, *AutoresetMode):
            raise ValueError(
                f"autoreset_mode = {shown(autoreset_mode)} was given; "
                f"{', '.join(map(repr, modes))} "
                "are there"
            )
        self.num_envs, self.output, self.render_mode = num_envs, output, render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.config = resolved(self.task_type, self._configuration(config, keywords))
        self.task = self.task_type(self.config)
        self.simulation = Simulation(self.task, num_envs)
        self.dtype, self.device, self.high = self.task.dtype, self.task.device, self.simulation.high
        self.metadata = {
            **self.metadata,
            "render_fps": round(min(1 / self.config.control_interval, 1e9)),
            "autoreset_mode": self.autoreset_mode,
        }
        high = self.high.cpu().numpy().astype(np.float32)
        self.single_observation_space, self.single_action_space = (
            Box(-high, high),
            Box(-1, 1, (self.task.actions,)),
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.streams = Streams(num_envs)
        self.episodes: Episodes | None = None
        self._warned = False  # of `params_in_info`
        self._going: Episodes | None = None  # where of the last ones it is known that none is over

    @classmethod
    def _configuration(
        cls, config: BeamEnvConfig | None, keywords: dict[str, Any]
    ) -> BeamEnvConfig:
        kind = cls.task_type.Config
        names = [f.name for f in fields(kind) if f.init]
        for name in keywords:
            if name not in names:
                raise TypeError(
                    f"the keyword {shown(name)} was given to {cls.__name__}; there are "
                    f"{', '.join(names)}"
                )
        if config is None:
            return kind(**keywords)
        if not isinstance(config, kind):
            raise ValueError(
                f"config = {type(config).__name__} was given; a {kind.__name__} is wanted"
            )
        return replace(config, **keywords)

    # The Gymnasium interface

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict]:
        """Fresh episodes for all, or for those in options["reset_mask"], (n,) bool.

        Args:
            seed: s gives sub-env i the stream s + i; a list gives one each; None goes on with the
                streams there are
            options: beside the mask: "params": name -> number or (n,), parameters of these
                episodes; "goal": (g,) or (n, g), in place of a drawn goal. Random numbers are drawn
                all the same, so the rest does not change
        """
        self._open()
        if not (options is None or isinstance(options, Mapping)):
            names = ", ".join(map(repr, OPTIONS))
            raise ValueError(
                f"options = {shown(options)} was given; a dictionary of {names}, or None, is wanted"
            )
        options = dict(options or {})
        mask = self._mask(options)
        options = self.simulation.options(options)
        self.streams.seed(seed, mask)
        with self._computing():
            self.episodes = self._renew(self.episodes, mask, **options)
            info, masks = self._info(
                self.episodes, self.episodes.failed, torch.zeros_like(mask), mask, mask
            )
        self._shown(mask)
        return self._out(self.episodes.observation), self._told({**info, **masks})

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict]:
        """One control interval.

        Actions (n, a) are clipped to [-1, 1]; a row that is not finite counts as zeros.
        """
        observation, reward, terminated, truncated, info, masks = self.stepped(actions)
        return (
            self._out(observation),
            self._out(reward, np.float64),
            self._out(terminated),
            self._out(truncated),
            self._told({**info, **masks}),
        )

    def stepped(
        self, actions: Any
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any], dict[str, Any]]:
        """The same, before it becomes an output: tensors, the masks of the information by
        themselves.
        """
        self._open()
        before = self._running()
        action, invalid = self._action(actions)
        with self._computing():
            done = before.terminated if before is self._going else before.done
            over, fresh = before is not self._going and bool(done.any()), done
            if over and self.autoreset_mode is AutoresetMode.NEXT_STEP:
                before = self._renew(before, fresh)
            elif over:
                fresh = torch.zeros_like(done)
            active = ~done
            after, reward, failed = self.simulation.advance(
                before, action, active if over else None
            )
            going = not over and failed is None and self.config.max_episode_steps is None
            failed = done if failed is None else failed  # which is False throughout
            invalid = done if invalid is None else invalid & active
            info, masks = self._info(
                after, failed, invalid, active, active | fresh if over else active
            )
            observation, terminated = after.observation, after.terminated
            truncated = after.truncated
            if self.autoreset_mode is AutoresetMode.SAME_STEP and (done := after.done).any():
                final = dict(
                    final_obs=observation,
                    _final_obs=done,
                    final_info={**info, **masks},
                    _final_info=done,
                )
                fresh, after = done, self._renew(after, done)
                observation, failed = after.observation, torch.where(fresh, after.failed, failed)
                info, masks = self._info(after, failed, invalid & ~fresh, active & ~fresh, active)
                masks.update(final)
        self.episodes, self._going = after, after if going else None
        self._shown(fresh)
        return observation, reward, terminated, truncated, info, masks

    def render(self) -> tuple[np.ndarray, ...] | None:
        """By "rgb_array" a picture of each sub-env, (height, width, 3) uint8; by "human" a window
        shows `tiled`, and None.
        """
        now = self._running()
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() was called without a render_mode; give render_mode='rgb_array'"
            )
            return None
        return (
            self.renderer.frames(now, self.num_envs)
            if self.render_mode == "rgb_array"
            else self.renderer.show(now)
        )

    def tiled(self) -> np.ndarray:
        """The first 16 sub-envs in one picture, (height, width, 3) uint8; ValueError without a
        render_mode.
        """
        now = self._running()
        if self.renderer is None:
            raise ValueError(
                "tiled() was called without a render_mode; render_mode='rgb_array' is wanted"
            )
        return self.renderer.tiled(now)

    def close_extras(self, **kwargs: Any) -> None:
        if self.renderer is not None:
            self.renderer.close()

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """The generators of the sub-envs."""
        return tuple(self.streams.made().generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:
        """Seeds of the generators; -1 for a generator that was passed."""
        return tuple(self.streams.made().seeds)

    # What it is made of

    @property
    def max_episode_steps(self) -> int | None:
        return self.config.max_episode_steps

    @property
    def plant(self) -> Plant:
        """Of the usual parameters."""
        return self.simulation.plant

    @property
    def scene(self) -> tb.Scene:
        """Current scene, with the inputs of the actuators; before the first reset, at the usual
        parameters.
        """
        return (self.plant if self.episodes is None else self.episodes.plant).scene

    @property
    def start(self) -> tb.State:
        """Reference state of displacements, batch (n,)."""
        return self.simulation.rest[0] if self.episodes is None else self.episodes.start

    @property
    def sensors(self) -> tb.sensors.Stack:
        """Sensors of the observation, in their own units; see `scale`."""
        return self.simulation.sensors(self.episodes)

    @property
    def scale(self) -> Tensor:
        """Divisor (o,) or (n, o) of the readings of `sensors`."""
        return self.simulation.observer.scale

    # Differentiable use

    @property
    def state(self) -> Episodes:
        """State of all episodes: tensors, in the graph."""
        return self._running()

    def set_state(self, state: Episodes) -> Any:
        """Go on from a state got earlier; returns its observation. The streams of random numbers
        stay where they are.
        """
        if not isinstance(state, Episodes) or len(state.steps) != self.num_envs:
            raise ValueError(
                f"a state of {type(state).__name__} was given; Episodes of {self.num_envs} "
                "sub-envs are wanted"
            )
        self.episodes = state
        return self._out(state.observation)

    def detach(self) -> None:
        """Cut the graph here: later gradients do not reach earlier intervals."""
        self.episodes = self._running().detach()

    def initialize_trajectory(self) -> Any:
        """Start a window: detach, and return the observation it starts with."""
        self.detach()
        return self._out(self.episodes.observation)

    # Inside

    def _renew(self, episodes: Episodes | None, mask: Tensor, **options: Any) -> Episodes:
        return self.simulation.renew(episodes, mask, self.streams.generators, **options)

    def _mask(self, options: dict[str, Any]) -> Tensor:
        for name in options:
            if name not in OPTIONS:
                raise ValueError(
                    f"the reset option {shown(name)} was given; there are "
                    f"{', '.join(map(repr, OPTIONS))}"
                )
        given = options.get("reset_mask")
        if given is None:
            return torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        try:
            mask = torch.as_tensor(given, device=self.device)
        except (TypeError, ValueError, RuntimeError, OverflowError):
            mask = torch.zeros(())
        if mask.dtype != torch.bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask = {shown(given)} was given; {self.num_envs} bools, not all False, are "
                "wanted"
            )
        if not mask.all():
            self._running()
        return mask

    def _action(self, actions: Any) -> tuple[Tensor, Tensor | None]:
        """Actions within [-1, 1], and which were no numbers, None = all were."""
        wanted = getattr(actions, "requires_grad", False) and torch.is_grad_enabled()
        if wanted and self.output == "numpy":
            raise ValueError(
                "actions that carry gradient were given to an env with output='numpy', whose "
                "rewards have none; output='torch', or actions.detach(), is wanted"
            )
        try:
            action = torch.as_tensor(actions, dtype=self.dtype, device=self.device)
        except (TypeError, ValueError, RuntimeError, OverflowError):
            raise ValueError(
                f"actions = {shown(actions)} were given; numbers {self.action_space.shape} are "
                "wanted"
            ) from None
        if action.shape != self.action_space.shape:
            raise ValueError(
                f"actions of shape {tuple(action.shape)} were given; {self.action_space.shape} "
                "is wanted"
            )
        clipped = action.clamp(-1, 1)
        if torch.equal(clipped, action):  # within the bounds, and numbers
            return clipped, None
        invalid = ~(action.abs() < torch.inf).all(-1)
        return torch.where(invalid[:, None], 0.0, clipped), invalid

    def _info(
        self, now: Episodes, failed: Tensor, invalid: Tensor, moved: Tensor, begun: Tensor
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Values and their masks: where the sub-env moved, and for parameters also where it
        began.
        """
        info = {**now.measures, "solver_failed": failed, "action_invalid": invalid}
        masks = {f"_{name}": moved for name in info}
        params = self.simulation.parameters_of(now)
        if not params or self.config.params_in_info not in (None, True):
            return info, masks
        if self.config.params_in_info is None and not self._warned:
            self._warned = True
            warn(PARAMS, DeprecationWarning)
        return {**info, "params": params}, {**masks, "_params": begun}

    def _running(self) -> Episodes:
        if self.episodes is None:
            raise gymnasium.error.ResetNeeded(
                "step or state was asked for before reset(); call reset() first"
            )
        return self.episodes

    def _open(self) -> None:
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError(
                "reset or step was asked for after close(); make a new env"
            )

    def _shown(self, fresh: Tensor) -> None:
        """Let the renderer follow what it draws a trace of."""
        if self.render_mode is None:
            return
        if self.renderer is None:
            self.renderer = Renderer(
                self.task, self.simulation.rest[0].position[0], self.num_envs, type(self).__name__
            )
        self.renderer.follow(self.episodes, fresh)
        if self.render_mode == "human":
            self.render()

    @contextmanager
    def _computing(self) -> Iterator[None]:
        """With gradients where they are wanted; few sub-envs on one thread."""
        wanted = self.output == "torch" and torch.is_grad_enabled()
        with one_thread(6 * self.num_envs * self.scene.beam.node_count):
            with torch.set_grad_enabled(wanted):
                yield

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        """The information as an output: float64, but for an observation in it."""
        told = self._out(info, np.float64)
        if "final_obs" in info:
            told["final_obs"] = self._out(info["final_obs"])
        return told

    def _out(self, value: Any, dtype: Any = np.float32) -> Any:
        return converted(value, self.output, dtype)
