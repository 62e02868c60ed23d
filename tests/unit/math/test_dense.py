"""Dense systems of many rows, each sample by itself; threads set by a user: unit/test_imports."""

import pytest
import torch

from torchbeam.math.dense import LARGE, inverse_unchecked, positive_inverse, solve, solve_unchecked


@pytest.mark.parametrize("rows", [6, LARGE])
def test_batches_broadcast_and_keep_their_gradient(rows):
    torch.manual_seed(1)
    A = torch.randn(2, 1, rows, rows, requires_grad=True)
    B = torch.randn(3, rows, 2, requires_grad=True)
    found, wanted = solve(A, B), torch.linalg.inv(A.expand(2, 3, rows, rows)) @ B
    assert found.shape == (2, 3, rows, 2)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-9 * wanted.abs().max().item())
    for ours, theirs in zip(
        *(torch.autograd.grad(y.square().sum(), (A, B)) for y in (found, wanted)), strict=True
    ):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-8 * theirs.abs().max().item())


def test_a_singular_sample_harms_no_neighbour():
    """Three of many rows, the second of which is zero."""
    A = torch.eye(LARGE).repeat(3, 1, 1)
    A[1] = 0
    for found in (
        solve_unchecked(A, torch.ones(LARGE, 1)),
        inverse_unchecked(A).sum(-1, keepdim=True),
    ):
        assert (found[[0, 2]] == 1).all() and not torch.isfinite(found[1]).all()
    with pytest.raises(torch.linalg.LinAlgError):
        solve(A, torch.ones(LARGE, 1))


def test_inverses_of_positive_matrices():
    """A batch whose rows differ in size by 1e8, and its determinants; a singular matrix has a huge
    inverse.
    """
    torch.manual_seed(2)
    B, size = torch.randn(3, 4, 4), torch.tensor([1.0, 1e-4, 1e4, 1.0])
    A = size[:, None] * (B @ B.mT + torch.eye(4)) * size
    inverse, log_det = positive_inverse(A)
    unit = size[:, None] * inverse * size
    torch.testing.assert_close(
        unit, torch.linalg.inv(B @ B.mT + torch.eye(4)), rtol=1e-10, atol=1e-12
    )
    torch.testing.assert_close(log_det, torch.linalg.slogdet(A)[1], rtol=1e-10, atol=1e-12)
    singular, _ = positive_inverse(torch.ones(2, 2))
    assert torch.isfinite(singular).all() and (singular.diagonal() > 1e14).all()
