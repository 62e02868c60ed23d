"""Benchmark of a task: steps a second, share of the simulation in that time, error of mesh and
step.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch

from torchbeam.extend.commands import (
    measured_on,
    measurement,
    results_folder,
    sentence,
    table,
    threads,
    versions,
    write_results,
)

from . import mpc_times, reset_times
from .plant import Plant
from .uncertain import UNCERTAIN

IDS = {  # of the newest version, by name
    spec.name: spec.id
    for spec in sorted(gymnasium.registry.values(), key=lambda spec: spec.version or 0)
    if spec.namespace == "torchbeam" and "form" not in spec.kwargs  # none that is explicit
}
TASKS = [name for name in IDS if not name.endswith("Planar")]  # in space, and in a plane if it is
BATCHES = (1, 64, 256, 1024, 4096)
FINER = dict(elements=16, substeps=8)  # what the tip is compared with; or twice the elements
SWINGS, HELD = 4, 10  # episodes compared, and the intervals for which they hold an action
STEPS = 12  # timed for the share of the simulation, after two more


class Throughput(NamedTuple):
    """One line of the table."""

    id: str
    batch: int
    rate: float  # env steps a second, by `gymnasium.utils.performance.benchmark_vector_step`
    realtime: float  # simulated s per s
    overhead: float  # time of step() that is not simulation, over the time that is
    error: float | None  # RMS of the tip's error over one episode, over the RMS of its motion


FIELDS = (
    "task",
    "batch",
    "env steps a second",
    "simulated s per s",
    "stepping and observing, over simulation",
    "error of the tip",
)


@contextmanager
def clocked() -> Iterator[Callable[[], float]]:
    """A function for the seconds that beams have been simulated for since."""
    advance, spent = Plant.advance, 0.0

    def timed(*args: Any) -> Any:
        nonlocal spent
        start = time.perf_counter()
        after = advance(*args)
        spent += time.perf_counter() - start
        return after

    Plant.advance = timed
    try:
        yield lambda: spent
    finally:
        Plant.advance = advance


def overhead(id: str, batch: int, **arguments: Any) -> float:
    """Time of step() beside the simulation over that of the simulation, median over steps with
    actions drawn beforehand.
    """
    env = gymnasium.make_vec(id, num_envs=batch, **arguments)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(STEPS + 2)]
    env.reset(seed=0)
    shares = []
    with clocked() as simulated:
        for action in actions:
            before, start = simulated(), time.perf_counter()
            env.step(action)
            whole = time.perf_counter() - start
            if spent := simulated() - before:  # not a reset of all
                shares.append(whole / spent - 1)
    return float(np.median(shares[2:]))


def error(id: str, **arguments: Any) -> float | None:
    """RMS over an episode of the distance between the tip and that of the same task on 16 elements
    (or twice its own, if more) with 8 steps an interval, over the RMS of its way; under actions
    held for 10 intervals each.
    None where an episode ends before its time.
    """

    def tips(**finer: Any) -> torch.Tensor | None:
        env = gymnasium.make_vec(
            id, num_envs=SWINGS, autoreset_mode="Disabled", **{**arguments, **finer}
        )
        env.reset(seed=0)
        positions = [env.state.beam.position[:, -1]]
        steps = range(env.max_episode_steps)
        actions = np.random.default_rng(0).uniform(
            -0.5, 0.5, (len(steps) // HELD + 1, *env.action_space.shape)
        )
        for k in steps:
            env.step(actions[k // HELD])
            positions.append(env.state.beam.position[:, -1])
        return None if env.state.terminated.any() else torch.stack(positions)

    config = gymnasium.make_vec(id, num_envs=1, **arguments).config
    finer = {name: max(value, 2 * getattr(config, name)) for name, value in FINER.items()}
    coarse, fine = tips(), tips(**finer)
    if coarse is None or fine is None:
        return None
    return (
        ((coarse - fine).square().sum(-1).mean() / (fine - fine[0]).square().sum(-1).mean())
        .sqrt()
        .item()
    )


def measure(id: str, batches: Sequence[int], seconds: float, **arguments: Any) -> list[Throughput]:
    try:
        from gymnasium.utils.performance import benchmark_vector_step
    except ImportError:
        raise RuntimeError(
            f"gymnasium {gymnasium.__version__} was given; 1.4 is wanted, the first that can "
            "measure"
        ) from None

    rows, off = [], error(id, **arguments)
    for batch in batches:
        env = gymnasium.make_vec(id, num_envs=batch, **arguments)
        rate = benchmark_vector_step(env, seconds, seed=0)
        rows.append(
            Throughput(
                id,
                batch,
                rate,
                rate * env.config.control_interval,
                overhead(id, batch, **arguments),
                off,
            )
        )
        print(f"{id}, batch {batch}: {rate:.0f} env steps a second", file=sys.stderr)
        env.close()
    return rows


def rows(quick: bool) -> Iterator[measurement.Measured]:
    """Steps a second for `python -m studies bench`: one env in space through `gymnasium.make`,
    and a batch in the plane.
    """
    for id, batch in (
        ("torchbeam/TipReach-v1", 1),
        ("torchbeam/TipReachPlanar-v1", 64 if quick else 1024),
    ):
        env = gymnasium.make(id) if batch == 1 else gymnasium.make_vec(id, num_envs=batch)
        env.action_space.seed(0)
        env.reset(seed=0)
        actions = [env.action_space.sample() for _ in range(STEPS if quick else 5 * STEPS)]

        def run(env: Any = env, actions: list[Any] = actions, single: bool = batch == 1) -> None:
            for action in actions:
                *_, terminated, truncated, _ = env.step(action)
                if single and (terminated or truncated):
                    env.reset()

        (times,) = measurement.timed([run], 2 if quick else 5)
        yield (
            row := times.row(
                "environments", id, unit="env steps a second", per=batch * len(actions), batch=batch
            )
        )
        yield measurement.Measured.of(
            "environments",
            f"{id}: stepping and observing, over simulation",
            overhead(id, batch),
            "",
            batch=batch,
        )
        measurement.progress(f"{id}, batch {batch}: {row.best:.0f} env steps a second")
        env.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Measure steps a second of an environment by batch, in space and in a plane, and accuracy."""
    parser = argparse.ArgumentParser(
        prog="python -m torchbeam envs",
        description=(
            "Env steps a second by gymnasium's benchmark_vector_step, in space and in the plane; "
            "beside them the time that is not simulation and the error of the task's mesh and "
            "step. Writes envs.csv, envs.md and envs.json (with machine and versions). With --mpc, "
            "in their place: how long predictive control takes an interval of one env; with "
            "--resets: what resets of uncertain plants, and the interface of stable-baselines3, "
            "cost in steps."
        ),
    )
    parser.add_argument("--task", choices=TASKS, default="TipReach", help="default: %(default)s")
    parser.add_argument(
        "--batches",
        type=int,
        nargs="+",
        default=BATCHES,
        metavar="N",
        help=f"sub-envs (default: {' '.join(map(str, BATCHES))})",
    )
    parser.add_argument(
        "--seconds", type=float, default=2.0, help="for each measurement (default: %(default)s)"
    )
    parser.add_argument(
        "--mpc",
        type=int,
        metavar="EPISODES",
        help=f"time MPC in so many episodes of {', '.join(mpc_times.TASKS)}, in the plane, on "
        f"{mpc_times.ELEMENTS} elements, over {mpc_times.HORIZON} intervals ahead; writes mpc.csv, "
        "mpc.md and mpc.json",
    )
    parser.add_argument(
        "--resets",
        type=int,
        metavar="ROUNDS",
        help=f"time resets of {', '.join(UNCERTAIN)} at the uncertain level so often, by processor "
        f"time, of {', '.join(map(str, reset_times.BATCHES))} sub-envs; writes resets.csv, "
        "resets.md and resets.json",
    )
    parser.add_argument("--threads", type=int, default=1, help="of torch (default: %(default)s)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/envs"),
        help="folder for the results (default: %(default)s)",
    )
    given = parser.parse_args(argv)
    for name, least in (
        ("batches", min(given.batches)),
        ("threads", given.threads),
        ("mpc", 1 if given.mpc is None else given.mpc),
        ("resets", 1 if given.resets is None else given.resets),
    ):
        if least < 1:
            parser.error(f"--{name} {least} was given; at least 1 is wanted")
    if not 0 < given.seconds < math.inf:
        parser.error(f"--seconds {given.seconds:g} was given; a positive number is wanted")
    out = results_folder(parser, given.out)
    with threads(given.threads):
        if given.resets is not None:
            ids = [IDS[task + plane] for task in UNCERTAIN for plane in ("", "Planar")]
            name, fields = "resets", reset_times.COLUMNS
            rows = [*reset_times.rows(ids, given.resets)]
            text = reset_times.markdown(rows)
            more = {"share": reset_times.SHARE}
        elif given.mpc is None:
            name, fields, rows = "envs", FIELDS, [*throughput(given)]
            text, more = markdown(rows), {"reference": FINER}
        else:
            ids = [IDS[task + "Planar"] for task in mpc_times.TASKS]
            name, fields = "mpc", mpc_times.COLUMNS
            rows = [*mpc_times.rows(ids, given.mpc)]
            text = mpc_times.markdown(rows)
            more = {"elements": mpc_times.ELEMENTS, "horizon": mpc_times.HORIZON}
        heading = measured_on()
    heading["versions"] |= versions(
        "llvmlite", *(["stable-baselines3"] if given.resets is not None else [])
    )
    text = f"{text}\n\n{sentence(heading)}"
    print(text)
    data = {**heading, **more, "rows": [row._asdict() for row in rows]}
    write_results(out, name, text, data, fields, rows)
    return 0


def throughput(given: argparse.Namespace) -> Iterator[Throughput]:
    """Of a task, in space and in the plane, where there is one."""
    for plane in ("", "Planar"):
        if given.task + plane in IDS:
            yield from measure(IDS[given.task + plane], given.batches, given.seconds)


def markdown(rows: Sequence[Throughput]) -> str:
    lines = [
        (
            r.id,
            f"{r.batch}",
            f"{r.rate:.0f}",
            f"{r.realtime:.1f}",
            f"{100 * r.overhead:.0f} %",
            "" if r.error is None else f"{100 * r.error:.1f} %",
        )
        for r in rows
    ]
    return table(FIELDS, lines, words=1)
