"""How far `converge` can be trusted: its errors against those of much finer runs, and its costs
against an exhaustive search, over random scenes.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ..analysis.convergence.converge import converge
from ..analysis.convergence.convergence import Convergence
from ..analysis.convergence.law import Law
from ..analysis.convergence.reading import Reader
from ..analysis.convergence.remesh import least_elements, remesh
from ..analysis.convergence.search import Search
from ..analysis.convergence.setting import ELEMENTS, METHODS, Setting
from ..analysis.convergence.trials import Trials
from ..analysis.trials import seconds
from ..cli import study
from ..core.results import measured_on, sentence, table, write
from ..linear.modes import modes
from ..scene.scene import Scene
from ..sensors.node import NodePosition, TipPosition
from ..statics.equilibrium import equilibrium
from .bench.measurement import progress
from .random_scenes import Draw, families

SCENES, TOLERANCES = 100, (1e-2, 1e-3)
SEED = 30_000  # of the first scene; none of these was looked at while `converge` was written
ELEMENTS_GIVEN, DURATION, INSTANTS = 8, 1.0, 41
# beside the families of random scenes that move: equilibria and frequencies
STATIC, MODAL = ("sudden", "weight", "follower"), ("sudden", "pendulum", "free")
FINER, SHORTER = 4, 6  # of a reference: times the nodes, and parts of a step
ABOUT = (
    "Random scenes of {families} (soft rods of random stiffness, mass, load and damping; seeds "
    "from {seed} on), one after the other; {duration:g} s of motion at {instants} instants, or "
    "an equilibrium, or three frequencies. Read are the tip's path, that of a node at half length, "
    "or the root's moment where damped. True error: against elements of order 2 with {finer} times "
    "the nodes, by midpoint4 with a step of 1/{shorter} of the chosen. Best: the cheapest of all "
    "elements, meshes, methods and steps of the same grid whose errors of mesh and of step, "
    "measured one by one, add up to no more; timed in turns with the chosen. Search: CPU time of "
    "all runs over that of the chosen one, compiling not counted."
)


@dataclass(frozen=True)
class Row:
    """One scene and tolerance. error and estimated are relative; ratio: the chosen setting's CPU
    time over the best's (nan = not looked for); search: that of all runs over the chosen's.
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
    best: str
    ratio: float
    search: float
    converged: bool


@dataclass(frozen=True)
class Question:
    """A random scene, and what is asked about it. t None: `solve`."""

    family: str
    kind: str
    name: str
    scene: Scene
    read: Any
    t: Tensor | None
    solve: Callable[[Scene], Any] | None


def question(number: int, seed: int = SEED) -> Question:
    """The one of a number; each is drawn by a seed of its own, which begin at `seed`."""
    made = families(ELEMENTS_GIVEN)
    names = [
        *((family, "motion") for family in made),
        *((family, "equilibrium") for family in STATIC),
        *((family, "modes") for family in MODAL),
    ]
    family, kind = names[number % len(names)]
    scene = made[family](Draw(seed + number, 1))
    if kind == "modes":
        return Question(
            family, kind, "frequencies", scene, _frequencies, None, lambda s: modes(s, count=9)
        )
    reads = [("tip", TipPosition()), ("half way", NodePosition(ELEMENTS_GIVEN // 2))]
    if scene.damping is not None or kind == "equilibrium":
        reads.append(("root moment", lambda result: result.root.moment))
    name, read = reads[number // len(names) % len(reads)]
    if kind == "equilibrium":
        return Question(family, kind, name, scene, read, None, equilibrium)
    t = torch.linspace(0, DURATION, INSTANTS, dtype=torch.float64)
    return Question(family, kind, name, scene, read, t, None)


def _frequencies(found: Any) -> Tensor:
    """The three lowest that are not of a rigid motion."""
    frequency = found.frequency
    return frequency[..., frequency[0] > 1e-3 * frequency.max()][..., :3]


def measure(number: int, rtol: float, exhaustive: bool, seed: int = SEED) -> Row:
    """`converge` of a scene, its true error, and the best there is."""
    asked = question(number, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        best = converge(asked.scene, asked.t, asked.read, rtol, solve=asked.solve)
        trials = Trials(
            lambda setting: remesh(asked.scene, **setting.mesh),
            Reader(asked.read, asked.scene),
            asked.t,
            asked.solve,
            1.0,
            {},
        )
        error = trials.difference(best.settings, _reference(best.settings))
        cheapest, ratio = _cheapest(trials, best, rtol) if exhaustive else (None, math.nan)
    chosen = next(tried for tried in best.table if tried.chosen)
    return Row(
        number,
        asked.family,
        asked.kind,
        asked.name,
        rtol,
        str(best.settings),
        best.error,
        error,
        chosen.seconds,
        "" if cheapest is None else str(cheapest),
        ratio,
        sum(tried.seconds for tried in best.table) / chosen.seconds,
        best.converged,
    )


def _reference(setting: Setting) -> Setting:
    """Much finer."""
    elements = math.ceil(FINER * setting.intervals / ELEMENTS["order 2"].order)
    if setting.method is None:
        return Setting("order 2", elements)
    return Setting("order 2", elements, "midpoint4", setting.step / SHORTER)


def _cheapest(trials: Trials, best: Convergence, rtol: float) -> tuple[Setting | None, float]:
    """Of all settings of the grid, by errors of each mesh at equal steps and of each step on one
    mesh; and the chosen one's time over its, measured in turns.
    """
    chosen, fine = best.settings, _reference(best.settings)
    steps = {} if chosen.method is None else dict(method=chosen.method, step=chosen.step)
    search = Search(
        trials,
        rtol,
        least_elements(trials.reader.scene),
        None if trials.t is None else trials.t.diff().min().item(),
        list(ELEMENTS),
        [] if trials.t is None else ["midpoint", "midpoint4"],
        (4 * chosen.intervals, 8 * trials.step_count(chosen.step)),
    )
    for element in search.elements:
        law = search.space[element] = Law(ELEMENTS[element].rate)
        limit = Setting("order 2", fine.elements, **steps)
        for count in search.element_counts():
            if count * ELEMENTS[element].order < 2:
                continue
            law.errors[count] = trials.difference(Setting(element, count, **steps), limit)
            if law.errors[count] <= rtol / 4:
                break
    for method in search.methods:
        law = search.time[method] = Law(METHODS[method])
        limit = replace(chosen, method="midpoint4", step=fine.step)
        for step in search.step_lengths():
            error = trials.difference(replace(chosen, method=method, step=step), limit)
            law.errors[trials.step_count(step)] = error
            if error <= rtol / 4:
                break
    enough = [s for s in search.settings() if search.error(s) <= rtol]
    if not enough:
        return None, math.nan
    cheapest = sorted(enough, key=trials.cost)[:3]
    ours, *theirs = seconds(
        [lambda s=s: trials._solve(trials.mesh(s), s) for s in (chosen, *cheapest)], 4
    )
    times = dict(zip(cheapest, theirs, strict=True))
    found = min(times, key=times.get)
    return found, ours / times[found]


def report(rows: Sequence[Row]) -> str:
    """Tables: a summary by tolerance and kind, and each scene."""
    head = ("rtol", "kind", "scenes", "accepted", "true error within it", "of those accepted")
    more = ("largest error/rtol", "cost within 2 of the best", "search/chosen", "at most 10")
    lines = []
    for rtol in dict.fromkeys(row.rtol for row in rows):
        for kind in ("all", *dict.fromkeys(row.kind for row in rows)):
            few = [row for row in rows if row.rtol == rtol and kind in ("all", row.kind)]
            accepted = [row for row in few if row.converged]
            looked = [row for row in accepted if not math.isnan(row.ratio)]
            search = sorted(row.search for row in few)
            lines.append(
                (
                    f"{rtol:g}",
                    kind,
                    str(len(few)),
                    str(len(accepted)),
                    _share(few, lambda row: row.error <= row.rtol),
                    _share(accepted, lambda row: row.error <= row.rtol),
                    f"{max((row.error / rtol for row in accepted), default=math.nan):.2f}",
                    _share(looked, lambda row: row.ratio <= 2),
                    f"{search[len(search) // 2]:.1f}",
                    _share(few, lambda row: row.search <= 10),
                )
            )
    each = table(
        ("scene", "what", "read", "rtol", "chosen", "estimated", "true", "ms", "best", "cost/best"),
        [
            (
                str(row.scene),
                f"{row.family}, {row.kind}",
                row.read,
                f"{row.rtol:g}",
                row.setting,
                f"{row.estimated:.1e}",
                f"{row.error:.1e}",
                f"{1e3 * row.seconds:.3g}",
                row.best,
                "" if math.isnan(row.ratio) else f"{row.ratio:.2f}",
            )
            for row in rows
        ],
        3,
    )
    return f"{table((*head, *more), lines, 2)}\n\n{each}"


def _share(rows: Sequence[Row], holds: Callable[[Row], bool]) -> str:
    return f"{sum(map(holds, rows))} of {len(rows)}" if rows else ""


def main(argv: Sequence[str] | None = None) -> None:
    """Errors and costs of `converge` over random scenes, against finer runs and all settings."""

    def more(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--scenes", type=int, default=SCENES, help="how many (%(default)s)")
        parser.add_argument("--seed", type=int, default=SEED, help="of the first (%(default)s)")
        parser.add_argument(
            "--seconds", type=float, default=math.inf, help="begin no scene after these"
        )

    quick = "three scenes, no exhaustive search"
    given, out = study(argv, "convergence", main.__doc__, quick, more)
    about = ABOUT.format(
        families=f"{len(families(1))} families",
        seed=given.seed,
        duration=DURATION,
        instants=INSTANTS,
        finer=FINER,
        shorter=SHORTER,
    )
    rows: list[Row] = []
    begun, heading = time.monotonic(), measured_on()
    for number in range(3 if given.quick else given.scenes):
        if time.monotonic() - begun > given.seconds:
            break
        for rtol in TOLERANCES:
            rows.append(measure(number, rtol, not given.quick, given.seed))
            progress(f"{rows[-1]}")
        text = f"{about}\n\n{report(rows)}\n\n{sentence(heading)}"
        data = {**heading, "rows": [asdict(row) for row in rows]}
        head = [f.name for f in fields(Row)]
        write(out, "convergence", text, data, head, [astuple(row) for row in rows])
