"""Tasks, and each learner's settings for them. What is not named here is the default of the
learner's `Arguments`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium
import torchbeam_envs  # noqa: F401  (registers the environments)
from gymnasium.vector import VectorEnv

# first seeds of episodes, far apart; no learner sees those from HELD_OUT on
TRAINING, HELD_OUT = 1_000_000, 2_000_000


@dataclass(frozen=True)
class Task:
    """An environment with its arguments, and what success is in it.

    error      the entry of `info` that is to become small (m)
    tolerance  (m) an episode is a success if the error stays within it over the last `hold` steps,
               and it did not end early
    """

    name: str
    env: str
    arguments: dict[str, Any] = field(default_factory=dict)
    error: str = "distance"
    tolerance: float = 0.03
    hold: int = 10

    def make(self, num_envs: int, **arguments: Any) -> VectorEnv:
        """The vector env; SAME_STEP autoreset unless the arguments say otherwise."""
        return gymnasium.make_vec(
            self.env, num_envs, **{"autoreset_mode": "SameStep", **self.arguments, **arguments}
        )

    def varied(self, **arguments: Any) -> Task:
        """The task with other arguments of the environment."""
        return replace(self, arguments={**self.arguments, **arguments})


TASKS = {
    task.name: task
    for task in (
        Task("reach", "torchbeam/TipReachPlanar-v0", dict(elements=4, substeps=1)),
        Task("track", "torchbeam/TipTrackPlanar-v0", dict(elements=4, substeps=1), hold=50),
        Task(
            "flutter",
            "torchbeam/FlutterHoldPlanar-v0",
            dict(elements=6, substeps=2),
            tolerance=0.01,
        ),
        Task(
            "slew", "torchbeam/SlewPlanar-v0", dict(elements=4, substeps=1), hold=25
        ),  # half a period of the strip
        Task(
            "payload",
            "torchbeam/PayloadPlanar-v1",
            dict(elements=4, substeps=1),
            tolerance=0.01,
            hold=25,
        ),
        Task("reach-3d", "torchbeam/TipReach-v0", dict(elements=4, substeps=1)),
        Task("track-3d", "torchbeam/TipTrack-v0", dict(elements=4, substeps=1), hold=50),
        Task(
            "flutter-3d", "torchbeam/FlutterHold-v0", dict(elements=6, substeps=2), tolerance=0.01
        ),
    )
}

DEFAULT = ("reach", "track", "flutter")  # what the results table is made for unless tasks are named

PPO: dict[str, dict[str, Any]] = {
    "reach": dict(num_envs=32, horizon=50),
    "flutter": dict(num_envs=32, horizon=50),
}
SHAC: dict[str, dict[str, Any]] = {"flutter": dict(rate=5e-3), "flutter-3d": dict(rate=5e-3)}
SB3: dict[str, dict[str, dict[str, Any]]] = {}
