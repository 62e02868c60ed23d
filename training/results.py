"""One command for the table: tasks x (baselines, learners) x seeds, scored on the same held-out
episodes, and on held-out plants outside of the training range.

    python -m training.results --out out/results       # the study, `PLAN`
    python -m training.results --out out/quick --quick # two tasks, three seeds, seconds each

The whole study is 594 runs and takes about thirteen CPU hours (SHAC, PPO and SAC 10 seeds on five
tasks at two levels; a student and SHAC with a memory 10 seeds on five uncertain tasks, PPO and SAC
with one 3; SHAC and PPO 5 seeds on two in space at two levels, SHAC with a memory 5 at the
uncertain one; stable-baselines3 and skrl 3 seeds on four; baselines once each; published tasks are
made by `training.published`). Budgets are environment steps, by `tuned.BUDGETS`: results do not
depend on how busy or fast the machine is.

Each run writes its own file when it is complete; called again, the command makes what is missing
or was made on another task, with other settings, another budget or other episodes, goes on with
what was interrupted, and writes results.json, .csv, .md, curves.png and policies/ from all there
is. Runs are made seed by seed, each seed of each algorithm in the order that these are named in, so
that all tasks have had as many seeds wherever it is cut off.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
import torchbeam_envs

import torchbeam
from torchbeam.extend.commands import measured_on, process_pool, results_folder, write

from . import ppo, sac, shac, student, tuned
from .baselines import BASELINES, MOST_EPISODES, applies
from .common import train
from .evaluate import EPISODES, scores
from .evaluate import make as validation_env
from .options import above_zero
from .report import report
from .table import as_now
from .watch import SHARES, VALIDATIONS, Bar, Budget, validation

LEARNERS = {
    "ppo": (ppo.PPO, ppo.Arguments, tuned.PPO),
    "sac": (sac.SAC, sac.Arguments, tuned.SAC),
    "shac": (shac.SHAC, shac.Arguments, tuned.SHAC),
    "student": (student.Student, student.Arguments, tuned.STUDENT),
    "ppo-gru": (ppo.PPO, ppo.Arguments, tuned.PPO_GRU),
    "sac-gru": (sac.SAC, sac.Arguments, tuned.SAC_GRU),
    "shac-gru": (shac.SHAC, shac.Arguments, tuned.SHAC_GRU),
}
LIBRARIES = ("sb3-ppo", "sb3-sac", "skrl-ppo")
ALGORITHMS = (*BASELINES, *LEARNERS, *LIBRARIES)
FAILED = ".failed"

SPACE_UNCERTAIN = ("reach-3d-uncertain", "track-3d-uncertain")
SPACE = ("reach-3d", "track-3d", *SPACE_UNCERTAIN)
UNCERTAIN = tuple(name for name in tuned.DEFAULT if name.endswith("-uncertain"))
COMPARED = ("reach", "track", "reach-uncertain", "track-uncertain")
# the study: algorithms, tasks, seeds
PLAN = (
    (("zero", "static", "lqr", "lqg"), (*tuned.DEFAULT, *SPACE), 1),
    (("shac", "ppo", "sac"), tuned.DEFAULT, 10),
    (("shac", "ppo"), SPACE, 5),
    (LIBRARIES, COMPARED, 3),
    (("mpc",), (*tuned.DEFAULT, *SPACE), 1),
    (("mpc-informed",), ("payload", *UNCERTAIN, *SPACE_UNCERTAIN), 1),  # elsewhere no more is known
    (("student", "shac-gru"), UNCERTAIN, 10),
    (("shac-gru",), SPACE_UNCERTAIN, 5),
    (("ppo-gru", "sac-gru"), UNCERTAIN, 3),  # far behind SHAC with one
)
SEEDS = max(seeds for *_, seeds in PLAN)
QUICK: dict[str, Any] = {
    "tasks": ["track", "track-uncertain"],
    "algorithms": ["zero", "lqg", "shac", "ppo", "sac"],
    "seeds": 3,
    "share": 0.2,
    "episodes": 32,
}


class Run(NamedTuple):
    """One of the study; the seed of a baseline is None."""

    task: str
    algorithm: str
    seed: int | None

    @property
    def name(self) -> str:
        own = f"{self.task}-{self.algorithm}"
        return own if self.seed is None else f"{own}-{self.seed}"

    @property
    def settings(self) -> dict[str, Any]:
        """All that a learner is made with."""
        if self.algorithm in LEARNERS:
            _, arguments, own = LEARNERS[self.algorithm]
            return vars(arguments(**own.get(self.task, {}), seed=self.seed))
        library, _, algorithm = self.algorithm.partition("-")
        own = tuned.SB3[algorithm] if library == "sb3" else tuned.SKRL
        return {**own, "frames": tuned.frames(self.task), "seed": self.seed}

    @property
    def environment(self) -> dict[str, Any]:
        """What it is made and judged on."""
        return {**vars(tuned.TASKS[self.task]), "validated": [VALIDATIONS, *SHARES]}


def make(run: Run, folder: Path, budget: Budget, episodes: int) -> dict[str, Any]:
    """One run, in its own files; returns what goes into its JSON."""
    torch.set_num_threads(1)
    commit()  # of the code that runs, whatever is written meanwhile
    (folder / f"{run.name}.json").unlink(missing_ok=True)  # its log is written anew
    task, start = tuned.TASKS[run.task], time.process_time()
    options: dict[str, Any] = dict(name=run.name, progress=False, final=episodes)
    if run.algorithm in BASELINES:
        controller = BASELINES[run.algorithm](task)
        settings = getattr(controller, "settings", {})
        judge = validation_env(task, tuned.FEW.get(run.task, VALIDATIONS))
        seen = validation(task, controller, judge)
        result = {**seen, **scores(task, controller, episodes), "steps": 0, "seconds": None}
    elif run.algorithm in LEARNERS:
        learner, arguments, _ = LEARNERS[run.algorithm]
        settings = run.settings
        result = train(learner(task, arguments(**settings)), task, folder, budget, **options)
    else:
        library, _, algorithm = run.algorithm.partition("-")
        settings = run.settings
        if library == "sb3":
            from . import sb3

            result = sb3.train(task, algorithm, folder, budget, **settings, **options)
        else:
            from . import skrl

            result = skrl.train(task, folder, budget, **settings, **options)
    result = {
        **run._asdict(),
        "cpu_minutes_all": (time.process_time() - start) / 60,
        "budget": vars(budget),
        **result,
        "settings": settings,
        "environment": run.environment,
        "measured": measured_on(dtype=None, threads=1),
        "commit": commit(),
    }
    write(folder / f"{run.name}.json", json.dumps(result, indent=2) + "\n")
    (folder / f"{run.name}{FAILED}").unlink(missing_ok=True)
    return result


@cache
def commit() -> str | None:
    """Of the tree that this file stands in, with a "+" where its code has been changed since, when
    this process began with its runs; None where there is none.
    """
    tree = Path(__file__).parents[1]

    def git(*words: str) -> str:
        call = ("git", "-C", str(tree), *words)
        return subprocess.run(call, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", "training", "envs", "torchbeam")
        return git("rev-parse", "HEAD") + "+" * bool(changed)
    except (OSError, subprocess.CalledProcessError):
        return None


@cache
def code() -> str:
    """Digest of the code that runs: library, environments and this folder, when it is first asked
    for.
    """
    digest = hashlib.sha256()
    for file in (torchbeam.__file__, torchbeam_envs.__file__, __file__):
        folder = Path(file).parent
        for path in sorted(folder.rglob("*.py")):
            digest.update(f"{folder.name}/{path.relative_to(folder)}".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def attempt(make: Callable[..., Any], run: Any, folder: Path, *arguments: Any) -> str:
    """make(run, folder, ...) in a process of its own: "" or, where it failed, the last line of
    why; the rest is in NAME.failed.
    """
    try:
        make(run, folder, *arguments)
    except Exception:
        text = traceback.format_exc()
        write(folder / f"{run.name}{FAILED}", text)
        return text.strip().splitlines()[-1]
    return ""


def plan(options: argparse.Namespace) -> list[Run]:
    """The runs that are wanted, in the order in which they are made."""
    parts: Sequence[tuple[Sequence[str], Sequence[str], int]] = PLAN
    if options.tasks or options.algorithms:
        own = [name for name in ALGORITHMS if name not in LIBRARIES]
        parts = [(options.algorithms or own, options.tasks or tuned.DEFAULT, options.seeds)]
    named = options.algorithms or ()
    return [
        Run(task, algorithm, None if algorithm in BASELINES else seed)
        for seed in range(options.seeds)
        for algorithms, tasks, seeds in parts
        for algorithm in algorithms
        for task in tasks
        if seed < (1 if algorithm in BASELINES else seeds)
        and (algorithm in named or applies(algorithm, task))
    ]


def budget(options: argparse.Namespace, run: Run) -> Budget:
    """Of a run: environment steps, unless CPU time is asked for."""
    if run.algorithm in BASELINES:
        return Budget(None, None)
    steps = options.budget
    if steps is None and options.minutes is None:
        steps = round(options.share * tuned.budget(run.algorithm, run.task))
    return Budget(steps, options.minutes)


def held_out(run: Run, options: argparse.Namespace) -> int:
    """Episodes of its final scores: no more than differ."""
    few = MOST_EPISODES.get(run.algorithm), tuned.FEW.get(run.task)
    return min([options.episodes, *filter(None, few)])


def is_made(run: Run, folder: Path, budget: Budget, episodes: int) -> bool:
    """Whether its file is there, whole, and of the same environment, budget, settings and
    episodes.
    """
    path = folder / f"{run.name}.json"
    if not path.exists():
        return False
    there, wanted = as_now(json.loads(path.read_text())), {"episodes": episodes}
    wanted |= {"environment": run.environment, "budget": vars(budget)}
    if run.algorithm not in BASELINES:  # which find their settings themselves
        wanted["settings"] = run.settings
    return holds(there, wanted)


def holds(there: dict[str, Any], wanted: dict[str, Any]) -> bool:
    """Whether it says the same, as JSON does."""
    return all(there.get(key) == value for key, value in json.loads(json.dumps(wanted)).items())


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m training.results",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--tasks",
        nargs="+",
        choices=tuned.TASKS,
        help="each of them by each algorithm, in place of the study's plan (default, where "
        f"algorithms are named: {' '.join(tuned.DEFAULT)})",
    )
    parser.add_argument(
        "--algorithms",
        nargs="+",
        choices=ALGORITHMS,
        help="likewise (default, where tasks are named: all but those of libraries, and but "
        "baselines that are not for the task)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"about three minutes: {' and '.join(QUICK['tasks'])} by "
        f"{', '.join(QUICK['algorithms'])}, {QUICK['seeds']} seeds, {100 * QUICK['share']:g} %% of "
        f"each budget and {QUICK['episodes']} episodes, where these are not given",
    )
    parser.add_argument(
        "--seeds",
        type=above_zero(int),
        default=SEEDS,
        help="runs of each learner, of the plan at most (default: %(default)s)",
    )
    parser.add_argument(
        "--budget",
        type=above_zero(int),
        help="environment steps of a run (default: those of training/tuned.py, or without bound "
        "where --minutes is given)",
    )
    parser.add_argument(
        "--share",
        type=above_zero(float),
        default=1.0,
        help="of each default budget (default: %(default)s)",
    )
    parser.add_argument(
        "--minutes",
        type=above_zero(float),
        help="of training in a run, at most, CPU time; results then depend on the machine",
    )
    parser.add_argument(
        "--episodes",
        type=above_zero(int),
        default=EPISODES,
        help="held-out, final scores (default: %(default)s)",
    )
    parser.add_argument(
        "--jobs",
        type=above_zero(int),
        default=os.cpu_count(),
        help="processes of one torch thread (default: %(default)s)",
    )
    parser.add_argument("--out", default="out/results", help="default: %(default)s")
    if parser.parse_known_args(argv)[0].quick:
        parser.set_defaults(**QUICK)
    options = parser.parse_args(argv)
    options.out = results_folder(parser, options.out)
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Train and score whatever is missing, then write the tables and the picture."""
    options = parse(argv)
    wanted = {run: (budget(options, run), held_out(run, options)) for run in plan(options)}
    code = complete(wanted, options.out / "runs", options.jobs)
    print(report(options.out))
    return code


def complete(wanted: dict[Run, tuple[Budget, int]], folder: Path, jobs: int) -> int:
    """Make the runs, by budget and held-out episodes, that are missing; 1 where any failed."""
    folder.mkdir(exist_ok=True)
    missing = {run: own for run, own in wanted.items() if not is_made(run, folder, *own)}
    print(
        f"{len(wanted)} runs, {len(wanted) - len(missing)} of them done; {jobs} processes",
        flush=True,
    )
    return made(make, [(run, folder, *own) for run, own in missing.items()], jobs)


def made(make: Callable[..., Any], each: list[tuple], jobs: int) -> int:
    """make(run, folder, ...) of each of these, in so many processes; 1 where any failed."""
    failures = {}
    with Bar("runs", bool(each)) as bar:
        for count, (run, why) in enumerate(outcomes(make, each, jobs), 1):
            failures.update({run.name: why} if why else {})
            bar.say(run.name)
            bar.to(count / len(each))
    for name, why in failures.items():
        print(f"{name} failed: {why}")
    return 1 if failures else 0


def outcomes(make: Callable[..., Any], jobs: list[tuple], count: int) -> Iterator[tuple[Any, str]]:
    """Each run with what `attempt` said of it, as they end; in this process where there is to be
    one.
    """
    if count == 1:
        yield from ((job[0], attempt(make, *job)) for job in jobs)
        return
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # for the processes that are started below
    with process_pool(count) as pool:
        started = {pool.submit(attempt, make, *job): job[0] for job in jobs}
        for one in as_completed(started):
            try:
                yield started[one], one.result()
            except Exception as error:  # the process died: a later call makes the run again
                yield started[one], repr(error)


if __name__ == "__main__":
    raise SystemExit(main())
