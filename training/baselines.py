"""The package's baselines, tuned for a task on training episodes: never on those that scores come
from.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torchbeam_envs.baselines import (
    LQG,
    LQR,
    MPC,
    PD,
    Controller,
    JointLQG,
    JointLQR,
    Optimum,
    ResolvedRate,
    Static,
    ViaPoint,
    Waypoints,
    Zero,
    search,
)

from .evaluate import evaluate, make
from .tuned import HIDDEN, PUBLISHED, REMEMBERING, TRAINING, Task
from .ways import RESOLVED, VIAS, WAYS

EPISODES = 16  # that tuning looks at
SETS = 24  # of gains in a round of the search
# what LQR and LQG choose from: weights of the action, of the tip's velocity
EFFORTS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
# by how many intervals actions are taken to be later, where it is drawn; held actions of a schedule
LATENCIES, SCHEDULES = (0, 1, 2), (1, 3, 5)
# deviations that a filter reckons with, of the actions' disturbance and of their noise
DISTURBANCES, ACTIONS = (0.0, 0.003, 0.01, 0.03, 0.1), (0.03, 0.1, 0.3, 1.0)
START = {"effort": 0.1, "speed_weight": 0.1, "action": 0.1}  # of the search; of others the least
STARTS = 3  # of the optimum
# by baseline, how many of the episodes that scores come from it plays at most, the first of them
MOST_EPISODES = {"optimum": 64}


def pd(task: Task) -> Controller:
    """Gains by random search."""
    env = make(task, 1)
    env.reset(seed=0)
    controller = PD(env, [1.0, 3.0] * env.task.tracking_error(env.state)[0].shape[-1])

    def score(gains: torch.Tensor) -> torch.Tensor:
        together = make(task, len(gains) * EPISODES)
        controller.gains = gains.repeat_interleave(EPISODES, 0)
        cost = -returns(together, controller, [TRAINING + i for i in range(EPISODES)] * len(gains))
        return cost.unflatten(0, (-1, EPISODES)).mean(1)

    best, _ = search(score, controller.gains[0].tolist(), sets=SETS, seed=0)
    controller.gains = best[None]
    controller.settings = {"gains": best.tolist()}
    return controller


@torch.no_grad()
def returns(env, controller: Controller, seeds: list[int]) -> torch.Tensor:
    """(n,): of one episode each."""
    observation, _ = env.reset(seed=seeds)
    controller.begin(env)
    total = 0.0
    while not env.state.done.all():
        observation, reward, *_ = env.step(controller(observation))
        total = total + reward
    return total


def settings(kind: type[Controller], task: Task) -> dict[str, tuple[float, ...]]:
    """What of a regulator is tuned, one after the other in this order: values by name, rising."""
    tried: dict[str, tuple[float, ...]] = {"effort": EFFORTS, "speed_weight": SPEEDS}
    if "latency" in (task.arguments.get("randomize") or {}):
        tried["latency"] = LATENCIES
    if issubclass(kind, (LQG, JointLQG)):
        tried |= {"disturbance": DISTURBANCES, "action": ACTIONS}
    if issubclass(kind, LQR):
        tried["schedule"] = SCHEDULES
    return tried


def climbed(
    chosen: dict[str, float],
    name: str,
    values: tuple[float, ...],
    score: Callable[[dict[str, float]], float],
) -> dict[str, float]:
    """The settings with that value of one of them from which its neighbours score no more: up from
    where it stands as long as the score rises, or else down.
    """
    start = chosen.get(name, START.get(name))
    each = [{**chosen, name: value} for value in values]
    at = values.index(start) if start in values else 0
    for way in (1, -1):
        while 0 <= at + way < len(each) and score(each[at + way]) > score(each[at]):
            at += way
    return each[at]


def regulated(kind: type[LQR]) -> Callable[[Task], Controller]:
    def made(task: Task) -> Controller:
        """The settings of most return, one after the other; then the effort again."""
        env = make(task, 1)
        # where a hub or a hinge turns, about where it is to rest
        used = kind if env.task.HOLDS else {LQR: JointLQR, LQG: JointLQG}[kind]
        together = make(task, EPISODES)
        scores: dict[tuple, float] = {}

        def score(chosen: dict[str, float]) -> float:
            key = tuple(sorted(chosen.items()))
            if key not in scores:
                controller = used(env, **chosen)
                scores[key] = evaluate(task, controller, EPISODES, TRAINING, together)["return"]
            return scores[key]

        tried, chosen = settings(used, task), {}
        for name in (*tried, "effort"):
            chosen = climbed(chosen, name, tried[name], score)
        controller = used(env, **chosen)
        controller.settings = chosen
        return controller

    return made


def optimum(task: Task) -> Controller:
    """From what the tuned LQR does, and near it."""
    return Optimum(make(task, 1), regulated(LQR)(task), starts=STARTS)


def resolved_rate(task: Task) -> Controller:
    settings = RESOLVED.get(task.name, {})
    controller = ResolvedRate(make(task, 1), **settings)
    controller.settings = settings
    return controller


def waypoints(task: Task) -> Controller:
    controller = Waypoints(make(task, 1), **WAYS[task.name])
    controller.settings = WAYS[task.name]
    return controller


def via_point(task: Task) -> Controller:
    controller = ViaPoint(make(task, 1), **VIAS[task.name])
    controller.settings = VIAS[task.name]
    return controller


BASELINES: dict[str, Callable[[Task], Controller]] = {
    "zero": lambda task: Zero(),
    "static": lambda task: Static(make(task, 1)),
    "pd": pd,
    "lqr": regulated(LQR),
    "lqg": regulated(LQG),
    "mpc": lambda task: MPC(make(task, 1)),
    "mpc-informed": lambda task: MPC(make(task, 1), informed=True),
    "optimum": optimum,
    "resolved-rate": resolved_rate,
    "waypoints": waypoints,
    "via-point": via_point,
}
LEADING = ("zero", "resolved-rate")  # of `PUBLISHED` tasks, whose actions hold no beam


def leading(task: str) -> tuple[str, ...]:
    """Those of a published task."""
    ways = {"waypoints": WAYS, "via-point": VIAS}
    return (*LEADING, *(name for name, tasks in ways.items() if task in tasks))


def applies(algorithm: str, task: str) -> bool:
    """Whether there is such a baseline for the task; a learner that remembers is where the plant is
    hidden, any other everywhere.
    """
    if algorithm in REMEMBERING:
        return task in HIDDEN
    if task in PUBLISHED:
        return algorithm in leading(task) or algorithm not in BASELINES
    return algorithm not in ("resolved-rate", "waypoints", "via-point")
