"""Least squares of numbers that are not negative."""

import torch

from torchbeam.math.nonnegative import nonnegative_least_squares as solve


def test_conditions_of_the_minimum():
    """Kuhn and Tucker's, of random problems: x >= 0, the slope of |A x - b|^2 / 2 is zero where x
    is positive and not negative where it is zero, to rounding.
    """
    for seed in range(20):
        g = torch.Generator().manual_seed(seed)
        A, b = torch.randn(30, 8, generator=g), torch.randn(30, generator=g)
        x = solve(A, b)
        slope = A.mT @ (A @ x - b)
        assert (x >= 0).all() and (x == 0).any() and (x > 0).any()
        assert slope[x > 0].abs().max() < 1e-12 and (slope[x == 0] > 0).all()


def test_what_is_positive_by_itself_is_plain_least_squares():
    A = torch.randn(20, 4, generator=torch.Generator().manual_seed(0))
    x = torch.tensor([0.1, 2.0, 0.3, 1.0])
    assert (solve(A, A @ x) - x).abs().max() < 1e-13
    assert torch.autograd.gradcheck(lambda b: solve(A, b), (A @ x).requires_grad_())
