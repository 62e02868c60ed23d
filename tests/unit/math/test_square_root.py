import pytest
import torch

from torchbeam.math.square_root import Later, conditioned, root_of


def rows(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def test_conditioned_is_the_normal_law_given_readings():
    """Mean, covariance and density of a joint normal law, by its covariance."""
    X, error = rows(3, 8, 5), rows(3, 2, seed=1)
    found, P = conditioned(X, error), X.mT @ X
    Pyy, Pxy, Pxx = P[:, :2, :2], P[:, 2:, :2], P[:, 2:, 2:]
    gain = Pxy @ Pyy.inverse()
    torch.testing.assert_close(found.change, (gain @ error[..., None])[..., 0])
    torch.testing.assert_close(found.root.mT @ found.root, Pxx - gain @ Pxy.mT)
    law = torch.distributions.MultivariateNormal(torch.zeros(2, dtype=torch.float64), Pyy)
    torch.testing.assert_close(found.log_density(torch.tensor(2.0)), law.log_prob(error))


def test_later_readings():
    """Of y = H x and what x moves to, F x, of which a later reading tells: the normal law given
    both.
    """
    root, F, H, C, y = (
        rows(3, 3), rows(3, 3, seed=1), rows(1, 3, seed=2), rows(1, 3, seed=3), rows(2),
    )  # fmt: skip
    first = conditioned(torch.cat((_with_noise(root @ H.mT), _below(root @ F.mT)), 1), y[:1])
    second_error = y[1:] - C @ first.change
    second = conditioned(
        torch.cat((_with_noise(first.root @ C.mT), _below(first.root)), 1), second_error
    )
    none = Later(torch.zeros(3, dtype=torch.float64), root[:0])
    later = none.before(second, C, torch.eye(3, dtype=torch.float64))
    change, left = later.before(first, H, F).given(root)
    both = torch.cat((H, C @ F))
    gain = root.mT @ root @ both.mT @ (both @ root.mT @ root @ both.mT + torch.eye(2)).inverse()
    torch.testing.assert_close(change, gain @ y)
    torch.testing.assert_close(left.mT @ left, root.mT @ root - gain @ both @ root.mT @ root)


def _with_noise(column):
    return torch.cat((column, torch.ones_like(column[:1])))


def _below(columns):
    return torch.cat((columns, torch.zeros_like(columns[:1])))


def test_root_of_a_covariance():
    P = rows(4, 2) @ rows(4, 2).mT
    root = root_of("covariance", P)
    torch.testing.assert_close(root.mT @ root, P)
    with pytest.raises(ValueError, match="none below 0 is wanted"):
        root_of("covariance", -P)
