"""noise="blocks": deviations that hold where residuals are alike from reading to reading."""

import pytest
import torch

import torchbeam as tb
from tests.cases.line_fits import alike
from torchbeam.analysis.identification.prediction import quantiles
from torchbeam.math.distributions import student_quantile

READINGS = 200
T = torch.linspace(0, 1, READINGS)


def line(theta):
    return theta["a"][:, None] + theta["b"][:, None] * T


def fits(noise, repeats=60):
    start = {"a": 1.0, "b": 1.0}
    for seed in range(repeats):
        data = 1 + 2 * T + alike(seed, 0.9, READINGS)
        yield tb.identify(line, tb.Measurement(data, 0.05, T, noise=noise), start)


def test_intervals_hold_where_noise_remembers():
    """A line through noise of correlation 0.9 from reading to reading: 95 % intervals by blocks
    hold the truth in 88 % or more of 60 sets (three deviations of such a count below 95 % are
    86 %); as independent noise in less than 60 %.
    """
    shares = {}
    for noise in ("blocks", "white"):
        inside = torch.zeros(2)
        for fit in fits(noise):
            low, high = fit.interval_without_warning(0.95).unbind(-1)
            inside += (low <= torch.tensor([1.0, 2.0])) & (torch.tensor([1.0, 2.0]) <= high)
        shares[noise] = inside / 60
    assert (shares["blocks"] > 0.88).all(), shares
    assert (shares["white"] < 0.6).all(), shares


def test_of_independent_noise_they_are_nearly_those_without():
    random = torch.Generator().manual_seed(0)
    ratios = []
    for _ in range(15):
        data = 1 + 2 * T + 0.05 * torch.randn(READINGS, generator=random)
        white, blocks = (
            tb.identify(line, tb.Measurement(data, 0.05, T, noise=n), {"a": 1.0, "b": 1.0})
            for n in ("white", "blocks")
        )
        ratios.append(blocks.deviation / white.deviation)
    torch.testing.assert_close(torch.stack(ratios).mean(0), torch.ones(2), rtol=0.12, atol=0)


def test_poses_are_blocks_where_there_are_no_times():
    """Twelve poses, of which each has an error of its own that its nine readings share: the mean is
    known as by twelve readings.
    """
    random = torch.Generator().manual_seed(0)
    data = 1 + 0.1 * torch.randn(12, 1, generator=random).expand(12, 9)

    def mean(theta):
        return theta["a"][:, None, None].expand(-1, 12, 9)

    fit = tb.identify(mean, tb.Measurement(data, 0.1, noise="blocks"), {"a": 0.0})
    expected = data[:, 0].std() / 12**0.5
    torch.testing.assert_close(fit.deviation[0], expected)  # the jackknife of a mean is exact
    torch.testing.assert_close(fit.freedom[0], torch.tensor(11.0))


def test_a_band_has_the_freedom_of_its_own_reading():
    """Twelve poses of a, and one more number b that two of them have: a is known by twelve, b by
    two. What moves with a alone has the band of the nine degrees of its mean, a + b that of fewer;
    the fewest of all parameters made every band as wide.
    """
    random = torch.Generator().manual_seed(0)
    data = 1 + 0.1 * torch.randn(12, 1, generator=random)
    both = torch.zeros(12, 1)
    both[:2] = 1.0

    def readings(theta):
        return theta["a"][:, None, None] + theta["b"][:, None, None] * both

    fit = tb.identify(readings, tb.Measurement(data, 0.1, noise="blocks"), {"a": 0.0, "b": 0.0})
    assert fit.freedom[1] < 3 < 8 < fit.freedom[0]
    a, sum_ = (
        fit.predict(lambda theta: theta["a"][:, None]),
        fit.predict(lambda theta: (theta["a"] + theta["b"])[:, None]),
    )
    torch.testing.assert_close(
        (a.high - a.y) / a.deviation, student(fit.freedom[0].item()), rtol=1e-6, atol=0
    )
    assert ((sum_.high - sum_.y) / sum_.deviation > 4).all()


def student(freedom):
    return torch.tensor([student_quantile(0.975, freedom)])


def test_quantiles_of_many_degrees_are_those_of_each():
    freedom = 1 / torch.linspace(0, 1, 200)
    exact = torch.tensor([student_quantile(0.975, f) for f in freedom.tolist()])
    torch.testing.assert_close(quantiles(freedom, 0.95), exact, rtol=1e-4, atol=0)


def test_a_prior_counts_as_it_is():
    """A parameter that data do not tell keeps its prior's deviation."""
    prior = torch.distributions.Normal(1.0, 0.3)
    start = {"a": 1.0, "b": 1.0, "c": tb.Parameter(1.0, prior=prior)}
    model = lambda theta: line(theta) + 0 * theta["c"][:, None]  # noqa: E731
    fit = tb.identify(
        model, tb.Measurement(1 + 2 * T + alike(0, 0.9, READINGS), 0.05, T, noise="blocks"), start
    )
    torch.testing.assert_close(fit.deviation[2], torch.tensor(0.3))
    assert fit.freedom[2] > 1e6


def test_what_they_are_not_for_is_refused_and_residuals_may_be_alike():
    fit = next(fits("blocks"))
    assert not fit.doubts
    for method in ("profile", "bootstrap"):
        with pytest.raises(ValueError, match="blocks"):
            fit.interval(method=method)
    with pytest.raises(ValueError, match="6 times"):
        tb.Measurement(torch.zeros(5), 1.0, noise="blocks")
