"""Parameters that a bound holds: what is said of them and of the others."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import T
from torchbeam.math.distributions import student_quantile

X = torch.stack((torch.ones_like(T), T, T**2), -1)
DATA = X @ torch.tensor([1.0, -0.5, 0.2]) + 0.05 * torch.randn(
    40, generator=torch.Generator().manual_seed(5)
)


def line(theta):
    return theta @ X.T


@pytest.mark.parametrize("sigma", [0.05, None])
def test_a_bound_holds_a_parameter(sigma):
    """A parabola whose slope may not be as steep as the data say, -0.45: offset and curvature are
    those of a fit without it, its degree of freedom being the noise's; its interval goes to where
    the least chi^2 rises by z^2 (or t^2), a parabola in it. All by normal equations.
    """
    least, largest = torch.full((3,), -math.inf), torch.full((3,), math.inf)
    least[1] = -0.45
    fit = tb.identify(line, DATA, (1.0, 0.0, 0.0), bounds=(least, largest), sigma=sigma)
    assert fit.status == 0 and fit.held.tolist() == [False, True, False] and fit.theta[1] == -0.45
    free = X[:, [0, 2]]

    def squares(slope):
        left = DATA - slope * T
        return (left - free @ torch.linalg.lstsq(free, left).solution).square().sum()

    bottom = squares(fit.theta[1])
    variance = bottom / 38 if sigma is None else torch.tensor(sigma**2)
    assert_close(
        fit.covariance[[0, 2]][:, [0, 2]],
        variance * torch.linalg.inv(free.T @ free),
        rtol=1e-5,
        atol=0,
    )
    assert (fit.covariance[1] == 0).all() and fit.correlation[0, 1] == 0
    assert_close(fit.correlation.diagonal(), torch.ones(3))
    assert_close(
        fit.freedom, torch.full((3,), 38.0 if sigma is None else math.inf), rtol=1e-9, atol=0
    )
    t, near, far = student_quantile(0.975, fit.freedom[1].item()), -0.45, 1.0
    for _ in range(60):
        middle = (near + far) / 2
        near, far = (middle, far) if squares(middle) - bottom < t**2 * variance else (near, middle)
    assert_close(fit.interval()[1], torch.tensor([-0.45, near]), rtol=1e-4, atol=0)
    assert_close(fit.interval(method="profile")[1], torch.tensor([-0.45, near]), rtol=2e-3, atol=0)
    assert_close(fit.interval(method="profile")[[0, 2]], fit.interval()[[0, 2]], rtol=0, atol=0.3)
    assert (
        "theta[1] is at its bound, -0.45" in fit.message
        and "at its bound" in fit.summary().splitlines()[3]
    )


def test_repeats_at_a_bound():
    """The held parameter stays, and its interval is that of the covariance; the others' scatter as
    theirs says.
    """
    bounds = (torch.tensor([-9.0, -0.45, -9.0]), torch.full((3,), 9.0))
    fit = tb.identify(line, DATA, (1.0, 0.0, 0.0), bounds=bounds, sigma=0.05)
    found = fit.bootstrap(1000)
    assert (found.status == 0).all() and (found.theta[:, 1] == -0.45).all()
    assert_close(found.theta[:, [0, 2]].std(0), fit.deviation[[0, 2]], rtol=0.1, atol=0)
    interval = fit.interval(method="bootstrap", repeats=1000)
    assert_close(interval[1], fit.interval()[1])
    assert ((interval - fit.interval()).abs()[[0, 2]] < 0.3 * fit.deviation[[0, 2], None]).all()


def test_all_are_held():
    """Nothing is left to be uncertain; intervals begin at the bounds, by each method."""
    for sigma in (0.05, None):
        fit = tb.identify(
            lambda theta: theta[:, :1] * T, -T + 0.05 * DATA, (1.0,), bounds=(0.0, 2.0), sigma=sigma
        )
        assert fit.status == 0 and fit.held.all() and fit.covariance == 0
        for method in ("laplace", "profile", "bootstrap"):
            low, high = fit.interval(method=method)[0]
            assert low == 0 < high < 0.5


def test_a_profile_goes_to_the_bound():
    """The truth is at a bound, where half of all fits end and the rest are near: the interval
    reaches it unless the misfit rises by as much before (in 2.5 % of 200: at most 14, but for one
    run in a thousand).
    """
    times = torch.linspace(0, 1, 6, dtype=torch.float64)
    missed = 0
    for seed in range(200):
        draw = torch.Generator().manual_seed(seed)
        data = 1.0 + 0.1 * torch.randn(6, generator=draw, dtype=torch.float64)
        slope = tb.Parameter(times.new_tensor(0.3), bounds=(0.0, torch.inf), scale=0.3)
        fit = tb.identify(
            lambda p: 1.0 + p["b"][:, None] * times, data, {"b": slope}, sigma=0.1,
            derivatives="forward",
        )  # fmt: skip
        missed += fit.interval_without_warning(0.95, "profile")[0, 0].item() > 0.0
    assert missed <= 14
