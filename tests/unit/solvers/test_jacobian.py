"""Jacobians by differences: central, of one side, at bounds and where one side is not finite;
forward mode.
"""

import math

import torch
from torch.testing import assert_close

from torchbeam.solvers.jacobian import difference, forward

X = torch.tensor([[0.5, 2.0], [1.5, -1.0]])
SIZE = torch.full((2, 2), 1e-4)
EXACT = torch.stack(
    (
        torch.stack((2 * X[:, 0], X[:, 1].cos()), -1),
        torch.stack((X[:, 1], X[:, 0]), -1),
        torch.stack((X[:, 0] * 0, 2 * X[:, 1]), -1),
    ),
    -2,
)


def f(x):
    """(N, 3)"""
    return torch.stack((x[:, 0] ** 2 + x[:, 1].sin(), x[:, 0] * x[:, 1], x[:, 1] ** 2), -1)


def test_central_and_forward():
    for y, J in (difference(f, X, SIZE), forward(f, X)):
        assert_close(y, f(X), rtol=0, atol=0)
        assert_close(J, EXACT, rtol=0, atol=1e-8)


def test_what_is_known_is_not_asked_for():
    """p samples of one side, 2 p of both, and one more where the value is not known."""
    sizes = []

    def counted(x):
        sizes.append(len(x))
        return f(x)

    difference(counted, X, SIZE)
    difference(counted, X, SIZE, y=f(X))
    _, J = difference(counted, X, SIZE, y=f(X), central=False)
    assert sizes == [10, 8, 4]
    assert_close(J, EXACT, rtol=0, atol=2e-4)  # h/2 of the second derivative


def test_at_bounds_and_beside_what_is_not_finite():
    """Nothing is evaluated beyond a bound; where one side is not finite the other is taken."""
    largest = torch.tensor([[0.5, math.inf]]).expand(2, 2).clone()
    largest[1, 0] = 1.5

    def walled(x):
        assert (x[:, 0] <= 1.5).all()
        return torch.where((x[:, 1] > 2)[:, None], torch.nan, f(x))

    _, J = difference(walled, X[:1], SIZE[:1], torch.full((1, 2), -math.inf), largest[:1])
    assert_close(J, EXACT[:1], rtol=0, atol=5e-4)
    for central in (True, False):
        _, J = difference(
            walled, X[1:], SIZE[1:], torch.full((1, 2), -math.inf), largest[1:], central=central
        )
        assert_close(J, EXACT[1:], rtol=0, atol=5e-4)
