"""How often the 95 % intervals of every answer hold the truth, where it is known in closed form:
of functions so smooth that replicates scatter little, and of rare events with several branches.
"""

import math
import warnings
from functools import partial

import pytest
import torch
from torch import Tensor

import torchbeam as tb

LEVEL = 0.95
UNIT = {name: (0.0, 1.0) for name in "ab"}
NORMALS = {name: tb.laws.Normal(0.0, 1.0) for name in "abcd"}


def total(theta: Tensor) -> Tensor:
    return theta.sum(-1)


def tail(beta: float) -> float:
    return 0.5 * math.erfc(beta / 2**0.5)


def samples(n: int, seed: int, names: str = "ab") -> tb.Samples:
    laws = {name: UNIT[name] for name in names}
    return tb.monte_carlo(total, laws, n, replicates=16, seed=seed, dtype=torch.float64)


def deviation_of_a_law(n: int, seed: int) -> tuple[Tensor, ...]:
    """Of a, by its width: the deviation itself, and its derivative."""
    answers = tb.moment_derivatives(
        total, lambda q: {"a": lambda u: q[0] * u}, torch.tensor([1.0], dtype=torch.float64), n,
        seed=seed,
    )  # fmt: skip
    return tuple(
        torch.stack((x, y[0])) for x, y in zip(answers.deviation, answers.deviation_by, strict=True)
    )


def indices(n: int, seed: int) -> tuple[Tensor, ...]:
    """Of 2 a + b + a b: first and total."""
    s = tb.sobol_indices(
        lambda theta: 2 * theta[:, 0] + theta[:, 1] + theta.prod(-1), UNIT, n, seed=seed,
        dtype=torch.float64,
    )  # fmt: skip
    return torch.stack((s.first, s.total)), s.low, s.high


# of the variance: (2.5^2 + 1.5^2)/12, and (1/12)^2 of both together
BOTH, ALONE = 1 / 144, torch.tensor([2.5**2 / 12, 1.5**2 / 12], dtype=torch.float64)
SHARES = torch.stack((ALONE, ALONE + BOTH)) / (ALONE.sum() + BOTH)

# answer: (n, seed) -> estimate, low, high; the truth; n
SMOOTH = {
    "mean": (lambda n, seed: samples(n, seed).mean_interval(LEVEL), 1.0, 1024),
    "deviation": (lambda n, seed: samples(n, seed, "a").deviation_interval(LEVEL), 12**-0.5, 4096),
    "median": (lambda n, seed: samples(n, seed).quantile(0.5, LEVEL), 1.0, 1024),
    "probability": (lambda n, seed: samples(n, seed).exceedance(1.5, LEVEL), 0.125, 1024),
    "moment_derivatives": (
        deviation_of_a_law,
        torch.tensor([12**-0.5, 12**-0.5], dtype=torch.float64),
        4096,
    ),
    "sobol_indices": (indices, SHARES, 1024),
}


def branches(k: int, theta: Tensor) -> Tensor:
    return theta[:, :k].abs().amax(-1)


# y of four normal variables, the threshold, its probability
BRANCHES = {
    "two": (partial(branches, 1), 3.5, 2 * tail(3.5)),
    "four": (partial(branches, 2), 3.5, 1 - (1 - 2 * tail(3.5)) ** 2),
    "eight": (partial(branches, 4), 3.5, 1 - (1 - 2 * tail(3.5)) ** 4),
    "unlike": (lambda t: torch.maximum(t[:, 0], -t[:, 0] - 0.3), 3.5, tail(3.5) + tail(3.8)),
    "flat among usual values": (
        lambda t: torch.maximum(t[:, 0], 4 * t[:, 1] - 7.875),
        3.5,
        1 - (1 - tail(3.5)) * (1 - tail(2.84375)),
    ),
    "one": (lambda t: t.sum(-1) / 2, 3.5, tail(3.5)),
}


FAILING = {  # the event is a > 3.5; which scores (N, 4) fail, and how many by the laws
    "opposite": (lambda t: t[:, 0] < -2.5, tail(2.5), tail(3.5)),
    "beside": (lambda t: t[:, 1] < -2.5, tail(2.5), tail(3.5) * (1 - tail(2.5))),
    "scattered": (lambda t: torch.frac(1e5 * t[:, 0].abs()) < 0.01, 0.01, 0.99 * tail(3.5)),
    "beyond": (lambda t: t[:, 0] > 3.7, tail(3.7), tail(3.5) - tail(3.7)),
}


def held(runs: list[tuple[Tensor, ...]], truth: Tensor | float) -> Tensor:
    """How many (...) of the intervals hold the truth."""
    low, high = (torch.stack([torch.as_tensor(run[k]) for run in runs]) for k in (1, 2))
    return ((low <= truth) & (truth <= high)).sum(0)


def fewest(repeats: int) -> int:
    """So many intervals hold the truth in 999 of 1000 sets of runs, of intervals that do so in 92 %
    (Student's, of what is not quite normal).
    """
    share, below = 0.92, 0.0
    for k in range(repeats):
        below += math.comb(repeats, k) * share**k * (1 - share) ** (repeats - k)
        if below > 1e-3:
            return k
    return repeats


@pytest.mark.parametrize("answer", SMOOTH)
def test_replicates_of_smooth_functions(answer, n=None, repeats=30):
    """Student's interval of 16 replicates, by chance in 95 % of all runs."""
    run, truth, usual = SMOOTH[answer]
    assert held([tuple(run(n or usual, seed)) for seed in range(repeats)], truth).min() >= fewest(
        repeats
    )


def rare(case: str, seed: int) -> tuple[float, float, float]:
    y, threshold, _ = BRANCHES[case]
    event = tb.rare_event(
        y, NORMALS, threshold, 512, method="importance", seed=seed, dtype=torch.float64
    )
    return event.probability, event.low, event.high


@pytest.mark.parametrize("case", BRANCHES)
def test_rare_events_of_several_branches(case, repeats=30):
    """All branches count, with the default number of starts."""
    runs = [rare(case, seed) for seed in range(repeats)]
    assert held(runs, BRANCHES[case][2]) >= fewest(repeats)


@pytest.mark.parametrize("case", FAILING)
@pytest.mark.parametrize(("method", "n"), [("importance", 1024), ("subset", 5000)])
def test_rare_events_with_failures(method, n, case, repeats=30):
    """Failed samples around the design point, far from it, and everywhere. With them as the event
    the interval holds the probability of both, by default from that of none to that of all.
    """
    fails, share, none = FAILING[case]
    run = partial(
        tb.rare_event, lambda t: (t[:, 0], fails(t).int()), NORMALS, 3.5, n, method=method,
        dtype=torch.float64,
    )  # fmt: skip
    runs, spans = [], 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # as of a share that comes from failed samples
        warnings.filterwarnings("ignore", ".*evaluations failed")
        for seed in range(repeats):
            event, span = run(seed=seed, failed_exceed=True), run(seed=seed)
            runs.append((event.probability, event.low, event.high))
            spans += span.low <= none and none + share <= span.high
    assert min(held(runs, none + share), spans) >= fewest(repeats)


@pytest.mark.long
@pytest.mark.parametrize("answer", [*SMOOTH, *BRANCHES, *FAILING])
def test_four_hundred_repeats(answer):
    if answer in BRANCHES:
        return test_rare_events_of_several_branches(answer, 400)
    if answer in FAILING:
        for method, n in (("importance", 1024), ("subset", 5000)):
            test_rare_events_with_failures(method, n, answer, 400)
        return None
    for n in (1024, 4096, 16384):
        test_replicates_of_smooth_functions(answer, n, 400)
