"""Eigenvalues next to zero by a growing subspace, against all of them by the dense way."""

import torch
from torch.testing import assert_close

from torchbeam.math.quadratic_eigen import slow_first
from torchbeam.math.subspace import nearest

COUNT = 4


def matrices(n=80):
    """Two samples of A (2, n, n) that is not normal, whose eigenvalues spread as those of a beam
    do: of the second each is there twice.
    """
    generator = torch.Generator().manual_seed(3)
    turn = torch.linalg.qr(torch.randn(2, n, n, generator=generator))[0]
    turn = turn @ (torch.eye(n) + 0.2 * torch.randn(2, n, n, generator=generator) / n**0.5)
    size = torch.stack((torch.arange(1.0, n + 1), torch.arange(2, n + 2) // 2)) ** -4
    size[0, 5:7] = 0.0
    A = torch.diag_embed(size)
    A[0, 5:7, 5:7] = 2e-3 * torch.tensor([[1.0, 2.0], [-2.0, 1.0]])  # 4.5e-3: a pair of the wanted
    return turn @ A @ torch.linalg.inv(turn)


def slowest(mu):
    return mu.gather(-1, slow_first(mu, COUNT, False))


def test_as_dense():
    """To 1e-8: a residual of 32 times rounding by the spread 256 of the first four eigenvalues, and
    by the condition of the vectors (5e-10 was seen). A sample alone is the same one.
    """
    A = matrices()

    def found(k=slice(None)):
        start = torch.cos(torch.arange(80.0)[:, None] * (1 + torch.arange(COUNT + 2)) * 0.7 + 0.3)
        found = nearest(lambda x: A[k] @ x, start, lambda mu: slow_first(mu, COUNT, False))
        return slowest(found[0])

    both, want = found(), slowest(-1 / torch.linalg.eigvals(A))
    assert (want[0].imag != 0).any()
    assert_close(both.abs(), want.abs(), rtol=1e-8, atol=0)
    assert_close(both.real, want.real, rtol=0, atol=1e-8 * want.abs().max().item())
    assert_close(found(slice(1, 2))[0].abs(), both[1].abs(), rtol=1e-8, atol=0)


def test_none_where_there_is_no_end():
    """Eigenvalues that do not spread (a random matrix) do not converge; a product that is not
    finite ends it.
    """
    generator = torch.Generator().manual_seed(3)
    A, start = (
        torch.randn(400, 400, generator=generator),
        torch.randn(400, 6, generator=generator),
    )
    for product in (A, A * torch.nan):
        assert (
            nearest(lambda x, A=product: A @ x, start, lambda mu: slow_first(mu, 4, False)) is None
        )
