"""SingleEnv: a vector env with one member, as a plain Gymnasium env."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from torchbeam.extend import shown

from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .output import converted

MANY = ("num_envs", "autoreset_mode", "output")  # arguments of a vector env alone


class SingleEnv(gymnasium.Env):
    """One member of the class attribute `vector`; takes its arguments, but num_envs, autoreset_mode
    and output. `config` and `state` are as there; env.one, of one sub-env, has the rest.

    Examples:
        >>> env = envs.TipReachEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, terminated, truncated
        ((11,), False, False)
    """

    vector: ClassVar[type[BeamVectorEnv]]
    metadata = BeamVectorEnv.metadata

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """help() and editors show the keywords of `vector`."""
        super().__init_subclass__(**kwargs)
        theirs = inspect.signature(cls.vector)
        cls.__signature__ = theirs.replace(
            parameters=[p for name, p in theirs.parameters.items() if name not in MANY]
        )

    def __init__(
        self,
        *,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **arguments: Any,
    ) -> None:
        for name in MANY:
            if name in arguments:
                raise ValueError(
                    f"{name} was given; a single env has none, {self.vector.__name__} does"
                )
        self.one = self.vector(
            1,
            max_episode_steps=max_episode_steps,
            render_mode=render_mode,
            autoreset_mode=AutoresetMode.DISABLED,
            **arguments,
        )
        self.render_mode, self.metadata = render_mode, self.one.metadata
        self.observation_space, self.action_space = (
            self.one.single_observation_space,
            self.one.single_action_space,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        if isinstance(seed, Sequence) and not isinstance(seed, str):
            raise ValueError(f"seed = {shown(seed)} was given; one whole number is wanted")
        # says so where the seed is none
        observation, info = self.one.reset(seed=seed, options=options)
        super().reset(seed=seed)
        return observation[0], _first(info)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        observation, reward, terminated, truncated, info, _ = self.one.stepped(
            np.asarray(action)[None]
        )
        return (
            converted(observation[0], "numpy"),
            reward.item(),
            terminated.item(),
            truncated.item(),
            _first(info),
        )

    def render(self) -> np.ndarray | None:
        frames = self.one.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        self.one.close()

    @property
    def config(self) -> BeamEnvConfig:
        return self.one.config

    @property
    def state(self) -> Episodes:
        """The present state, a batch of one."""
        return self.one.state

    @property
    def np_random(self) -> np.random.Generator:
        return self.one.np_random[0]

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self.one.streams.put(0, value)

    @property
    def np_random_seed(self) -> int:
        return self.one.np_random_seed[0]


def _first(info: dict) -> dict:
    values = {name: value for name, value in info.items() if not name.startswith("_")}
    return {
        name: _first(value) if isinstance(value, dict) else value.item()
        for name, value in values.items()
    }
