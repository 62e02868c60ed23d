"""Laws: quantiles and distribution functions undo each other, moments are the closed ones, scores
reach into the tails.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.uncertainty.given_law import of_uniform
from torchbeam.uncertainty.law_scores import of_score

U = (torch.arange(20000) + 0.5) / 20000
WEIBULL = math.gamma(1.5)
# fmt: off
TABLE = {  # law: mean, deviation
    "uniform": (tb.laws.Uniform(1.0, 4.0), 2.5, 3 / 12**0.5),
    "normal": (tb.laws.Normal(2.0, 0.3), 2.0, 0.3),
    "lognormal": (tb.laws.LogNormal(2.0, 0.5), 2.0, 0.5),
    "triangular": (tb.laws.Triangular(0.0, 1.0, 4.0), 5 / 3,
                   ((0 + 1 + 16 - 0 - 0 - 4) / 18) ** 0.5),
    "weibull": (tb.laws.Weibull(2.0, 2.0), 2 * WEIBULL, 2 * math.sqrt(1 - WEIBULL**2)),
    "exponential": (tb.laws.Weibull(3.0), 3.0, 3.0),
    "gumbel": (tb.laws.Gumbel(1.0, 0.5), 1 + 0.5 * 0.5772156649, 0.5 * math.pi / 6**0.5),
    "half normal": (tb.laws.Truncated(tb.laws.Normal(0.0, 1.0), least=0.0), math.sqrt(2 / math.pi),
                    math.sqrt(1 - 2 / math.pi)),
}
# fmt: on


@pytest.mark.parametrize("name", TABLE)
def test_moments(name):
    """Mean and deviation over 20,000 equal probabilities: good to 2e-3, the tails' share beyond the
    last of them.
    """
    law, mean, deviation = TABLE[name]
    x = law.icdf(U)
    assert_close(x.mean(), torch.tensor(mean), rtol=5e-4, atol=0)
    assert_close(x.std(), torch.tensor(deviation), rtol=2e-3, atol=0)
    assert_close(law.cdf(x), U, rtol=0, atol=1e-9)


def test_truncated():
    """What is left of a normal law between -1 and 2 of its deviations, torch's or ours; a pair;
    within another's support.
    """
    ours = tb.laws.Truncated(tb.laws.Normal(5.0, 2.0), 3.0, 9.0)
    torchs = tb.laws.Truncated(torch.distributions.Normal(5.0, 2.0), 3.0, 9.0)
    x = ours.icdf(U)
    assert x.min() >= 3 and x.max() <= 9
    assert_close(torchs.icdf(U), x, rtol=1e-6, atol=0)
    phi = [math.exp(-z * z / 2) / math.sqrt(2 * math.pi) for z in (-1.0, 2.0)]
    mass = 0.5 * (math.erf(2 / 2**0.5) + math.erf(1 / 2**0.5))
    assert_close(x.mean(), torch.tensor(5 + 2 * (phi[0] - phi[1]) / mass), rtol=1e-6, atol=0)
    assert_close(tb.laws.Truncated((0.0, 4.0), 1.0, 2.0).icdf(U), 1 + U)
    assert tb.laws.Truncated(torch.distributions.LogNormal(0.0, 1.0), -1.0, 1.0).icdf(U).max() <= 1


def test_empirical():
    """Each value as often as its weight says."""
    law = tb.laws.Empirical([3.0, 1.0, 2.0], weights=[1, 2, 1])
    values, counts = law.icdf(U).unique(return_counts=True)
    assert values.tolist() == [1.0, 2.0, 3.0] and counts.tolist() == [10000, 5000, 5000]
    assert law.cdf(torch.tensor([0.5, 1.0, 2.5, 3.0])).tolist() == [0.0, 0.5, 0.75, 1.0]
    assert "3 values from 1 to 3" in repr(law)
    ends = tb.laws.Truncated(law, 2.0, 3.0)  # both ends are within
    assert ends.icdf(U).unique(return_counts=True)[1].tolist() == [10000, 10000]
    assert ends.cdf(torch.tensor([1.0, 2.0, 3.0])).tolist() == [0.0, 0.5, 1.0]


def test_scores():
    """A law of a normal score is the law of its probability; normal and lognormal laws go on where
    probabilities are 1.
    """
    z = torch.linspace(-5, 5, 11)
    for law, _, _ in TABLE.values():
        assert_close(of_score(law, z), of_uniform(law, torch.special.ndtr(z)), rtol=1e-8, atol=1e-8)
    far = torch.tensor([12.0])
    for law in (tb.laws.Normal(2.0, 0.3), torch.distributions.Normal(2.0, 0.3)):
        assert_close(of_score(law, far), torch.tensor([5.6]), rtol=1e-6, atol=0)
    assert torch.isfinite(
        of_score(torch.distributions.Laplace(0.0, 1.0), torch.tensor([-12.0, 12.0]))
    ).all()


def tail(z):
    return math.erfc(z / 2**0.5) / 2


def test_far_tails():
    """12 deviations out, where a probability is 1 but for rounding: by hand, from
    P(X > x) = Phi(-12). So for torch's laws, and on the lower side. A truncated law has the tail of
    its own law, or of the range that is left of it.
    """
    z, q = torch.tensor([12.0]), tail(12)
    wanted = {
        tb.laws.Uniform(-2.0, 0.0): -2 * q,
        tb.laws.Triangular(-4.0, -1.0, 0.0): -((4 * q) ** 0.5),
        tb.laws.Weibull(2.0, 2.0): 2 * (-math.log(q)) ** 0.5,
        tb.laws.Gumbel(1.0, 0.5): 1 - 0.5 * math.log(-math.log1p(-q)),
        torch.distributions.Weibull(2.0, 2.0): 2 * (-math.log(q)) ** 0.5,
        torch.distributions.Exponential(0.5): -2 * math.log(q),
        torch.distributions.LogNormal(1.0, 0.5): math.exp(1 + 6),
        tb.laws.Truncated(tb.laws.Weibull(1.0), 3.0): 3 - math.log(q),
    }
    for law, x in wanted.items():
        assert of_score(law, z).item() == pytest.approx(x, rel=1e-12), law
        if hasattr(law, "score"):
            assert_close(law.score(of_score(law, z)), z, rtol=1e-12, atol=0)
    assert of_score((-2.0, 0.0), z).item() == pytest.approx(-2 * q, rel=1e-12)
    assert tb.laws.Weibull(2.0, 2.0).of_score(-z).item() == pytest.approx(2 * q**0.5, rel=1e-12)
    far = tb.laws.Truncated(tb.laws.Normal(0.0, 1.0), 9.0, 10.0)  # of a probability of 1e-19
    x = far.icdf(U)
    shares = [(tail(9) - tail(v)) / (tail(9) - tail(10)) for v in x[::4000].tolist()]
    assert shares == pytest.approx(U[::4000].tolist(), rel=1e-9) and x.min() >= 9 and x.max() <= 10
    assert_close(far.cdf(x), U, rtol=1e-9, atol=0)


def test_slopes_at_the_ends():
    """Of a law whose mode is an end, and 20 deviations out: finite, and those of differences where
    these tell them.
    """
    for law in (
        tb.laws.Triangular(0.0, 0.0, 1.0),
        tb.laws.Triangular(0.0, 1.0, 1.0),
        tb.laws.Truncated((0.0, 1.0), 0.2),
        tb.laws.Gumbel(0.0, 1.0),
        tb.laws.Weibull(1.0, 2.0),
    ):
        z = torch.tensor([-20.0, -1.0, 0.5, 1.0, 20.0], requires_grad=True)
        (slope,) = torch.autograd.grad(of_score(law, z).sum(), z)
        h, at = 1e-5, z.detach()[1:4]
        assert torch.isfinite(slope).all(), law
        assert_close(
            slope[1:4], (of_score(law, at + h) - of_score(law, at - h)) / (2 * h), rtol=1e-7, atol=0
        )


# fmt: off
REFUSED = {
    "of several numbers": (lambda: tb.laws.Truncated(torch.distributions.Normal(torch.zeros(3),
        torch.ones(3)), 0.0),
                           r"was given to Truncated, which has \(3,\) numbers, not one"),
    "truncated without quantiles": (lambda: tb.laws.Truncated(torch.distributions.Beta(1.0, 2.0),
                                                              0.0), "has no quantiles"),
    "beyond what a law tells": (lambda: tb.laws.Truncated(torch.distributions.Laplace(0.0, 1.0),
                                                          30.0), "a wider range"),
    "a marginal": (lambda: tb.laws.RandomField([0.0, 1.0], 1.0, 0.1, 1.0, marginal=torch.ones(2)),
                   "'lognormal', 'normal' are"),
    "constant": (lambda: tb.laws.Constant(math.nan), "Constant's value = nan was given"),
    "uniform": (lambda: tb.laws.Uniform(1.0, 1.0),
                "Uniform from 1 to 1 was given; least below largest"),
    "normal": (lambda: tb.laws.Normal(1.0, 0.0), "Normal's deviation = 0 was given; a positive"),
    "lognormal": (lambda: tb.laws.LogNormal(-1.0, 1.0), "LogNormal's mean = -1 was given"),
    "triangular": (lambda: tb.laws.Triangular(0.0, 2.0, 1.0),
                   "Triangular's mode = 2 was given for 0 to 1"),
    "text": (lambda: tb.laws.Normal("a", 1.0), "was given"),
    "truncated function": (lambda: tb.laws.Truncated(torch.exp, 0.0),
                           "was given to Truncated; one with both cdf and icdf"),
    "truncated to nothing": (lambda: tb.laws.Truncated(tb.laws.Normal(0.0, 1.0), 50.0),
                             "lies with the probability 0"),
    "upside down": (lambda: tb.laws.Truncated(tb.laws.Normal(0.0, 1.0), 1.0, 0.0),
                    "least below largest is wanted"),
    "no values": (lambda: tb.laws.Empirical([]), r"\[\] was given; numbers"),
    "weights": (lambda: tb.laws.Empirical([1.0, 2.0], [1.0, -1.0]), "positive weights"),
}
# fmt: on


@refusals(REFUSED)
def test_refused(make):
    make()
