"""Posterior of fields: samples against integrals of the linear model's density, over weights, noise
and places.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.analysis.identification.posterior import CHAINS, KEPT, samples
from torchbeam.analysis.identification.regularization import Linearised

N, P = 30, 6
PLACES = torch.linspace(0, 1, P)
BLUR = torch.exp(-(((torch.linspace(0, 1, N)[:, None] - PLACES) / 0.2) ** 2))
ROWS = tb.Smoothness().rows(PLACES)
ZERO = torch.zeros(P)


def linear(sigma, data, known=True):
    """About zero, misfits over sigma where that is known."""
    over = sigma if known else 1.0
    return Linearised(ZERO, -data / over, BLUR / over, (ROWS,), (torch.zeros(P - 1),), ZERO, ZERO)


def noisy(sigma, seed=1):
    random = torch.Generator().manual_seed(seed)
    return BLUR @ (1 + 0.3 * torch.randn(P, generator=random).cumsum(0)) + sigma * torch.randn(
        N, generator=random
    )


def mixture(log_density, mean, covariance):
    """Mean and covariance of normal laws (K, P) with weights of that logarithm (K,)."""
    share = log_density.softmax(0)
    centre = share @ mean
    off = mean - centre
    return centre, (share[:, None, None] * (covariance + off[:, :, None] * off[:, None])).sum(0)


@pytest.mark.parametrize("known", [True, False])
def test_weights_and_noise_are_integrated_over(known):
    """Against sums over a fine grid of the rows' deviation t (a flat prior) and, where it is not
    known, of the logarithm of the noise. 6,400 samples, of which some are alike: means within a
    tenth of a deviation, deviations to 8 %.
    """
    sigma, data = 0.3, noisy(0.3)
    t = torch.linspace(0.01, 6, 300)
    s = torch.tensor([sigma]) if known else torch.linspace(0.12, 0.8, 60)
    t, s = (x.flatten() for x in torch.meshgrid(t, s, indexing="ij"))
    A = BLUR.T @ BLUR / s[:, None, None] ** 2 + ROWS.T @ ROWS / t[:, None, None] ** 2
    inverse = torch.linalg.inv(A)
    mean = inverse @ (BLUR.T @ data) / s[:, None] ** 2
    squares = (data - mean @ BLUR.T).square().sum(-1) / s**2 + (mean @ ROWS.T).square().sum(
        -1
    ) / t**2
    log_density = (
        -squares / 2 - torch.logdet(A) / 2 - (P - 1) * t.log() - (N + (not known)) * s.log()
    )
    exact, covariance = mixture(log_density, mean, inverse)
    found = samples(
        linear(sigma, data, known), torch.tensor([1.0]), 1.0 if known else sigma, [False], True,
        known,
    )  # fmt: skip
    deviation = covariance.diagonal().sqrt()
    assert found.shape == (CHAINS * KEPT, P)
    assert ((found.mean(0) - exact).abs() < 0.1 * deviation).all()
    assert_close(found.std(0), deviation, rtol=0.08, atol=0)


def test_sharp_rows_have_students_law():
    """Three numbers seen by themselves, with Student's prior of their two differences: against the
    integral on a grid of their places, whose density has two hills. Means to a tenth of a
    deviation, deviations to 8 %.
    """
    data, sigma, weight = torch.tensor([0.0, 0.9, 1.0]), 0.3, 40.0
    rows = tb.Smoothness().rows(data)
    axis = torch.linspace(-1.5, 2.5, 61)
    x = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    density = (
        -((x - data) / sigma).square().sum(-1) / 2
        - (1 + weight * (x @ rows.T).square()).log().sum(-1)
    ).softmax(0)
    mean = density @ x
    deviation = (density @ (x - mean).square()).sqrt()
    eye, none = torch.eye(3), torch.zeros(3)
    problem = Linearised(none, -data / sigma, eye / sigma, (rows,), (torch.zeros(2),), none, none)
    found = samples(problem, torch.tensor([weight]), 1.0, [True], False, True)
    assert ((found.mean(0) - mean).abs() < 0.1 * deviation).all()
    assert_close(found.std(0), deviation, rtol=0.08, atol=0)


def test_intervals_of_fields():
    """Wider than where the weight is given as it was found; those are the normal law's. Samples go
    along to a finer model.
    """
    data = tb.Measurement(noisy(0.3), 0.3)

    def model(theta, factor=1.0):
        return factor * theta["x"] @ BLUR.T

    start, smooth = {"x": torch.zeros(P)}, {"x": tb.Smoothness()}
    found = tb.identify_fields(model, data, start, smooth)
    given = tb.identify_fields(model, data, start, smooth, weight=found.weight)
    assert given.samples is None and found.samples.shape == (CHAINS * KEPT, P)
    assert_close(given.interval("x"), given.fit.interval(), rtol=0, atol=0)
    low, high = found.interval("x").unbind(-1)
    assert (high - low > given.interval("x").diff()[:, 0]).double().mean() > 0.5 and (
        low < found["x"]
    ).all()
    assert (found.interval("x", 0.5).diff() < found.interval("x").diff()).all()
    assert_close(found.deviation("x"), found.samples.std(0), rtol=1e-6, atol=0)
    other = found.refined(lambda theta: model(theta, 1.1))
    assert_close(other["x"], found["x"] / 1.1, rtol=0, atol=0.1 * found.deviation("x").max().item())
    assert_close(
        other.interval("x") - other["x"][:, None], found.interval("x") - found["x"][:, None]
    )
