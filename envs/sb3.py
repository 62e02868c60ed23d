"""Sb3VecEnv: the vector environments behind stable-baselines3's interface (extra `rl`).

env = Sb3VecEnv(gymnasium.make_vec("torchbeam/TipReach-v1", 64, autoreset_mode="SameStep"))
stable_baselines3.PPO("MlpPolicy", env).learn(100_000)
"""

from __future__ import annotations

from itertools import repeat
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise ImportError("Sb3VecEnv wants stable-baselines3: pip install 'torchbeam[rl]'") from None


class Sb3VecEnv(VecEnv):
    """A Gymnasium vector env as a stable-baselines3 `VecEnv`: its steps stay one batch.

    The env must reset in the step that ends an episode (autoreset_mode="SameStep") and give numpy.
    `infos[i]` of such a step holds "terminal_observation" and "TimeLimit.truncated", the others
    hold the env's info of sub-env i.

    Examples:
        >>> env = envs.Sb3VecEnv(envs.TipReachVectorEnv(2, elements=2, autoreset_mode="SameStep"))
        >>> env.reset().shape, env.num_envs
        ((2, 17), 2)
    """

    def __init__(self, env: VectorEnv) -> None:
        if (
            env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP
            or getattr(env, "output", "numpy") != "numpy"
        ):
            raise ValueError(
                "an env with another autoreset mode or output was given; "
                'make_vec(..., autoreset_mode="SameStep"), with output="numpy", is wanted'
            )
        self.env = env
        # of the last step: parameters, and a dictionary of each sub-env
        self._params: tuple[dict[str, np.ndarray], list[dict[str, Any]]] = {}, []
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> np.ndarray:
        if any(self._options):
            raise ValueError(
                "options were set for the next reset, which this adapter does not hand on; they "
                "go to that of the vector env, env.env.reset(options=...)"
            )
        given = any(seed is not None for seed in self._seeds)
        observation, info = self.env.reset(seed=list(self._seeds) if given else None)
        self.reset_infos = self._each(info)
        self._reset_seeds()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.env.step(self.actions)
        done = terminated | truncated
        final, last = info.pop("final_obs", None), info.pop("final_info", {})
        infos = self._each(info if final is None else {**info, **last})
        for i in np.flatnonzero(done):
            infos[i]["terminal_observation"] = final[i]
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observation, reward.astype(np.float32), done, infos

    def _each(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        params = info.get("params")
        if params is not None:
            info = {**info, "params": self._of_episodes(params)}
        return _rows(info) or [{} for _ in range(self.num_envs)]

    def _of_episodes(self, params: dict[str, np.ndarray]) -> list[dict[str, Any]]:
        """Rows of what is the same from step to step, but where an episode begins."""
        before, rows = self._params
        if before.keys() != params.keys() or any(
            (params[name] != value).any() for name, value in before.items()
        ):
            self._params = _, rows = params, _rows(params)
        return [row.copy() for row in rows]

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(
            list(self._get_indices(indices))
        )

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def _rows(info: dict[str, Any]) -> list[dict[str, Any]]:
    """A dictionary of each sub-env, of columns (n, ...) by name; masks `_name` are left out."""
    columns = {name: _column(v) for name, v in info.items() if not name.startswith("_")}
    rows = zip(*columns.values(), strict=True)
    return [*map(dict, map(zip, repeat((*columns,)), rows))]


def _column(value: Any) -> list[Any]:
    """By sub-env; of one number each as Python's, all at once."""
    if isinstance(value, list):
        return value
    if isinstance(value, dict):
        return _rows(value)
    return value.tolist() if value.ndim == 1 else list(value)
