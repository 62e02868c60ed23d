"""Error control: the true error of adaptive steps beside the tolerance, over random scenes, and
what they cost.
"""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.dynamics.dense_output import extrapolated
from torchbeam.dynamics.tolerance import Tolerance
from torchbeam.extend import quaternions as quat
from torchbeam.extend.commands import table

from .accuracy.measurement import timed
from .accuracy.motions import SILICONE
from .harness import Report, Study
from .random_scenes import Draw, families

SAMPLES = 9  # of a family
OUTPUTS = 25  # instants
SEED = 2  # the constants of the control were chosen on the scenes of 1
QUICK = "sudden, damped", "weight"
SPAN = 0.02  # s, of explicit methods
RK4_STEP = 4e-4  # s: with 8e-4 it grows without bound here
NEAR = 0.03  # of the tolerance: two references that differ by less are one
# whose references are dear
UNDAMPED = "sudden", "weight, plane", "follower moment"
FINEST = 2**17  # steps of a reference, at most
ABOUT = (
    "{scenes} random soft rods (seed {seed}) in {families} families ({elements} elements, length "
    "0.3 to 0.8 m, 0.5 to 3 s of motion, {outputs} instants), rtol from 1e-2 to 1e-5 (undamped: "
    "1e-4) at random, each sample its own. Error: largest distance of a node over all instants "
    "from a reference (equal midpoint steps, halved until what they extrapolate to stands still "
    "to 3 % of the tolerance), over the tolerance; of rotations, largest angle between sections. "
    "Work: implicit steps made, all trials and runs "
    "included, over how many equal steps have the tolerance for their error (8 at least), which "
    "nobody knows beforehand."
)
EXPLICIT_ABOUT = (
    "Explicit methods with the same rtol (atol = rtol times the length), in the three forms, each "
    "against itself at 1e-9; rk4, of fixed steps, with one that is stable; beside them adaptive "
    "midpoint steps. A rod of 0.5 m, EI = 0.02 N m^2, three elements, under a sudden force, "
    "{span:g} s."
)


@dataclass(frozen=True)
class ControlledRun:
    """One sample: error of positions, that of rotations, and estimate in tolerances; work: steps
    made in all; equal: equal steps whose error of positions is the tolerance (nan: not measured).
    """

    family: str
    sample: int
    rtol: float
    error: float
    rotation: float
    estimate: float
    steps: int
    level: int
    rejected: int
    work: int
    equal: float
    status: int


def reference(
    scene: tb.Scene, t: Tensor, tolerance: Tolerance, steps: int = 512
) -> tuple[tb.State, list[tuple[int, Tensor]]]:
    """States (time, samples) to NEAR of the tolerance, and positions of the nodes
    (time, samples, nodes, 3) of the runs by so many equal steps that led there.
    """
    runs: list[tuple[int, Tensor]] = []
    coarse = before = None
    while steps <= FINEST:
        sol = tb.simulate(scene, t, step=(t[-1] - t[0]).item() / steps)
        runs.append((steps, sol.nodes))
        if sol.status.any():  # what has stopped stands still whatever the step
            coarse = before = None
        else:
            best = None if coarse is None else extrapolated(coarse, sol.state, order=2)
            if before is not None and (tolerance.distance(best, before) < NEAR).all():
                return best, runs
            coarse, before = sol.state, best
        steps *= 2
    raise RuntimeError(f"no reference to {NEAR:g} of the tolerance by {FINEST} equal steps")


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Largest distance of nodes (samples,) over all instants."""
    return torch.linalg.vector_norm(a - b, dim=-1).amax(-1).amax(0)


def angle(a: tb.State, b: tb.State) -> Tensor:
    """Largest angle rad (samples,) between sections over all instants."""
    turn = quat.logarithm(quat.multiply(quat.conjugate(a.rotation), b.rotation))
    return torch.linalg.vector_norm(turn, dim=-1).amax(-1).amax(0)


def work(sol: tb.Solution) -> Tensor:
    """Implicit steps that each sample made: three a trial of the control, and all runs."""
    counts = (sol.stats.lengths > 0).sum(0)
    return 3 * (counts + sol.stats.rejected) + counts * (2 ** (sol.stats.level + 1) - 1)


def equal_steps(
    runs: list[tuple[int, Tensor]],
    best: Tensor,
    tolerance: Tensor,
    simulated: Callable[[int], Tensor],
) -> Tensor:
    """Number of equal steps (samples,) whose error is the tolerance: between two measured ones by
    the second order.
    """
    least_steps = torch.full_like(tolerance, torch.nan)
    runs = sorted(
        [*((k, simulated(k)) for k in (8, 16, 32, 64, 128, 256)), *runs], key=lambda run: run[0]
    )
    for steps, nodes in reversed(runs):
        error = distance(nodes, best)
        within = error <= tolerance
        least_steps = torch.where(
            within & ((least_steps == 2 * steps) | least_steps.isnan()), steps, least_steps
        )
        last = (~within) & (least_steps == 2 * steps)
        least_steps = torch.where(
            last, steps * (error / tolerance).sqrt().clamp(max=2.0), least_steps
        )
    return least_steps


def measure(
    seed: int, samples: int, elements: int, names: Sequence[str] | None = None
) -> list[ControlledRun]:
    """Rows of all samples."""
    rows = []
    for k, (name, make) in enumerate(families(elements).items()):
        if names is not None and name not in names:
            continue
        draw = Draw(100 * seed + k, samples)
        scene = make(draw)
        undamped = name in UNDAMPED
        t = torch.linspace(
            0, float(draw(0.5, 1.0 if undamped else 3.0)[0]), OUTPUTS, dtype=torch.float64
        )
        rtol = draw.log(1e-4 if undamped else 1e-5, 1e-2)
        rows += _family(name, scene, t, rtol)
    return rows


def _family(name: str, scene: tb.Scene, t: Tensor, rtol: Tensor) -> list[ControlledRun]:
    allowed = Tolerance.of(scene, rtol, None)
    best, runs = reference(scene, t, allowed)
    sol, tolerance = tb.simulate(scene, t, rtol=rtol), allowed.position
    error, done = distance(sol.nodes, best.position) / tolerance, work(sol)
    equal = equal_steps(
        runs,
        best.position,
        tolerance,
        lambda k: tb.simulate(scene, t, step=(t[-1] - t[0]).item() / k).nodes,
    )
    stats, counts = sol.stats, (sol.stats.lengths > 0).sum(0)
    turned, estimate = angle(sol.state, best) / allowed.rotation, stats.error / tolerance
    measured = rtol, error, turned, estimate, counts, stats.level, stats.rejected, done, equal
    columns = (*measured, sol.status)
    return [
        ControlledRun(name, i, *values)
        for i, values in enumerate(zip(*(x.tolist() for x in columns), strict=True))
    ]


@dataclass(frozen=True)
class Explicit:
    """An explicit method, or adaptive midpoint steps: error over the tolerance, evaluations of
    rates or implicit steps, seconds of one thread.
    """

    method: str
    form: str
    rtol: float
    error: float
    evaluations: int
    seconds: float


def explicit_methods(elements: int, span: float, tolerances: Sequence[float]) -> list[Explicit]:
    """A rod under a sudden force by the explicit methods of every form, each against itself at
    1e-9.
    """
    number = torch.tensor(1.0, dtype=torch.float64)
    scene = tb.Scene(
        tb.Beam.straight(0.5 * number, elements, SILICONE(number, number)),
        [tb.TipLoad(force=(0.0, 0.05, 0.08))],
    )
    t, length = torch.linspace(0, span, 5, dtype=torch.float64), 0.5
    runs = [("midpoint", "nodal")] + [
        (method, form)
        for form in ("nodal", "minimal", "block_rate")
        for method in ("dopri5", "dopri8", "bosh3", "rk4")
    ]
    best = {"midpoint": tb.simulate(scene, t, rtol=1e-7).nodes}
    rows = []
    for method, form in runs:
        if method == "midpoint":
            tb.simulate(scene, t, rtol=1e-2)  # which compiles
        elif form not in best:
            best[form] = tb.simulate(
                scene, t, method="dopri8", form=form, rtol=1e-9, atol=1e-11
            ).nodes
        for rtol in tolerances:
            own: dict[str, Any] = dict(rtol=rtol)
            if method == "rk4":
                own = dict(options={"step_size": span / math.ceil(span / RK4_STEP)})
            elif method != "midpoint":
                own = dict(rtol=rtol, atol=rtol * length)
            progress(f"{method} {form} {rtol}")
            spent, sol = timed(partial(tb.simulate, scene, t, method=method, form=form, **own))
            error = distance(sol.nodes, best[method if method == "midpoint" else form]) / (
                rtol * length
            )
            steps_made = int(work(sol)) if method == "midpoint" else sol.stats.evaluations
            rows.append(Explicit(method, form, rtol, float(error), steps_made, spent))
            if method == "rk4":
                break  # its step is the largest that is stable, whatever the tolerance
    return rows


@torch.no_grad()
def study(options: Namespace) -> Report:
    samples, elements = (1, 3) if options.quick else (SAMPLES, 6)
    rows = measure(options.seed, samples, elements, QUICK if options.quick else None)
    explicit = explicit_methods(3, SPAN, (1e-3,))
    names = dict.fromkeys(r.family for r in rows)
    counts = dict(seed=options.seed, scenes=len(rows), families=len(names))
    about = ABOUT.format(**counts, elements=elements, outputs=OUTPUTS)
    others = EXPLICIT_ABOUT.format(span=SPAN), explicit_markdown(explicit)
    data = {"about": about, "explicit": [asdict(r) for r in explicit]}
    return Report([about, markdown(rows), *others], rows, data)


def markdown(rows: Sequence[ControlledRun]) -> str:
    """The table by families, and of all."""

    def line(name: str, some: list[ControlledRun]) -> str:
        errors = sorted(r.error for r in some)
        ratios = sorted(r.work / r.equal for r in some if r.equal == r.equal)
        within = sum(r.error <= 1 and r.status == 0 for r in some)
        turned = sorted(r.rotation for r in some)
        steps = sorted(r.steps * 2**r.level for r in some)
        work = (f"{_share(ratios, q):.1f}" if ratios else "" for q in (0.5, 0.95))
        return (
            f"{name} | {within} of {len(some)} | {_share(errors, 0.5):.2g} | "
            f"{_share(errors, 0.95):.2g} | {errors[-1]:.2g} | {_share(turned, 0.5):.2g} | "
            f"{turned[-1]:.2g} | {_share(steps, 0.5):.0f} | {sum(r.rejected for r in some)} | "
            f"{' | '.join(work)}"
        )

    head = (
        "scenes | within the tolerance | error over tolerance: median | 95 % | largest | "
        "of rotations: median | largest | steps of the last run | refused, all | "
        "work over equal steps: median | 95 %"
    )
    names = dict.fromkeys(r.family for r in rows)
    lines = [line(name, [r for r in rows if r.family == name]) for name in names]
    return table(head, [*lines, line("all", list(rows))], words=1)


def explicit_markdown(rows: Sequence[Explicit]) -> str:
    """The table of explicit methods."""
    head = "method | form | rtol | error over tolerance | evaluations, or implicit steps | CPU s"
    lines = (
        f"{r.method} | {r.form} | {r.rtol:g} | {r.error:.2g} | {r.evaluations} | {r.seconds:.2g}"
        for r in rows
    )
    return table(head, lines, words=2)


def _share(values: Sequence[float], share: float) -> float:
    """Quantile of sorted values."""
    return values[min(len(values) - 1, int(share * len(values)))]


main = Study(
    "control",
    "True error of adaptive steps beside the tolerance, and their cost.",
    "Random scenes by adaptive steps, against references by refinement; and explicit methods by "
    "the same tolerance.",
    study,
    quick="one sample of each of two families",
    options={
        "--seed": dict(
            type=int,
            default=SEED,
            help="of the random scenes (default: %(default)s; the constants of the control were "
            "chosen on those of 1)",
        )
    },
)
