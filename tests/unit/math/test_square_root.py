import pytest
import torch

from torchbeam.math.square_root import (
    conditioned,
    normal_log_density,
    regression,
    root_of,
    triangle,
)


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
    density = normal_log_density(found.error, found.size, torch.tensor(2.0))
    torch.testing.assert_close(density, law.log_prob(error))


@pytest.mark.parametrize("known", [False, True])
def test_regression(known):
    """What came before by what came after, of which a part may be known already."""
    X = rows(7, 6)
    if known:
        X[:, 1] = 0.0
    root, P = triangle(X), X.mT @ X
    gain, left = regression(root, 3)
    best = P[3:, :3] @ torch.linalg.pinv(P[:3, :3], rtol=1e-12)
    torch.testing.assert_close(gain, best)
    torch.testing.assert_close(left.mT @ left, P[3:, 3:] - best @ P[:3, 3:])


def test_root_of_a_covariance():
    P = rows(4, 2) @ rows(4, 2).mT
    root = root_of("covariance", P)
    torch.testing.assert_close(root.mT @ root, P)
    with pytest.raises(ValueError, match="none below 0 is wanted"):
        root_of("covariance", -P)
