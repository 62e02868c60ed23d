"""The block tridiagonal solve: against the dense one, its derivatives, and a singular sample among
good ones.
"""

import pytest
import torch
from torch.testing import assert_close

from torchbeam.math.block_tridiagonal import (
    backward,
    finite_pivots,
    forward,
    pivots,
    positive_definite,
)

# numbers near one, times a condition of 16 to 101; measured 4e-14
ROUNDING = dict(rtol=0, atol=1e-12)


def system(n=5, k=3, batch=(4,)):
    torch.manual_seed(0)
    D = torch.randn(*batch, n, k, k) + 3 * torch.eye(k)  # diagonally dominant on the whole
    L, U = torch.randn(2, *batch, n - 1, k, k)
    return D, L, U, torch.randn(*batch, n, k)


def dense(D, L, U):
    n, k = D.shape[-3:-1]
    A = torch.zeros(*D.shape[:-3], n, k, n, k)
    for i in range(n):
        A[..., i, :, i, :] = D[..., i, :, :]
        if i < n - 1:
            A[..., i + 1, :, i, :], A[..., i, :, i + 1, :] = L[..., i, :, :], U[..., i, :, :]
    return A.flatten(-4, -3).flatten(-2)


def solved(D, L, U, b):
    rows = torch.broadcast_tensors(*backward(*forward(D, L, U, b[..., None])))
    return torch.cat(rows, -1).mT


@pytest.mark.parametrize("n", [1, 2, 5])
def test_equals_the_dense_solve(n):
    """Elimination in blocks against torch.linalg.solve of the same matrix: to rounding times the
    condition.
    """
    D, L, U, b = system(n)
    x = torch.linalg.solve(dense(D, L, U), b.flatten(-2)).view_as(b)
    assert_close(solved(D, L, U, b), x, **ROUNDING)


def test_leading_axes_broadcast():
    D, L, U, b = system()
    x = solved(D[0], L, U[0], b[1])
    assert_close(x[2], solved(D[0], L[2], U[0], b[1]), **ROUNDING)


@pytest.mark.parametrize("bad", [0.0, float("nan"), float("inf")])
def test_a_singular_sample_leaves_the_others_alone(bad):
    """A zero (or NaN, or infinite) block in sample 1: it is not finite there, the others are bit
    for bit what they were.
    """
    D, L, U, b = system()
    good = solved(D, L, U, b)
    D, L = D.clone(), L.clone()
    D[1, 2] = bad
    L[1] = 0
    x = solved(D, L, U, b)
    assert not torch.isfinite(x[1]).all()
    for i in (0, 2, 3):
        assert_close(x[i], good[i], rtol=0, atol=0)


def test_positive_definite_is_what_the_eigenvalues_say():
    """Random symmetric chains, half of them shifted to one side of zero by their least eigenvalue,
    half to the other.
    """
    D, L, _, _ = system(4, batch=(64,))
    U = L.mT
    least = torch.linalg.eigvalsh(dense(D + D.mT, L, U))[:, 0]
    shift = torch.where(torch.arange(64) % 2 == 0, 0.1, -0.1) - least
    D = D + D.mT + shift[:, None, None, None] * torch.eye(D.shape[-1])
    assert torch.equal(positive_definite(D, L, U), torch.arange(64) % 2 == 0)


def test_pivots_beyond_a_singular_one():
    """They are no numbers; what looks at their eigenvalues is told so, sample by sample, and gets
    numbers.
    """
    D = torch.eye(2).expand(2, 3, 2, 2).clone()
    D[0, 0] = 0.0
    L = U = torch.eye(2).expand(2, 2, 2, 2) / 4
    assert not torch.isfinite(pivots(D, L, U)[0]).all()
    blocks, sound = finite_pivots(D, L, U)
    assert sound.tolist() == [False, True] and torch.isfinite(torch.linalg.eigvalsh(blocks)).all()
    assert torch.equal(blocks[1], pivots(D, L, U)[1])
