"""Coverage: how often stated intervals of identified parameters hold the truth."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import torch
from torch import Tensor
from torch.distributions import Normal

import torchbeam as tb
from torchbeam.analysis.identification.experiment import Experiment
from torchbeam.analysis.identification.parameters import Parameters
from torchbeam.analysis.identification.refinement import refined
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import process_pool, table
from torchbeam.solvers.least_squares import search

from . import field_coverage
from .batched_calls import BatchedCalls, as_one_batch
from .harness import Report, Study

TRUE = {"EI": 1.0, "tau": 2e-3, "clamp": 40.0, "tip": 0.05}
LENGTH, MASS, SPAN = 0.5, 0.25, 0.3  # m, kg/m, s
NOISE, SAG = 0.05, 2e-4  # of the RMS of a channel; m
TOLD = 50  # repeats from one line of progress to the next
CLOCK = 2e-3  # deviation of the clock's relative error
READINGS = 100
REPEATS, RESAMPLES = 200, 199
LEVEL = 0.95
SMALL, COARSE, REFINED, FINE = (4, 2e-3), (6, 1e-3), (12, 2.5e-4), (24, 1.25e-4)  # elements, step
ABOUT = (
    "A strip of 0.5 m with a tip mass in an elastic clamp, struck at the tip; two accelerometers "
    "({readings} readings each over {span:g} s at irregular times, 5 % noise, unknown offsets) "
    "and the sag (0.2 mm). EI, damping, clamp and tip mass are identified {repeats} times, from "
    "starts within a factor of 1.5, and it is counted how often the stated {level:g} % interval "
    "holds the truth: so many repeats know that to {binomial:.1f} % (one deviation). Own mesh: "
    "the data are those of the model ({coarse[0]} elements, steps of {coarse_ms:g} ms; of profile "
    "and bootstrap, of which each repeat is a batch of fits, {small[0]} elements and {small_ms:g} "
    "ms, and {resamples} sets of data); else of {fine[0]} elements and steps of {fine_ms:g} ms; "
    "refined: the fit was carried over to {refined[0]} elements and steps of {refined_ms:g} ms by "
    "`Fit.refined`. Clock: the sampling rate is off by {clock:g} % (one deviation), another "
    "amount in each repeat; it is a parameter with that prior, or left out. Warned: how many fits "
    "said that misfit or residuals are no noise."
)


@dataclass(frozen=True)
class Case:
    """Data and model of a row: mesh of the data and of the model, deviation of the clock, whether
    the clock is a parameter, and whether sigma is known.
    """

    name: str
    mesh: tuple[int, float] = FINE
    model: tuple[int, float] = COARSE
    clock: float = 0.0
    known_clock: bool = False
    absolute_sigma: bool = True
    refined: bool = False
    method: str = "laplace"
    repeats: int = REPEATS


CASES = (
    Case("noise, own mesh", COARSE),
    Case("noise, own mesh, sigma from the misfit", COARSE, absolute_sigma=False),
    Case("noise, finer mesh"),
    Case("noise, finer mesh, refined", refined=True),
    Case(
        "noise, finer mesh, wrong clock, refined, clock a parameter",
        clock=CLOCK,
        known_clock=True,
        refined=True,
    ),
    Case("noise, finer mesh, wrong clock, refined, clock left out", clock=CLOCK, refined=True),
    Case("noise, own mesh", SMALL, SMALL, method="profile"),
    Case("noise, own mesh", SMALL, SMALL, method="bootstrap"),
)


@dataclass(frozen=True)
class ParameterCoverage:
    """One parameter of one case: share of repeats whose interval held the truth; RMS and mean of
    the error of its logarithm (the clock: of itself) over the stated deviation; repeats that
    converged, and that were warned of.
    """

    case: str
    method: str
    parameter: str
    coverage: float
    error: float
    bias: float
    repeats: int
    converged: int
    warned: int


def scene(theta: dict[str, Tensor], elements: int, struck: bool) -> tb.Scene:
    """Strips of parameters (n,) in the plane of their motion."""
    section = tb.Section.from_stiffness(
        EA=2e6, GA=4e5, GJ=1.0, EI=theta["EI"], mass=MASS, inertia=5e-6
    )
    effects: list[Any] = [
        tb.Gravity((0.0, 0.0, -9.81)),
        tb.Damping(theta["tau"]),
        tb.PointMass(theta["tip"]),
        tb.RootSpring((0.0, theta["clamp"][..., None])),
    ]
    if struck:
        effects.append(
            tb.TipLoad(
                force=lambda t: (0.0, 0.0, 4 * torch.sin(torch.pi * t.clamp(0, 0.03) / 0.03) ** 2)
            )
        )
    beam, foot = tb.Beam.straight(LENGTH, elements, section).linked(), tb.Support(0, rotation="xz")
    return tb.Scene(beam, effects, supports=foot, plane="xz")


def motion(theta: dict[str, Tensor], elements: int, step: float) -> tb.Solution:
    """From the sag on, for a little longer than the record: clocks may be late."""
    sagging = tb.equilibrium(scene(theta, elements, False), throw=False)
    t = torch.linspace(0, 1.02 * SPAN, 154, dtype=torch.float64)
    return tb.simulate(scene(theta, elements, True), t, initial=sagging, step=step)


def sag(theta: dict[str, Tensor], elements: int) -> tuple[Tensor, Tensor]:
    """Deflection (n,) m of the tip at rest, and status."""
    state = tb.equilibrium(scene(theta, elements, False), throw=False)
    return state.tip.position[:, 2], state.status


def accelerometers(states: Any) -> Tensor:
    """Velocities (..., 2) m/s half way and at the tip, of any mesh; their rates are what is
    measured.
    """
    return torch.stack(
        [states.velocity[..., k, 2] for k in (states.velocity.shape[-2] // 2, -1)], -1
    )


@dataclass
class Laboratory:
    """Where a case's data come from: the motion and the sag of the truth by its mesh, read at
    irregular times.
    """

    case: Case
    random: torch.Generator

    def __post_init__(self) -> None:
        truth = {name: torch.tensor([value], dtype=torch.float64) for name, value in TRUE.items()}
        self.motion, self.sag = motion(truth, *self.case.mesh), sag(truth, self.case.mesh[0])[0][0]
        places = torch.arange(READINGS) + 0.9 * torch.rand(
            READINGS, generator=self.random, dtype=torch.float64
        )
        self.times = SPAN / READINGS * places
        self.sigma = NOISE * self.read(0.0).square().mean(0).sqrt()

    def read(self, clock: float) -> Tensor:
        """(times, 2) m/s^2 with a clock that is off."""
        return tb.observe(self.motion, accelerometers, self.times * (1 + clock), rate=True)[:, 0]

    def normal(self, *shape: int) -> Tensor:
        return torch.randn(shape, generator=self.random, dtype=torch.float64)

    def record(self) -> tuple[dict[str, tb.Measurement], float]:
        """Measurements of one repeat, and the error of its clock."""
        clock = self.case.clock * self.normal().item()
        values = self.read(clock) + 0.3 * self.normal(2) + self.sigma * self.normal(READINGS, 2)
        known = dict(rate=True, offset=True, clock="clock" if self.case.known_clock else 0.0)
        record = tb.Measurement(
            values, self.sigma, self.times, accelerometers, **known, name="accelerometer"
        )
        return {
            "strike": record,
            "sag": tb.Measurement(self.sag + SAG * self.normal(), SAG, name="sag"),
        }, clock


def identified(
    case: Case, records: Sequence[dict[str, tb.Measurement]], random: torch.Generator
) -> Iterator[tb.Fit]:
    """A fit of each record, from starts within a factor of 1.5, all of them followed as one
    batch.
    """
    log = {
        name: tb.Parameter(torch.tensor(value, dtype=torch.float64), "log")
        for name, value in TRUE.items()
    }
    if case.known_clock:
        log["clock"] = tb.Parameter(
            torch.zeros((), dtype=torch.float64), prior=Normal(0.0, CLOCK), scale=CLOCK
        )
    models, finer = (
        {"strike": partial(motion, elements=n, step=step), "sag": partial(sag, elements=n)}
        for n, step in (case.model, REFINED)
    )
    one = tb.identify(models, records[0], log, absolute_sigma=case.absolute_sigma).problem
    data = [[m.values for m in record.values()] for record in records]
    together = replace(one, target=torch.cat([one.with_data(values).target for values in data]))
    factor = 1.5 ** (
        2 * torch.rand(len(records), len(TRUE), generator=random, dtype=torch.float64) - 1
    )
    x = one.parameters.x.repeat(len(records), 1)
    x[:, : len(TRUE)] += factor.log()
    region = together.region(x)
    with torch.no_grad():
        search_result = search(together, x, region, 50, 1e-6)
        if case.refined:
            together, search_result, region = refined(
                together, finer, search_result.x, search_result.J, 1.0
            )
        for k, values in enumerate(data):
            problem, some = together.with_data(values), torch.tensor([k])
            yield tb.Fit.of(
                problem, search_result.of(some), region.of(some).against(problem.target),
                "difference", 1e-6,
            )  # fmt: skip


@dataclass(frozen=True)
class Shared(Experiment):
    """An experiment that is evaluated together with those of other repeats, which differ in their
    data alone.
    """

    calls: BatchedCalls
    evaluate: Callable[[Tensor], Tensor]

    def values(self, parameters: Parameters, theta: Tensor) -> Tensor:
        return self.calls(self.evaluate, theta)


def stated(case: Case, fits: Sequence[tb.Fit], names: Sequence[str]) -> Iterator[Tensor]:
    """Intervals (names, 2) of each fit's first parameters, which have these names."""
    problem = fits[0].problem
    evaluate = [partial(e.values, problem.parameters) for e in problem.experiments]

    def interval(one: tuple[int, tb.Fit], calls: BatchedCalls) -> Tensor:
        seed, fit = one
        shared = tuple(
            Shared(e.name, e.model, e.measurements, e.single, calls, own)
            for e, own in zip(fit.problem.experiments, evaluate, strict=True)
        )
        fit = replace(fit, problem=replace(fit.problem, experiments=shared))
        if case.method == "profile":
            return torch.stack([one.interval for one in fit.profile(*names, level=LEVEL)])
        return fit.bootstrap(RESAMPLES, seed=seed).interval(LEVEL)[: len(names)]

    if case.method == "laplace":
        return (fit.interval(LEVEL)[: len(names)] for fit in fits)
    return as_one_batch(interval, [*enumerate(fits)])


def measure(case: Case, seed: int = 0) -> list[ParameterCoverage]:
    """Rows of one case."""
    torch.set_num_threads(1)
    random = torch.Generator().manual_seed(seed)
    laboratory = Laboratory(case, random)
    records, clocks = zip(*(laboratory.record() for _ in range(case.repeats)), strict=True)
    names = [*TRUE, *(["clock"] if case.known_clock else [])]
    fits = list(identified(case, records, random))
    progress(f"{case.name}, {case.method}: {case.repeats} fits")
    warned = sum(bool(fit.doubts) for fit in fits)
    done = [(fit, clock) for fit, clock in zip(fits, clocks, strict=True) if fit.status == 0]
    inside, errors = [], []
    for (fit, clock), interval in zip(
        done, stated(case, [fit for fit, _ in done], names), strict=True
    ):
        truth = torch.tensor([*TRUE.values(), clock][: len(names)], dtype=torch.float64)
        inside.append((interval[:, 0] <= truth) & (truth <= interval[:, 1]))
        exact = fit.theta.clone()
        exact[: len(names)] = truth
        errors.append(
            ((fit.x - fit.transform.x(exact)) / fit.x_covariance.diagonal().sqrt())[: len(names)]
        )
        if len(inside) % TOLD == 0 and case.method != "laplace":
            progress(f"{case.name}, {case.method}: {len(inside)} of {len(done)} intervals")
    held, error = torch.stack(inside).double().mean(0), torch.stack(errors)
    rms, bias = error.square().mean(0).sqrt().tolist(), error.mean(0).tolist()
    counts = case.repeats, len(inside), warned
    return [
        ParameterCoverage(case.name, case.method, name, held[k].item(), rms[k], bias[k], *counts)
        for k, name in enumerate(names)
    ]


def markdown(rows: Sequence[ParameterCoverage]) -> str:
    """A line for each case."""
    names = [*TRUE, "clock"]
    lines = []
    for key in dict.fromkeys((r.case, r.method) for r in rows):
        some = {r.parameter: r for r in rows if (r.case, r.method) == key}
        one = next(iter(some.values()))
        lines.append(
            (
                *key,
                *(f"{100 * some[n].coverage:.1f}" if n in some else "" for n in names),
                f"{max(abs(r.bias) for r in some.values()):.2f}",
                f"{one.converged} of {one.repeats}",
                f"{one.warned}",
            )
        )
    shares = " | ".join(f"{n}: %" for n in names)
    head = f"data and model | interval | {shares} | largest bias, deviations | converged | warned"
    return table(head, lines, words=2)


def study(options: Namespace) -> Iterator[Report]:
    cases, smooth = CASES, field_coverage.CASES
    if options.quick:
        cases, smooth = (
            tuple(replace(case, repeats=4) for case in some) for some in (CASES[:2], smooth[:1])
        )
    rows: list[ParameterCoverage] = []
    fields: list[field_coverage.FieldCoverage] = []
    with process_pool(min(len(cases), os.cpu_count() or 1)) as pool:
        parts = (
            pool.map(measure, cases, range(len(cases))),
            pool.map(field_coverage.measure, smooth),
        )
        for row in chain(*parts):
            if isinstance(row, list):
                rows += row
            else:
                fields.append(row)
            text = [about(), markdown(rows)]
            if fields:
                text += [field_coverage.about(), field_coverage.markdown(fields)]
            yield Report(text, rows, {"about": about(), "fields": [asdict(r) for r in fields]})


def about() -> str:
    """What was done, in words."""
    return ABOUT.format(
        readings=READINGS, span=SPAN, repeats=REPEATS, resamples=RESAMPLES, level=100 * LEVEL,
        small=SMALL, coarse=COARSE, fine=FINE, refined=REFINED, small_ms=1e3 * SMALL[1],
        coarse_ms=1e3 * COARSE[1], fine_ms=1e3 * FINE[1], refined_ms=1e3 * REFINED[1],
        clock=100 * CLOCK, binomial=100 * (LEVEL * (1 - LEVEL) / REPEATS) ** 0.5,
    )  # fmt: skip


main = Study(
    "identification",
    "How often stated intervals of identified parameters and fields hold the truth.",
    "Repeated identification of synthetic data: noise, a finer mesh, a wrong clock; fields that "
    "are smooth, and dents.",
    study,
    quick="four repeats of three cases",
)
