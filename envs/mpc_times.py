"""MPC times: how long predictive control takes an interval, beside the interval."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import gymnasium
import numpy as np

from torchbeam.extend.commands import table

from .baselines import MPC

# of one beam in a plane, whose targets are moved, or not known to any force that holds them
TASKS = "TipReach", "TipTrack", "Slew", "Payload", "FlutterHold"
ELEMENTS, HORIZON = 4, 25
FIRST = 5  # intervals of each episode that do not count: those that compile, and that fill caches


class IntervalTimes(NamedTuple):
    """One line of the table; s, but for the names."""

    id: str
    substeps: int
    actions: int
    intervals: int  # timed, of episodes from several seeds
    interval: float  # that a control interval is long
    median: float
    most: float  # 99 of 100 take no longer
    processor: float  # median of the time that the thread had the processor


FIELDS = (
    "task",
    "steps an interval",
    "actions",
    "intervals",
    "interval, ms",
    "median, ms",
    "99 %, ms",
    "processor, median, ms",
)
COLUMNS = tuple(name.replace(", ms", ", s") for name in FIELDS)  # of the CSV, as measured


def measure(
    id: str, substeps: int, episodes: int, elements: int = ELEMENTS, horizon: int = HORIZON
) -> IntervalTimes:
    """Times from an observation to its action over whole episodes of one env, at seeds 0, 1, ..."""
    env = gymnasium.make_vec(id, num_envs=1, elements=elements, substeps=substeps)
    controller, wall, own = MPC(env, horizon), [], []
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        controller.begin(env)
        for k in range(env.unwrapped.max_episode_steps):
            start, used = time.perf_counter(), time.thread_time()
            action = controller(observation)
            if k >= FIRST:
                wall.append(time.perf_counter() - start)
                own.append(time.thread_time() - used)
            observation, *_ = env.step(action)
    interval, actions = env.unwrapped.config.control_interval, env.unwrapped.task.actions
    env.close()
    median, most = np.quantile(wall, (0.5, 0.99)).tolist()
    return IntervalTimes(
        id, substeps, actions, len(wall), interval, median, most, float(np.median(own))
    )


def rows(ids: Iterable[str], episodes: int) -> Iterator[IntervalTimes]:
    """By one step an interval, and by two."""
    for id in ids:
        for substeps in (1, 2):
            yield measure(id, substeps, episodes)


def markdown(rows: Iterable[IntervalTimes]) -> str:
    lines = [
        (
            r.id,
            f"{r.substeps}",
            f"{r.actions}",
            f"{r.intervals}",
            *(f"{1e3 * t:.3g}" for t in (r.interval, r.median, r.most, r.processor)),
        )
        for r in rows
    ]
    return table(FIELDS, lines, words=1)
