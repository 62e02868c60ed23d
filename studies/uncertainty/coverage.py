"""Coverage of every interval: how often it holds the truth, over many repeats of cases whose
answers are known.

python -m studies coverage
"""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table
from torchbeam.math.distributions import binomial_interval, normal_score

from ..harness import Report, Study

REPEATS, QUICK = 200, 20
LEVEL = 0.95
EI, P = tb.laws.LogNormal(1.0, 0.2), tb.laws.LogNormal(1.0, 0.3)
LAWS = {"EI": EI, "P": P}
MU, SIGMA = P.mu - EI.mu - math.log(3), math.hypot(P.sigma, EI.sigma)  # of ln w
MEAN = math.exp(MU + SIGMA**2 / 2)
DEVIATION = MEAN * math.sqrt(math.expm1(SIGMA**2))
ABOUT = (
    "Tip deflection w = P L^3/(3 EI) of a strip under a small load, EI lognormal with a "
    "coefficient of variation of 20 %, P with 30 %, independent, so that w is lognormal and all "
    "answers are known. Each row: {repeats} repeats with other seeds. Covered: share of the 95 % "
    "intervals that hold the truth; of intervals that hold it in 95 % of all runs this is within "
    "{low:.0f} to {high:.0f} % in 95 of 100 rows. Width: mean width of the interval over the true "
    "value. Error: RMS error over the true value. Events, rare and likely: P(w > x), and a linear "
    "limit state in five normal variables."
)


@dataclass(frozen=True)
class AnswerCoverage:
    """Answer, how it was found, evaluations of one repeat; share of intervals that hold the truth;
    mean width and RMS error, over the true value.
    """

    answer: str
    how: str
    samples: int
    covered: float
    width: float
    error: float

    def cells(self) -> list[str]:
        return [
            self.answer, self.how, f"{self.samples:,}", f"{100 * self.covered:.1f} %",
            *(f"{100 * x:.3g} %" for x in (self.width, self.error)),
        ]  # fmt: skip


@dataclass(frozen=True)
class Case:
    """`run(seed)` gives (evaluations, {answer: (estimate, low, high)}); `truth` by answer."""

    how: str
    run: Callable[[int], tuple[int, dict[str, Any]]]
    truth: dict[str, float]


def deflection(theta: Tensor) -> Tensor:
    return theta[:, 1] / (3 * theta[:, 0])


def quantile(level: float) -> float:
    return math.exp(MU + SIGMA * normal_score(torch.tensor(level, dtype=torch.float64)).item())


def cases() -> Iterator[Case]:
    """All cases; what each answers, and the truth."""
    truth = {
        "mean": MEAN, "deviation": DEVIATION, "median": quantile(0.5),
        "95 % quantile": quantile(0.95), "99 % quantile": quantile(0.99), "P = 0.1": 0.1,
        "P = 0.01": 0.01,
    }  # fmt: skip

    def of(samples: Any) -> dict[str, Any]:
        intervals = {
            "mean": samples.mean_interval(LEVEL),
            "median": samples.quantile(0.5, LEVEL),
            "95 % quantile": samples.quantile(0.95, LEVEL),
            "99 % quantile": samples.quantile(0.99, LEVEL),
            "P = 0.1": samples.exceedance(quantile(0.9), LEVEL),
            "P = 0.01": samples.exceedance(quantile(0.99), LEVEL),
        }
        if hasattr(samples, "deviation_interval"):
            intervals["deviation"] = samples.deviation_interval(LEVEL)
        return intervals

    def run(**options: Any) -> Callable[[int], tuple[int, dict[str, Any]]]:
        def one(seed: int) -> tuple[int, dict[str, Any]]:
            samples = tb.monte_carlo(deflection, LAWS, seed=seed, chunk=2**16, **options)
            return len(samples), of(samples)

        return one

    def stream(seed: int) -> tuple[int, dict[str, Any]]:
        return 4096, of(tb.monte_carlo_stream(deflection, LAWS, 4096, seed=seed))

    def until(seed: int) -> tuple[int, dict[str, Any]]:
        samples = tb.monte_carlo(deflection, LAWS, 2**14, until=0.002, seed=seed, chunk=2**16)
        return len(samples), {"mean": samples.mean_interval(LEVEL)}

    yield Case("plain", run(n=1024, design="plain"), truth)
    yield Case("16 Sobol sequences", run(n=1024, replicates=16), truth)
    yield Case("16 Sobol sequences", run(n=4096, replicates=16), truth)
    yield Case(
        "1 Sobol sequence",
        run(n=1024),
        {name: truth[name] for name in truth if name != "deviation"},
    )
    yield Case(
        "stream of 16 Sobol sequences",
        stream,
        {name: truth[name] for name in truth if name != "deviation"},
    )
    yield Case("until 0.2 %", until, {"mean": MEAN})
    yield from sensitivities()
    yield from rare()


def sensitivities() -> Iterator[Case]:
    """Sobol indices of w, and the derivatives of its moments by the deviation of EI."""
    a, b, both = (math.expm1(s**2) for s in (EI.sigma, P.sigma, SIGMA))
    shares = {
        "first index of EI": a / both,
        "first index of P": b / both,
        "total index of EI": 1 - b / both,
        "total index of P": 1 - a / both,
    }

    def indices(seed: int) -> tuple[int, dict[str, Any]]:
        estimate = tb.sobol_indices(deflection, LAWS, 1024, seed=seed, chunk=2**16, interval=LEVEL)
        rows = {}
        for k, kind in enumerate(("first", "total")):
            for j, name in enumerate(estimate.names):
                rows[f"{kind} index of {name}"] = (
                    getattr(estimate, kind)[j],
                    estimate.low[k, j],
                    estimate.high[k, j],
                )
        return estimate.evaluations, rows

    q = torch.tensor([0.2], dtype=torch.float64, requires_grad=True)
    c = (P.deviation / P.mean) ** 2
    mean = (1 + q[0] ** 2) / 3  # E(1/EI) = 1 + c^2 with the mean 1
    deviation = mean * (((1 + q[0] ** 2) * (1 + c)) - 1).sqrt()
    by = [torch.autograd.grad(y, q, retain_graph=True)[0].item() for y in (mean, deviation)]

    def derivatives(seed: int) -> tuple[int, dict[str, Any]]:
        estimate = tb.moment_derivatives(
            deflection, lambda q: {"EI": tb.laws.LogNormal(1.0, q[0]), "P": P}, q.detach(), 1024,
            seed=seed, chunk=2**16, interval=LEVEL,
        )  # fmt: skip
        return 1024, {
            "d mean/d deviation of EI": [x[0] for x in estimate.mean_by],
            "d deviation/d deviation of EI": [x[0] for x in estimate.deviation_by],
        }

    yield Case("16 Sobol sequences", indices, shares)
    yield Case(
        "16 Sobol sequences",
        derivatives,
        dict(zip(("d mean/d deviation of EI", "d deviation/d deviation of EI"), by, strict=True)),
    )


def rare() -> Iterator[Case]:
    """Rare events of both methods, and one that is likely: the strip, and a linear limit state."""
    normals = {f"x{k}": tb.laws.Normal(0.0, 1.0) for k in range(5)}

    def linear(theta: Tensor) -> Tensor:
        return theta.sum(-1) / math.sqrt(5)

    for answer, p in (("P = 0.99", 0.99), ("P = 1e-4", 1e-4), ("P = 1e-6", 1e-6)):
        beta = -normal_score(torch.tensor(p, dtype=torch.float64)).item()
        for method, n in (("subset", 5000), ("importance", 1024)):
            for name, function, inputs, x in (
                ("strip", deflection, LAWS, math.exp(MU + SIGMA * beta)),
                ("linear", linear, normals, beta),
            ):
                asked = partial(tb.rare_event, function, inputs, x, n, method=method)
                event = f"{answer}, {name}"

                def one(
                    seed: int, asked: Callable[..., Any] = asked, event: str = event
                ) -> tuple[int, dict[str, Any]]:
                    estimate = asked(seed=seed, chunk=2**16, interval=LEVEL)
                    found = estimate.probability, estimate.low, estimate.high
                    return estimate.evaluations, {event: found}

                yield Case(f"{method}, n = {n}", one, {event: p})


def measured(case: Case, repeats: int) -> list[AnswerCoverage]:
    """Rows of a case, over seeds 0 to repeats - 1."""
    intervals: dict[str, list[tuple[float, float, float]]] = {name: [] for name in case.truth}
    evaluations = 0
    for seed in range(repeats):
        samples, answers = case.run(seed)
        evaluations += samples
        for name in case.truth:
            intervals[name].append(tuple(float(x) for x in answers[name]))  # type: ignore[arg-type]
    rows = []
    for name, truth in case.truth.items():
        inside = sum(low <= truth <= high for _, low, high in intervals[name]) / repeats
        width = sum(high - low for _, low, high in intervals[name]) / repeats / abs(truth)
        error = math.sqrt(sum((x - truth) ** 2 for x, _, _ in intervals[name]) / repeats) / abs(
            truth
        )
        rows.append(
            AnswerCoverage(name, case.how, round(evaluations / repeats), inside, width, error)
        )
    return rows


def expected(repeats: int) -> tuple[float, float]:
    """Range of the covered share, in 95 of 100 rows, of intervals that cover 95 %: Clopper and
    Pearson's about it.
    """
    return binomial_interval(LEVEL * repeats, repeats, 0.95)


def study(options: Namespace) -> Report:
    repeats, rows = QUICK if options.quick else REPEATS, []
    for case in cases():
        rows += (new := measured(case, repeats))
        for row in new:
            progress(f"{row.answer}, {row.how}: {100 * row.covered:.1f} %")
    low, high = expected(repeats)
    about = ABOUT.format(repeats=repeats, low=100 * low, high=100 * high)
    head = "answer | how | samples | covered | width | error"
    return Report([about, table(head, [r.cells() for r in rows], 2)], rows, {"repeats": repeats})


main = Study(
    "coverage",
    "Coverage of every interval over 200 repeats of cases whose answers are known.",
    "How often each 95 % interval of monte_carlo, sobol_indices, moment_derivatives and rare_event "
    "holds the truth.",
    study,
    quick=f"{QUICK} repeats, for a test of the command",
)
