"""Rare events: closed forms at 1e-6, two regions, curvature, failures; brute force at 1e-4 as a
long run.
"""

import functools
import math
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.math.distributions import binomial_interval, normal_probability
from torchbeam.uncertainty.design_point import design_points, random_starts
from torchbeam.uncertainty.evaluation import Evaluation
from torchbeam.uncertainty.importance_sampling import importance_sampling
from torchbeam.uncertainty.joint_law import JointLaw
from torchbeam.uncertainty.limit_state import LimitState

NORMALS = {name: tb.laws.Normal(0.0, 1.0) for name in "abcd"}
BETA = 4.753424  # Phi(-BETA) = 1e-6


def linear(theta):
    return theta.sum(-1) / 2


def tail(beta):
    return 0.5 * math.erfc(beta / 2**0.5)


def test_subset_simulation():
    """A linear limit state at 1e-6: within a factor of 1.5 (two standard errors of some 20 %), the
    truth in the interval.
    """
    found = tb.rare_event(linear, NORMALS, BETA, 5000, seed=1)
    assert (
        found.low < 1e-6 < found.high
        and 1 / 1.5 < found.probability / 1e-6 < 1.5
        and found.high / found.low < 3
    )
    assert (
        len(found.thresholds) in (5, 6)
        and (found.thresholds.diff() > 0).all()
        and "subset" in repr(found)
    )
    assert 25_000 < found.evaluations < 35_000 and found.failed == 0
    again = tb.rare_event(linear, NORMALS, BETA, 5000, seed=1, chunk=333)
    assert again.probability == found.probability
    assert tb.rare_event(linear, NORMALS, -1.0, 5000).probability == pytest.approx(
        tail(-1.0), rel=0.03
    )


def test_importance_sampling():
    """The same: FORM is exact, the estimate within 20 % of it; a function without gradients, an
    executor.
    """
    found = tb.rare_event(linear, NORMALS, BETA, 1024, method="importance")
    assert found.form == pytest.approx(1e-6, rel=1e-3) and found.low < 1e-6 < found.high
    assert found.probability == pytest.approx(1e-6, rel=0.2) and len(found.points) == 1
    assert found.points[0].tolist() == pytest.approx([BETA / 2] * 4, abs=1e-3)
    with ThreadPoolExecutor(2) as pool:
        other = tb.rare_event(
            lambda theta: linear(theta).detach(), NORMALS, BETA, 1024, method="importance",
            executor=pool, chunk=100,
        )  # fmt: skip
    assert (
        other.probability == pytest.approx(found.probability, rel=1e-5)
        and other.evaluations > found.evaluations
    )
    # a gradient by something else does not count
    weights = torch.full((4,), 0.5, requires_grad=True)
    again = tb.rare_event(
        lambda theta: theta.detach() @ weights, NORMALS, BETA, 1024, method="importance"
    )
    assert (
        again.probability == pytest.approx(other.probability, rel=1e-5)
        and again.evaluations == other.evaluations
    )


@pytest.mark.parametrize("where", ["law", "function"])
def test_gradients_that_are_not_all_there(where):
    """A law, or a function, that computes with NumPy carries no gradient by some parameters, while
    y carries one by others: the design point is found by differences. Normal laws, so that FORM is
    exact; of the law by a table to its 1e-3.
    """
    place = torch.linspace(-7.0, 7.0, 4001)
    shares = normal_probability(place).numpy()
    law = lambda u: torch.from_numpy(np.interp(u.detach().numpy(), shares, place.numpy()))  # noqa: E731
    laws = {"a": NORMALS["a"], "b": law if where == "law" else NORMALS["b"]}

    def y(theta):
        b = theta[:, 1]
        b = torch.from_numpy(b.detach().numpy()) if where == "function" else b
        return (theta[:, 0] + 3 * b) / 10**0.5

    found = tb.rare_event(y, laws, 4.0, 512, method="importance")
    assert found.form == pytest.approx(tail(4.0), rel=0.02)
    assert found.low < tail(4.0) < found.high
    assert found.points[0].tolist() == pytest.approx([4 * 0.1**0.5, 12 * 0.1**0.5], abs=0.01)


def test_beyond_all_numbers():
    """An event whose probability is below the least number: 0, not NaN."""
    found = tb.rare_event(lambda theta: theta[:, 0], NORMALS, 40.0, 64, method="importance")
    assert (found.probability, found.low, found.high) == (0.0, 0.0, 1.0)


def test_strength_less_load():
    """Lognormal strength over lognormal load, correlated: P(S/R > 1) = Phi(-beta) in closed form,
    beta from the logarithms.
    """
    laws = {"R": tb.laws.LogNormal(5.0, 0.8), "S": tb.laws.LogNormal(1.5, 0.45)}
    R, S, rho = laws["R"], laws["S"], 0.3
    beta = (R.mu - S.mu) / math.sqrt(R.sigma**2 + S.sigma**2 - 2 * rho * R.sigma * S.sigma)
    found = tb.rare_event(
        lambda R, S: S / R, laws, 1.0, 2048, method="importance", correlation={("R", "S"): rho},
        by_name=True,
    )  # fmt: skip
    assert found.form == pytest.approx(tail(beta), rel=1e-3) and found.low < tail(beta) < found.high
    assert found.probability == pytest.approx(tail(beta), rel=0.1) and 3 < found.beta[0] < 5
    assert found.points[0, 0] == pytest.approx(found.points[0, 1].item(), rel=1e-4)


def test_random_starts_are_pairs():
    """The medians, and two by two opposite ones, every other pair far out."""
    z = random_starts(9, 3, 0)
    assert not z[0].any() and torch.equal(z[1::2], -z[2::2]) and len(random_starts(4, 3, 0)) == 4
    assert_close(z[[3, 4, 7, 8]].norm(dim=-1), torch.full((4,), 5.0, dtype=z.dtype))


def test_hits_that_no_design_point_is_near_to():
    """A second region: samples that are likelier by the laws than around the point of the first
    lead to its design point, where a gradient leads there; where none does (a step), they are told.
    """
    wall = tb.laws.Normal(0.0, 1.0)
    laws = {"a": wall, "b": wall}

    def y(theta, slope):
        a, b = theta.unbind(-1)
        return torch.where(b > 2.0, 3.6 + slope * (b - 2.0), a)

    both = 1 - (1 - tail(3.5)) * (1 - tail(2.0))
    work = Evaluation(lambda theta: y(theta, 1.0), JointLaw.of(laws), None, torch.float64, 1024)
    limit = LimitState(work, 3.5)
    first = design_points(limit, torch.zeros(1, 2, dtype=torch.float64))
    estimates = importance_sampling(limit, first, 512, 16, 0)
    assert first.z.shape == (1, 2) and len(estimates.beyond) and estimates.share > 0.5
    with pytest.warns(RuntimeWarning, match=r"\d+ % of the probability come from \d+ samples that"):
        rare = tb.rare_event(lambda theta: y(theta, 0.0), laws, 3.5, 512, method="importance")
    assert rare.low < both < rare.high


def test_two_regions():
    """y = |a|: both design points are found, the probability is that of both; by runs as well."""
    for method, n in (("importance", 1024), ("subset", 10000)):
        found = tb.rare_event(lambda theta: theta[:, 0].abs(), NORMALS, 4.0, n, method=method)
        assert found.low < 2 * tail(4.0) < found.high, method
        assert found.points is None or found.points[:, 0].abs().tolist() == pytest.approx(
            [4.0, 4.0], rel=1e-4
        )


@pytest.mark.filterwarnings("ignore:10 runs of")
def test_likely_events():
    """All samples hit: an interval to one side, Clopper and Pearson's. More likely than not: the
    rest is what is sampled, to 10 % of itself. Never reached in thirty levels: a bound.
    """
    sure = tb.rare_event(linear, NORMALS, -100.0, 500)
    assert (sure.probability, sure.high) == (1.0, 1.0) and sure.low == pytest.approx(
        0.025 ** (1 / 500)
    )
    likely = tb.rare_event(linear, NORMALS, -4.0, 1024, method="importance")
    assert (
        1 - likely.probability == pytest.approx(tail(4.0), rel=0.1)
        and likely.low < 1 - tail(4.0) < likely.high < 1
    )
    usual = tb.rare_event(linear, NORMALS, -1.0, 2000, seed=1)
    hits = round(usual.probability * 2000)
    assert usual.low < tail(-1.0) < usual.high and (usual.low, usual.high) == binomial_interval(
        hits, 2000, 0.95
    )
    never = tb.rare_event(linear, NORMALS, 1e3, 500)
    assert (never.probability, never.low) == (0, 0) and 1e-30 < never.high < 1e-28


def test_far_tails():
    """P(X > x) = exp(-x^2) of a Weibull law, at 1e-20, beyond what a probability tells; torch's as
    well. Linear at 1e-198: the interval has a width. A law that is a function of u tells its lower
    tail, and says that it has no upper one.
    """
    x = math.sqrt(20 * math.log(10))
    for law in (tb.laws.Weibull(1.0, 2.0), torch.distributions.Weibull(1.0, 2.0)):
        found = tb.rare_event(lambda theta: theta[:, 0], {"x": law}, x, 256, method="importance")
        assert found.form == pytest.approx(1e-20, rel=1e-3) and found.low < 1e-20 < found.high
        assert found.probability == pytest.approx(1e-20, rel=0.15)
    far = tb.rare_event(linear, NORMALS, 30.0, 256, method="importance")
    assert far.form == pytest.approx(tail(30.0), rel=1e-2) and far.low < 0.99 * far.high
    assert far.low < tail(30.0) < far.high
    down = tb.rare_event(
        lambda theta: -theta[:, 0], {"x": torch.log}, 46.0517, 256, method="importance"
    )
    assert down.probability == pytest.approx(1e-20, rel=0.15)
    with pytest.raises(
        ValueError, match=r"\(the law of 'x' does not tell values more than 7 deviations up apart\)"
    ):
        tb.rare_event(
            lambda theta: theta[:, 0], {"x": torch.special.ndtri}, 9.0, 256, method="importance"
        )


def test_curved():
    """y = |z|^2 of four scores: chi^2, P(> x) = exp(-x/2)(1 + x/2): subset simulation knows no
    direction.
    """
    x = 30.0
    wanted = math.exp(-x / 2) * (1 + x / 2)
    found = tb.rare_event(lambda theta: theta.square().sum(-1), NORMALS, x, 10000, seed=2)
    assert found.low < wanted < found.high and found.high / found.low < 2.5


def cut(theta):
    """The first score, which fails beyond 3.5."""
    a = theta[:, 0]
    return torch.where(a > 3.5, torch.nan, a)


@pytest.mark.parametrize(("method", "n"), [("subset", 5000), ("importance", 512)])
def test_failures_within_the_event(method, n):
    """P(a > 3) where the code fails beyond 3.5: whether that is the event or not, the interval
    holds the truth, and a warning has both. The user decides: each by itself. All beyond 3.5 fails:
    no bound of 1e-29, nor a threshold that is not reached.
    """
    run = functools.partial(tb.rare_event, cut, {"a": NORMALS["a"]}, n=n, method=method, seed=1)
    with pytest.warns(RuntimeWarning, match=r"evaluations failed .* is \S+ if none .* \S+ if all"):
        both = run(threshold=3.0)
    # none of n plain samples fails elsewhere, which these do not know any better
    elsewhere = binomial_interval(0, n, 0.95)[1] if method == "importance" else 0.0
    assert both.low < tail(3.0) - tail(3.5)
    assert tail(3.0) < both.high < 2 * tail(3.0) + elsewhere
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unsafe, safe = (run(threshold=3.0, failed_exceed=exceed) for exceed in (True, False))
    assert unsafe.low < tail(3.0) < unsafe.high and unsafe.failed
    assert safe.low < tail(3.0) - tail(3.5) < safe.high
    assert (both.low, both.high) == (safe.low, max(unsafe.high, safe.high))
    assert both.probability == safe.probability
    if method == "subset":
        assert both.evaluations == safe.evaluations + unsafe.evaluations
        with pytest.warns(RuntimeWarning, match="is 0 if none of these is the event, and 0.000"):
            beyond = run(threshold=3.6)
        assert beyond.probability == beyond.low == 0 and tail(3.5) < beyond.high < 1e-3


def test_failures_that_a_search_does_not_see():
    """P(a > 3.5) in 200 dimensions, where another score below -2.5 fails, to which neither a start
    nor a gradient leads: with failures as no event none is added, and 6.2e-3 is with them as one.
    Without failures plain samples change nothing.
    """
    laws = {f"z{k}": NORMALS["a"] for k in range(200)}
    run = functools.partial(tb.rare_event, laws=laws, n=1024, method="importance", threshold=3.5)
    fails = lambda theta: (theta[:, 0], (theta[:, 1] < -2.5).int())  # noqa: E731
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unsafe, safe = (run(fails, failed_exceed=exceed) for exceed in (True, False))
        good, plain = (run(lambda theta: theta[:, 0], failed_exceed=e) for e in (True, None))
    assert unsafe.low < tail(2.5) + tail(3.5) < unsafe.high < 0.02
    assert safe.low < tail(3.5) * (1 - tail(2.5)) < safe.high < 1.2 * safe.low
    assert (good.low, good.high) == (plain.low, plain.high)
    assert good.evaluations == plain.evaluations + 1024


def test_warnings_of_a_search_are_not_told():
    """Starts lie 5 deviations out, where this function warns: none of it enters the answer. What
    samples around the design point warn of is told, also where a start was the first to be refused.
    """

    def y(theta, side):
        if (side * theta[:, 0] > 2.9).any():
            warnings.warn("bends far", UserWarning, stacklevel=1)
        return theta[:, 0]

    run = functools.partial(tb.rare_event, laws={"a": NORMALS["a"]}, n=64, method="importance")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(lambda theta: y(theta, -1), threshold=3.0)
    with pytest.warns(UserWarning, match="bends far"):
        run(lambda theta: y(theta, 1), threshold=3.0)

    def refuses(theta):
        if (theta[:, 0] > 3.5).any():
            raise ValueError("a > 3.5 was given")
        return theta[:, 0]

    with pytest.warns(RuntimeWarning, match="as the function refused it"):
        run(refuses, threshold=3.0, failed_exceed=False)


def test_failures_where_the_event_is_usual():
    """P(a > -3) where a > 3.5 fails, by the rest: 1 - Phi(-3) less what fails, or not."""
    with pytest.warns(RuntimeWarning, match="evaluations failed"):
        event = tb.rare_event(cut, {"a": NORMALS["a"]}, -3.0, 4096, method="importance")
    assert event.low < 1 - tail(3.0) < event.high


def test_few_samples_in_a_run():
    """With 100 samples a run the estimate is too large, as the docstring says; so does the run.
    An event of the first level has no such bias.
    """
    with pytest.warns(RuntimeWarning, match="10 runs of 100 samples a level were asked"):
        tb.rare_event(linear, NORMALS, BETA, 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.rare_event(linear, NORMALS, -1.0, 1000)
        tb.rare_event(linear, NORMALS, 3.0, 1000, replicates=2)


@pytest.mark.parametrize("share", [0.9, 0.99])
def test_a_y_that_saturates(share):
    """tanh of a lognormal load, whose slope far out is next to none: Newton's steps stay among
    numbers that the law has. FORM is exact.
    """
    law = tb.laws.LogNormal(5.0, 5.0)
    found = tb.rare_event(
        lambda P: torch.tanh(P / 500), {"P": law}, share, 256, method="importance", by_name=True
    )
    beta = (math.log(500 * math.atanh(share)) - law.mu) / law.sigma
    assert found.form == pytest.approx(tail(beta), rel=1e-2) and found.low < tail(beta) < found.high


def test_failed_samples():
    """They are counted; those that are known not to be the event are none."""
    found = tb.rare_event(
        lambda theta: torch.where(theta[:, 1] > 0, torch.nan, theta[:, 0]), NORMALS, 3.0, 10000,
        seed=1, failed_exceed=False,
    )  # fmt: skip
    assert found.low < tail(3.0) / 2 < found.high and found.failed > 0.2 * found.evaluations
    assert list(found.reasons) == ["y is not finite"], found
    work = Evaluation(
        lambda theta: 1 / theta[:, 0].clamp_min(0), JointLaw.of(NORMALS), None, torch.float64, 8
    )
    starts = LimitState(work, 1.0)
    value, slope = starts.gradient(torch.tensor([[1.0, 0, 0, 0], [-1.0, 0, 0, 0]]))
    # the starts, and two beside each, by which the gradient is looked at once
    assert starts.evaluations == 6 and starts.failures == {"y is not finite": 3}
    assert value.tolist() == [1.0, -math.inf] and slope[0].tolist() == [-1.0, 0, 0, 0]


def test_beam():
    """A strip's tip under a small load is linear in P/EI, both lognormal: beta in closed form, the
    factor by one evaluation.
    """

    def deflection(EI, P):
        section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=1.0, EI=EI, mass=1.0)
        load = tb.TipLoad(force=torch.stack((0 * P, 0 * P, 1e-4 * P), -1))
        state = tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 2, section), [load], plane="xz"), throw=False
        )
        return state.tip.position[:, 2], state.status

    one = deflection(torch.ones(1), torch.ones(1))[0].item()
    EI, P = tb.laws.LogNormal(1.0, 0.1), tb.laws.LogNormal(1.0, 0.2)
    beta = (math.log(2.5) + EI.mu - P.mu) / math.sqrt(EI.sigma**2 + P.sigma**2)
    found = tb.rare_event(
        deflection, {"EI": EI, "P": P}, 2.5 * one, 2048, method="importance", by_name=True
    )
    assert found.form == pytest.approx(tail(beta), rel=1e-3) and found.low < tail(beta) < found.high


@pytest.mark.long
@pytest.mark.parametrize("method", ["subset", "importance"])
def test_brute_force(method):
    """1e-4 by 4 million plain samples, of a function with two curved regions: the intervals of both
    meet.
    """
    laws = {"a": tb.laws.Gumbel(0.0, 1.0), "b": tb.laws.LogNormal(1.0, 0.5), "c": (-1.0, 1.0)}

    def function(theta):
        a, b, c = theta.unbind(-1)
        return torch.maximum(a * b - 2 * c, 3 * b + 4 * c.square())

    plain = tb.monte_carlo(function, laws, 2**22, design="plain", chunk=2**18).exceedance(
        19.0, 0.99
    )
    found = tb.rare_event(function, laws, 19.0, 20_000, method=method, starts=8, interval=0.99)
    assert 3e-5 < plain.estimate < 1e-3
    assert found.low < plain.high and plain.low < found.high


@pytest.mark.filterwarnings("ignore:10 runs of")
def test_equal_values():
    """y = max(a - c, 0) at 1e-4: for c = 0 a tenth has y > 0, and all is as without; for c = 2 it
    begins among equal y, and the product of tenths would be 2e-7.
    """
    beta = 3.719016
    plain, cut = (
        tb.rare_event(lambda theta, c=c: theta[:, 0].clamp_min(c), NORMALS, beta, 1000, seed=1)
        for c in (-math.inf, 0.0)
    )
    assert cut.probability == plain.probability and plain.low < tail(beta) < plain.high
    with pytest.raises(
        ValueError, match=r"a y that is 0 at \d+ of 100 samples of a level was given"
    ):
        tb.rare_event(lambda theta: (theta[:, 0] - 2).clamp_min(0), NORMALS, beta - 2, 1000)
    with pytest.raises(ValueError, match="that varies all the way to the threshold is wanted"):
        tb.rare_event(lambda theta: theta[:, 0].clamp_max(1.0), NORMALS, 2.0, 1000)


# fmt: off
REFUSED = {
    "few samples": (dict(n=100),
                    "n = 100 was given for 10 runs of subset simulation; at least 500"),
    "few for importance": (dict(n=20, method="importance"), "at least 32 are wanted"),
    "method": (dict(method="line"), "'subset', 'importance' are there"),
    "several numbers": (dict(function=lambda theta: theta),
                        r"gave y \(1000, 4\) was given for a rare event"),
    "all failed": (dict(function=lambda theta: theta[:, 0] / 0),
                   "more than nine tenths of the samples"),
    "no way there": (dict(function=lambda theta: theta[:, 0].sin(), method="importance"),
                     "no design point was found"),
    "steps": (dict(laws={**NORMALS, "b": tb.laws.Empirical((0.0, 1.0, 3.0))}, method="importance"),
              "the law of 'b', whose values are steps, was given"),
    "constants": (dict(laws={"a": tb.laws.Constant(1.0)}), "laws that are all constant"),
    "failed": (dict(failed_exceed="yes"), "failed_exceed = 'yes' was given"),
    "threshold": (dict(threshold=math.nan), "threshold = nan was given"),
}
# fmt: on


@refusals(REFUSED)
def test_refused(changed):
    tb.rare_event(**{**dict(function=linear, laws=NORMALS, threshold=4.0, n=1000), **changed})
