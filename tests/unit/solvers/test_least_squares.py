"""Search by least squares: starts whose derivatives cannot be found on the way."""

import pytest
import torch
from torch.testing import assert_close

from torchbeam.solvers.least_squares import AT_ONCE, CONVERGED, STUCK, search
from torchbeam.solvers.region import Region


class Turning:
    """r = (x, 5 - (x - 1)^2 / 10), whose squares fall by the second from x = 0 on; J is NaN between
    `low` and `high`.
    """

    def __init__(self, low, high):
        self.low, self.high, self.asked = low, high, 0

    def residuals(self, x, which):
        return torch.cat((x, 5 - (x - 1).square() / 10), -1)

    def linearised(self, x, which, r=None, rough=False):
        self.asked += len(x)
        J = torch.stack((torch.ones_like(x), (1 - x) / 5), 1)
        return self.residuals(x, which), torch.where(
            ((x > self.low) & (x < self.high))[..., None], torch.nan, J
        )

    def prior(self, x):
        return x.new_zeros(len(x)), torch.zeros_like(x), torch.zeros_like(x)


def found(problem, starts):
    x = torch.ones(starts, 1)
    every = torch.full((1,), torch.inf)
    region = Region(x, x[0], torch.zeros(1, dtype=torch.bool), -every, every, torch.zeros(1, 2))
    return search(problem, x, region, 50, 1e-6)


def test_old_derivatives_are_not_fresh():
    """From x = 1, where dr/dx = (1, 0), a step goes to x = 0; by those derivatives the squares
    cannot fall there, though they do. Where new ones are not finite no start counts as converged,
    and the search ends before its iterations do.
    """
    problem = Turning(-torch.inf, 0.5)
    end = found(problem, AT_ONCE)
    assert (end.status == STUCK).all() and torch.isfinite(end.J).all()
    assert problem.asked < 25 * AT_ONCE


@pytest.mark.parametrize("starts", [1, AT_ONCE])
def test_finite_derivatives(starts):
    """The root of the gradient, found by bisection: derivatives that are not finite elsewhere
    hinder none.
    """
    end = found(Turning(2.0, 3.0), starts)
    low, high = -5.0, 0.5
    for _ in range(60):
        x = (low + high) / 2
        low, high = (x, high) if x + (1 - x) / 5 * (5 - (x - 1) ** 2 / 10) < 0 else (low, x)
    assert (end.status == CONVERGED).all()
    assert_close(end.x, torch.full((starts, 1), low), rtol=1e-5, atol=0)
