"""Elimination of a line of nodes: the derivative of its solution by what is asked of it."""

import pytest
import torch
from torch.testing import assert_close

from torchbeam.topology.elimination import FrameworkSolve, solve
from torchbeam.topology.framework import Framework

NONE = (None,) * 2  # ties and multipliers
ROUNDING = dict(rtol=0, atol=1e-12)


@pytest.fixture
def line():
    """Where it is cut, D, U and L of a matrix that is diagonally dominant, and right-hand sides."""
    torch.manual_seed(0)
    n, k, batch = 5, 3, (4,)
    D = torch.randn(*batch, n, k, k) + 3 * torch.eye(k)
    U, L = torch.randn(2, *batch, n - 1, k, k)
    return Framework(1, (n - 1,)).cut, (D, U, L, *NONE), torch.randn(*batch, n, k)


def test_differentiable_in_the_right_hand_side(line):
    """Reverse (the transposed system) and forward mode against central differences; the matrix
    carries no gradient.
    """
    how, parts, b = line
    assert torch.autograd.gradcheck(
        lambda b: FrameworkSolve.apply(how, b, *parts), b.requires_grad_(), check_forward_ad=True
    )


def test_under_jvp_and_a_shared_right_hand_side(line):
    """torch.func.jvp is the solve of the tangent; the gradient of a broadcast right-hand side is
    summed back.
    """
    how, parts, b = line
    _, tangent = torch.func.jvp(lambda b: FrameworkSolve.apply(how, b, *parts), (b,), (b.flip(0),))
    assert_close(tangent, solve(how, b.flip(0), *parts), **ROUNDING)
    one = b[0].clone().requires_grad_()
    FrameworkSolve.apply(how, one, *parts).sum().backward()
    D, U, L, *_ = parts
    each = solve(how, torch.ones_like(b), D.mT, L.mT, U.mT, *NONE).sum(0)
    assert_close(one.grad, each, **ROUNDING)


def test_second_derivatives_are_refused(line):
    how, parts, b = line
    b.requires_grad_()
    (gradient,) = torch.autograd.grad(
        FrameworkSolve.apply(how, b, *parts).square().sum(), b, create_graph=True
    )
    with pytest.raises(RuntimeError, match="first ones only"):
        gradient.sum().backward()
