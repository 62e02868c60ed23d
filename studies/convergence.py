"""How far `converge` can be trusted: its errors against those of much finer runs, and its costs
against an exhaustive search, over random scenes.
"""

from __future__ import annotations

import math
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.analysis.advise import seconds
from torchbeam.analysis.convergence.reading import Reader
from torchbeam.analysis.convergence.remesh import least_elements
from torchbeam.analysis.convergence.search import Search
from torchbeam.analysis.convergence.setting import ELEMENTS, Setting
from torchbeam.analysis.convergence.trials import TrialRuns
from torchbeam.core.measurement import progress
from torchbeam.engine.compiler.library import Library
from torchbeam.extend.commands import table
from torchbeam.sensors import NodePosition, TipPosition

from .harness import Report, Study
from .random_scenes import Draw, families

SCENES, TOLERANCES = 100, (1e-2, 1e-3)
SEED = 70_000  # of the first scene; none of these was looked at while `converge` was written
ELEMENTS_GIVEN, DURATION, INSTANTS = 8, 1.0, 41
# beside the families of random scenes that move: equilibria and frequencies
STATIC, MODAL = ("sudden", "weight", "follower"), ("sudden", "pendulum", "free")
# of a reference: times the nodes, and parts of a step, by the method whose step it is
FINER, SHORTER = 4, {"midpoint": 2, "midpoint4": 6}
REPEATS = 3  # of a time, in turns with others
SEARCHES = 4  # of a scene, at most, until one finds all its code made
EXHAUSTIVE, LONG = 3, 0.2  # of so many scenes one is searched exhaustively; CPU s beyond which none
ABOUT = (
    "Random scenes of {families} (soft rods of random stiffness, mass, load and damping; seeds "
    "from {seed} on), one after the other; {duration:g} s of motion at {instants} instants, or "
    "an equilibrium, or three frequencies. Read are the tip's path, that of a node at half length, "
    "or the root's moment where damped. True error: against elements of order 2 with {finer} times "
    "the nodes, by midpoint4 with a step of 1/{shorter} of the chosen, 1/{half} of midpoint's. "
    "Best, of one scene in {every} whose run takes less than {long:g} s: the cheapest of all "
    "elements, meshes, methods and steps of the same grid whose true errors of mesh and of step, "
    "measured one by one, add up to no more; timed in turns with the chosen. Search: CPU time of a "
    "whole call of `converge` over that of the chosen run on a mesh of its own, compiling not "
    "counted; runs: how many. Setting up: share of the chosen run's time "
    "that one of a single step takes."
)


@dataclass(frozen=True)
class ConvergedScene:
    """One scene and tolerance. error and estimated are relative; seconds: CPU time of the chosen
    run; ratio: that over the best's (nan = not looked for); setup: share that a run of one step
    takes (nan = no motion); search: time of the call of `converge` over that of the chosen run;
    runs: their number.
    """

    scene: int
    family: str
    kind: str
    read: str
    rtol: float
    setting: str
    estimated: float
    error: float
    seconds: float
    setup: float
    best: str
    ratio: float
    runs: int
    search: float
    converged: bool


@dataclass(frozen=True)
class Question:
    """A random scene, and what is asked about it. t None: `solve`."""

    family: str
    kind: str
    name: str
    scene: tb.Scene
    read: Any
    t: Tensor | None
    solve: Callable[[tb.Scene], Any] | None


def kinds() -> list[tuple[str, str]]:
    """Families, and what is computed: motions, with the others evenly among them."""
    motions = [(family, "motion") for family in families(ELEMENTS_GIVEN)]
    others = [
        pair
        for static, modal in zip(STATIC, MODAL, strict=True)
        for pair in ((static, "equilibrium"), (modal, "modes"))
    ]
    apart = len(motions) // len(others)
    for k, other in enumerate(others):
        motions.insert(apart + k * (apart + 1), other)
    return motions


def question(number: int, seed: int = SEED) -> Question:
    """The one of a number; each is drawn by a seed of its own, which begin at `seed`."""
    pairs = kinds()
    family, kind = pairs[number % len(pairs)]
    scene = families(ELEMENTS_GIVEN)[family](Draw(seed + number, 1))
    if kind == "modes":
        if family == "free":  # by itself: nothing holds it against its load, nor do its modes ring
            scene = replace(scene, effects=())
        return Question(family, kind, "frequencies", scene, _frequencies, None, _modes)
    reads = [("tip", TipPosition()), ("half way", NodePosition(ELEMENTS_GIVEN // 2))]
    if scene.damping is not None or kind == "equilibrium":
        reads.append(("root moment", lambda result: result.root.moment))
    name, read = reads[number // len(pairs) % len(reads)]
    if kind == "equilibrium":
        return Question(family, kind, name, scene, read, None, tb.equilibrium)
    t = torch.linspace(0, DURATION, INSTANTS, dtype=torch.float64)
    return Question(family, kind, name, scene, read, t, None)


def _modes(scene: tb.Scene) -> Any:
    """About an equilibrium, to which what is hinged swings."""
    return tb.modes(scene, tb.equilibrium(scene, relax=True), count=9)


def _frequencies(found: Any) -> Tensor:
    """The three lowest that are not of a rigid motion."""
    frequency = found.frequency
    return frequency[..., frequency[0] > 1e-3 * frequency.max()][..., :3]


def measure(number: int, rtol: float, exhaustive: bool, seed: int = SEED) -> ConvergedScene:
    """`converge` of a scene, its true error, and the best there is."""
    asked = question(number, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for _ in range(SEARCHES):  # one that compiles nothing: equal choices may take turns
            known = Library.count
            best = tb.converge(asked.scene, asked.t, asked.read, rtol, solve=asked.solve)
            if Library.count == known:
                break
        trials = TrialRuns(
            lambda setting: tb.remesh(asked.scene, **setting.mesh), Reader(asked.read, asked.scene),
            asked.t, asked.solve, 1.0, {},
        )  # fmt: skip
        error = trials.difference(best.settings, _reference(best.settings))
        chosen = next(tried for tried in best.table if tried.chosen)
        if exhaustive and chosen.seconds < LONG:
            cheapest = _cheapest(trials, best.settings, rtol)
        else:
            cheapest = []
        ours, *others = seconds(
            [
                _run(trials, best.settings, asked.t),
                *(_run(trials, setting, asked.t) for setting in cheapest),
                *([] if asked.t is None else [_run(trials, best.settings, asked.t[:2])]),
            ],
            REPEATS,
        )
    theirs = others[: len(cheapest)]
    times = dict(zip(theirs, cheapest, strict=True))
    best_of = str(times[min(times)]) if times else "", ours / min(times) if times else math.nan
    setup = math.nan if asked.t is None else others[-1] / ours
    what = number, asked.family, asked.kind, asked.name, rtol, str(best.settings)
    search = len(best.table), best.seconds / ours, best.converged
    return ConvergedScene(*what, best.error, error, ours, setup, *best_of, *search)


def _run(trials: TrialRuns, setting: Setting, t: Tensor | None) -> Callable[[], Any]:
    """A setting's run on a mesh of its own, by these instants; one step's where they are two."""
    if t is not None and len(t) == 2:
        t = torch.stack((t[0], t[0] + setting.step))
    own = replace(trials, t=t)
    return lambda: own._solve(own.mesh(setting), setting)


def _reference(setting: Setting) -> Setting:
    """Much finer."""
    elements = math.ceil(FINER * setting.intervals / ELEMENTS["order 2"].order)
    if setting.method is None:
        return Setting("order 2", elements)
    return Setting("order 2", elements, "midpoint4", setting.step / SHORTER[setting.method])


def _cheapest(trials: TrialRuns, chosen: Setting, rtol: float) -> list[Setting]:
    """The cheapest few of all settings of the grid, by errors of each mesh at equal steps and of
    each step on one mesh.
    """
    fine = _reference(chosen)
    search = Search(
        trials, rtol, least_elements(trials.reader.scene, trials.reader.nodes()),
        None if trials.t is None else trials.t.diff().min().item(), list(ELEMENTS),
        [] if trials.t is None else ["midpoint", "midpoint4"],
        (4 * chosen.intervals, 8 * trials.step_count(chosen.step)),
    )  # fmt: skip
    limit = replace(fine, method=chosen.method, step=chosen.step)
    meshes: dict[Setting, float] = {}
    for element in search.elements:
        for count in search.element_counts():
            if count * ELEMENTS[element].order < 2:
                continue
            setting = replace(chosen, element=element, elements=count)
            meshes[setting] = trials.difference(setting, limit)
            if meshes[setting] <= rtol / 4:
                break
    steps: dict[Setting, float] = {} if search.methods else {chosen: 0.0}
    limit = replace(chosen, method=fine.method, step=fine.step)
    for method in search.methods:
        for step in search.step_lengths():
            setting = replace(chosen, method=method, step=step)
            steps[setting] = trials.difference(setting, limit)
            if steps[setting] <= rtol / 4:
                break
    enough = [
        replace(mesh, method=by.method, step=by.step)
        for mesh, of_mesh in meshes.items()
        for by, of_step in steps.items()
        if of_mesh + of_step <= rtol
    ]
    return sorted(enough, key=trials.cost)[:3]


def report(rows: Sequence[ConvergedScene]) -> str:
    """Tables: a summary by tolerance and kind, and what is not as it should be."""
    head = (
        "rtol | kind | scenes | accepted | true error within it | of those accepted | "
        "largest error/rtol | cost/best | at most 2 | runs | search/chosen | at most 10 | "
        "setting up"
    )
    lines = []
    for rtol in dict.fromkeys(row.rtol for row in rows):
        for kind in ("all", *dict.fromkeys(row.kind for row in rows)):
            few = [row for row in rows if row.rtol == rtol and kind in ("all", row.kind)]
            accepted = [row for row in few if row.converged]
            looked = [row for row in accepted if not math.isnan(row.ratio)]
            if few:
                worst = max((row.error / rtol for row in accepted), default=math.nan)
                lines.append(
                    f"{rtol:g} | {kind} | {len(few)} | {len(accepted)} | {_share(few, _true)} | "
                    f"{_share(accepted, _true)} | {worst:.2f} | "
                    f"{_median(row.ratio for row in looked)} | "
                    f"{_share(looked, lambda row: row.ratio <= 2)} | "
                    f"{_median(float(row.runs) for row in few)} | "
                    f"{_median(row.search for row in few)} | "
                    f"{_share(few, lambda row: row.search <= 10)} | "
                    f"{_median(row.setup for row in few)}"
                )
    summary = table(head, lines, 2)
    missed = [
        row
        for row in rows
        if not (_true(row) and row.converged) or row.ratio > 2 or row.search > 10
    ]
    if not missed:
        return summary
    head = (
        "scene | what | read | rtol | chosen | estimated | true | ms | best | cost/best | runs | "
        "search/chosen"
    )
    each = table(
        head,
        (
            f"{r.scene} | {r.family}, {r.kind} | {r.read} | {r.rtol:g} | {r.setting} | "
            f"{r.estimated:.1e} | {r.error:.1e} | {1e3 * r.seconds:.3g} | {r.best} | "
            f"{'' if math.isnan(r.ratio) else f'{r.ratio:.2f}'} | {r.runs} | {r.search:.1f}"
            for r in missed
        ),
        3,
    )
    return (
        f"{summary}\n\nMedians, and counts. Each choice that was not accepted, whose true error is "
        "more than what was wanted, that costs more than twice the best, or whose search more than "
        f"ten runs; all are in the CSV.\n\n{each}"
    )


def _true(row: ConvergedScene) -> bool:
    return row.error <= row.rtol


def _median(values: Iterable[float]) -> str:
    known = [x for x in values if not math.isnan(x)]
    return f"{median(known):.2g}" if known else ""


def _share(rows: Sequence[ConvergedScene], holds: Callable[[ConvergedScene], bool]) -> str:
    return f"{sum(map(holds, rows))} of {len(rows)}" if rows else ""


def study(options: Namespace) -> Iterator[Report]:
    about = ABOUT.format(
        families=f"{len(families(1))} families", seed=options.seed, duration=DURATION,
        instants=INSTANTS, finer=FINER, shorter=SHORTER["midpoint4"], half=SHORTER["midpoint"],
        long=LONG, every=EXHAUSTIVE,
    )  # fmt: skip
    same = options.stored.get("seed") == options.seed
    rows = [ConvergedScene(**row) for row in options.stored["rows"]] if same else []
    known, begun = {(row.scene, row.rtol) for row in rows}, time.monotonic()
    for number in range(options.first, 3 if options.quick else options.scenes):
        asked = [rtol for rtol in TOLERANCES if (number, rtol) not in known]
        if asked and time.monotonic() - begun > options.seconds:
            break
        for rtol in asked:
            whole = number % EXHAUSTIVE == 0 and not options.quick
            rows.append(measure(number, rtol, whole, options.seed))
            progress(f"{rows[-1]}")
        if asked:
            rows.sort(key=lambda row: (row.scene, -row.rtol))
            yield Report([about, report(rows)], rows, {"seed": options.seed})


TITLE = "Errors and costs of `converge` over random scenes, against finer runs and all settings."
main = Study(
    "convergence",
    TITLE,
    TITLE,
    study,
    quick="three scenes, no exhaustive search",
    resume="keep what is in the folder, and go on behind it",
    options={
        "--scenes": dict(type=int, default=SCENES, help="how many (%(default)s)"),
        "--first": dict(type=int, default=0, help="begin with it (%(default)s)"),
        "--seed": dict(type=int, default=SEED, help="of the first (%(default)s)"),
        "--seconds": dict(type=float, default=math.inf, help="begin no scene after these"),
    },
    threads=None,
)
