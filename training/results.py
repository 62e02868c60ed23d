"""One command for the table: tasks x (baselines, learners) x seeds, scored on the same held-out
episodes.

    python -m training.results --out out/results       # five tasks at two levels, ten seeds
    python -m training.results --out out/quick --quick # one of them, three seeds, seconds each

Each run writes its own file when it is complete; called again, the command makes what is missing,
goes on with what was interrupted, and writes results.json, .csv, .md, curves.png and policies/ from
all there is. Runs are made seed by seed, each seed of each algorithm in the order that these
are named in, so that all tasks have had as many seeds wherever it is cut off.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch

from torchbeam.extend.commands import results_folder, write

from . import ppo, sac, shac, tuned
from .baselines import BASELINES
from .common import Bar, Budget, train
from .evaluate import EPISODES, evaluate
from .report import report

LEARNERS = {
    "ppo": (ppo.PPO, ppo.Arguments, tuned.PPO),
    "sac": (sac.SAC, sac.Arguments, tuned.SAC),
    "shac": (shac.SHAC, shac.Arguments, tuned.SHAC),
}
SB3 = ("sb3-ppo", "sb3-sac")
ALGORITHMS = (*BASELINES, *LEARNERS, *SB3)
FAILED = ".failed"
QUICK = {"tasks": ["track", "track-uncertain"], "seeds": 3, "minutes": 0.1, "episodes": 32}


def run(
    task_name: str, algorithm: str, seed: int | None, folder: Path, budget: Budget, episodes: int
) -> dict[str, Any]:
    """One run, in its own files; returns what goes into its JSON."""
    torch.set_num_threads(1)
    task, name = tuned.TASKS[task_name], run_name(task_name, algorithm, seed)
    start = time.process_time()
    if algorithm in BASELINES:
        controller = BASELINES[algorithm](task)
        episodes = min(episodes, getattr(controller, "episodes", episodes))
        result = {
            **evaluate(task, controller, episodes),
            "steps": 0,
            "seconds": None,
            "settings": getattr(controller, "settings", {}),
        }
    elif algorithm in LEARNERS:
        learner, arguments, settings = LEARNERS[algorithm]
        settings = {**settings.get(task_name, {}), "seed": seed}
        trained = train(
            learner(task, arguments(**settings)),
            task,
            folder,
            budget,
            name=name,
            progress=False,
            final=episodes,
        )
        result = {**trained, "settings": settings}
    else:
        from . import sb3

        result = sb3.train(
            task,
            algorithm.removeprefix("sb3-"),
            folder,
            budget,
            seed=seed,
            name=name,
            progress=False,
            final=episodes,
        )
    result = {
        "task": task_name,
        "algorithm": algorithm,
        "seed": seed,
        "cpu_minutes_all": (time.process_time() - start) / 60,
        "budget": vars(budget),
        **result,
    }
    write(folder / f"{name}.json", json.dumps(result, indent=2) + "\n")
    (folder / f"{name}{FAILED}").unlink(missing_ok=True)
    return result


def attempt(*arguments: Any) -> str:
    """A run in a process of its own: "" or, where it failed, the last line of why; the rest is in
    NAME.failed.
    """
    try:
        run(*arguments)
    except Exception:
        text = traceback.format_exc()
        write(arguments[3] / f"{run_name(*arguments[:3])}{FAILED}", text)
        return text.strip().splitlines()[-1]
    return ""


def run_name(task: str, algorithm: str, seed: int | None) -> str:
    return f"{task}-{algorithm}" if seed is None else f"{task}-{algorithm}-{seed}"


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m training.results",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    plain = [name for name in ALGORITHMS if name not in SB3]
    parser.add_argument(
        "--tasks",
        nargs="+",
        choices=tuned.TASKS,
        default=tuned.DEFAULT,
        help="default: %(default)s",
    )
    parser.add_argument(
        "--algorithms", nargs="+", choices=ALGORITHMS, default=plain, help="default: %(default)s"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"{' and '.join(QUICK['tasks'])}, {QUICK['seeds']} seeds, "
        f"{60 * QUICK['minutes']:.0f} s of training and {QUICK['episodes']} episodes, where these "
        "are not given",
    )
    parser.add_argument(
        "--seeds", type=int, default=10, help="runs of each learner (default: %(default)s)"
    )
    parser.add_argument(
        "--budget",
        type=int,
        default=2_000_000,
        help="environment steps of a run (default: %(default)s)",
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=2.0,
        help="of training in a run, at most, CPU time (default: %(default)s); results then "
        "depend on the machine",
    )
    parser.add_argument(
        "--episodes",
        type=int,
        default=EPISODES,
        help="held-out, final scores (default: %(default)s)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count(),
        help="processes of one torch thread (default: %(default)s)",
    )
    parser.add_argument("--out", default="out/results", help="default: %(default)s")
    if parser.parse_known_args(argv)[0].quick:
        parser.set_defaults(**QUICK)
    options = parser.parse_args(argv)
    for name in ("seeds", "budget", "episodes", "jobs"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} {getattr(options, name)} was given; at least 1 is wanted")
    if not options.minutes > 0:
        parser.error(f"--minutes {options.minutes} was given; a number above 0 is wanted")
    options.out = results_folder(parser, options.out)
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Train and score whatever is missing, then write the tables and the picture."""
    options = parse(argv)
    out = options.out
    folder = out / "runs"
    folder.mkdir(exist_ok=True)
    wanted = [
        (task, algorithm, None if algorithm in BASELINES else seed)
        for seed in range(options.seeds)
        for algorithm in options.algorithms
        for task in options.tasks
        if seed == 0 or algorithm not in BASELINES
    ]
    missing = [one for one in wanted if not (folder / f"{run_name(*one)}.json").exists()]
    budget = Budget(options.budget, options.minutes)
    print(
        f"{len(wanted)} runs, {len(wanted) - len(missing)} of them done; {options.jobs} processes",
        flush=True,
    )
    failures = {}
    with Bar("runs", True) as bar:
        for count, (one, why) in enumerate(
            outcomes(missing, (folder, budget, options.episodes), options.jobs), 1
        ):
            failures.update({run_name(*one): why} if why else {})
            bar.say(run_name(*one))
            bar.to(count / len(missing))
    for name, why in failures.items():
        print(f"{name} failed: {why}")
    print(report(out))
    return 1 if failures else 0


def outcomes(missing: list[tuple], arguments: tuple, jobs: int) -> Iterator[tuple[tuple, str]]:
    """Each run with what `attempt` said of it, as they end; in this process where jobs = 1."""
    if jobs == 1:
        yield from ((one, attempt(*one, *arguments)) for one in missing)
        return
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # for the processes that are started below
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        started = {pool.submit(attempt, *one, *arguments): one for one in missing}
        for job in as_completed(started):
            try:
                yield started[job], job.result()
            except Exception as error:  # the process died: a later call makes the run again
                yield started[job], repr(error)


if __name__ == "__main__":
    raise SystemExit(main())
