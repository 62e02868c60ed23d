"""Coverage of identified fields: how often the posterior's intervals of a stiffness by element hold
the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table

from .batched_calls import BatchedCalls, as_one_batch

REPEATS, LEVEL = 200, 0.95
TOLD = 50  # repeats from one line of progress to the next
ELEMENTS, LENGTH, MASS = 10, 0.5, 0.25  # m, kg/m
LOADS = (-4.0, 2.0, 4.0)  # N, at the tip
# few samples a call, and many calls
ENGINE = "auto" if find_spec("llvmlite") is None else "compiled"
SIGMA = 2e-5  # m, of a height
SPREAD, DEPTH = 0.3, 0.3  # deviation of ln EI from one end to the other; share that a dent takes
ABOUT = (
    "A strip of 0.5 m in {elements} elements sags under its weight and each of {loads} loads on "
    "its tip, and a camera reads the heights of all nodes to {sigma:g} mm. EI of each element is "
    "found by `identify_fields`, from a uniform start, {repeats} times, and it is counted how "
    "often its {level:g} % interval (`FieldFit.interval`) holds the truth. Smooth: ln EI is drawn "
    "from the prior itself, a walk whose ends differ by {spread:g} (one deviation), another in "
    "each repeat. Dent: EI falls evenly by 30 % from clamp to tip, and is {depth:g} % less in one "
    "element, another in each repeat. Lowest: of the elements. Error: RMS over the stated "
    "deviation. Told: how many of the {elements} numbers the data tell, on average."
)


@dataclass(frozen=True)
class Case:
    """What the fields are, whether the prior's law is Student's, whether sigma is given."""

    name: str
    dent: bool = False
    sharp: bool = False
    known: bool = True
    repeats: int = REPEATS


CASES = (
    Case("smooth, weight found"),
    Case("smooth, weight and noise found", known=False),
    Case("dent, normal law", dent=True),
    Case("dent, sharp", dent=True, sharp=True),
)


@dataclass(frozen=True)
class FieldCoverage:
    """Share of elements and repeats whose interval held the truth: of all, of the element in which
    it is least, of dents and of their neighbours (None: there are none); RMS error of ln EI over
    the deviation; numbers that the data tell, and repeats that settled.
    """

    case: str
    covered: float
    lowest: float
    dents: float | None
    neighbours: float | None
    error: float
    determined: float
    repeats: int
    settled: int


def heights(EI: Tensor) -> Tensor:
    """Heights (n, loads, ELEMENTS) m of the nodes for EI (n, ELEMENTS); NaN of samples that
    fail.
    """
    EI = EI[:, None]

    def section(s: Tensor) -> tb.Section:
        return tb.Section.from_stiffness(
            EA=1e6, GA=1e6, GJ=1.0, EI=EI[..., (s * (ELEMENTS / LENGTH)).long()], mass=MASS
        )

    force = torch.tensor(LOADS, dtype=torch.float64)[:, None] * torch.tensor(
        [0.0, 0.0, 1.0], dtype=torch.float64
    )
    beam = tb.Beam.straight(EI.new_tensor(LENGTH), ELEMENTS, section).linked()
    scene = tb.Scene(beam, [tb.Gravity((0.0, 0.0, -9.81)), tb.TipLoad(force=force)], plane="xz")
    state = tb.equilibrium(scene, throw=False, engine=ENGINE)
    return torch.where((state.status == 0)[..., None], state.position[..., 1:, 2], torch.nan)


def truths(case: Case, repeats: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """EI (repeats, ELEMENTS) N m^2, and which element has the dent (repeats,)."""
    where = torch.randint(1, ELEMENTS - 1, (repeats,), generator=random)
    if case.dent:
        s = (torch.arange(ELEMENTS, dtype=torch.float64) + 0.5) / ELEMENTS
        return (1 - 0.3 * s) * (1 - DEPTH * torch.nn.functional.one_hot(where, ELEMENTS)), where
    rows = tb.Smoothness().rows(torch.zeros(ELEMENTS, dtype=torch.float64))
    walk = (
        SPREAD
        * torch.randn(repeats, len(rows), generator=random, dtype=torch.float64)
        @ torch.linalg.pinv(rows).mT
    )
    return walk.exp(), where


def found(case: Case, data: Tensor, calls: BatchedCalls) -> tb.FieldFit:
    """EI from heights (loads, ELEMENTS)."""
    start = tb.Parameter(torch.full((ELEMENTS,), 0.8, dtype=torch.float64), "log")
    return tb.identify_fields(
        lambda theta: calls(heights, theta["EI"]),
        tb.Measurement(data, SIGMA if case.known else None),
        {"EI": start},
        {"EI": tb.Smoothness(sharp=case.sharp)},
        derivatives="difference",
    )


def measure(case: Case, seed: int = 0) -> FieldCoverage:
    """Row of one case."""
    torch.set_num_threads(1)
    random, repeats = torch.Generator().manual_seed(seed), case.repeats
    EI, where = truths(case, repeats, random)
    exact = heights(EI)
    data = exact + SIGMA * torch.randn(exact.shape, generator=random, dtype=torch.float64)
    held, errors, determined, settled = [], [], 0.0, 0
    for k, fit in enumerate(as_one_batch(partial(found, case), data)):
        if k % TOLD == 0:
            progress(f"{case.name}: {k} of {repeats}")
        low, high = fit.interval("EI", LEVEL).unbind(-1)
        held.append((low <= EI[k]) & (EI[k] <= high))
        errors.append((fit["EI"] / EI[k]).log() / (fit.deviation("EI") / fit["EI"]))
        determined += fit.effective / repeats
        settled += fit.settled
    inside, error = torch.stack(held).double(), torch.stack(errors)
    every = torch.arange(repeats)
    beside = torch.cat((inside[every, where - 1], inside[every, where + 1])).mean().item()
    dents = (inside[every, where].mean().item(), beside) if case.dent else (None, None)
    covered, lowest = inside.mean().item(), inside.mean(0).min().item()
    rms = error.square().mean().sqrt().item()
    return FieldCoverage(case.name, covered, lowest, *dents, rms, determined, repeats, settled)


def markdown(rows: Sequence[FieldCoverage]) -> str:
    """A line for each case."""

    def share(x: float | None) -> str:
        return "" if x is None else f"{100 * x:.1f}"

    head = (
        "field and prior | EI: % | lowest | in the dent | beside it | error, deviations | told | "
        "settled"
    )
    lines = []
    for r in rows:
        shares = map(share, (r.covered, r.lowest, r.dents, r.neighbours))
        settled = f"{r.settled} of {r.repeats}"
        lines.append((r.case, *shares, f"{r.error:.2f}", f"{r.determined:.1f}", settled))
    return table(head, lines, words=1)


def about() -> str:
    """What was done, in words."""
    return ABOUT.format(
        elements=ELEMENTS, loads=len(LOADS), sigma=1e3 * SIGMA, repeats=REPEATS, level=100 * LEVEL,
        spread=SPREAD, depth=100 * DEPTH,
    )  # fmt: skip
