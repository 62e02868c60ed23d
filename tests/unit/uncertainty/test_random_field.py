"""Random fields: eigenvalues of the exponential correlation in closed form, covariance along the
beam; refusals.
"""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals


def exponential_eigenvalues(length, c, count):
    """Of exp(-|x - y|/c) on an interval, over its length: 2 c/(1 + (w c)^2)/length, where w solves
    (w^2 - 1/c^2) tan(w length) = 2 w/c. (Ghanem and Spanos 1991, section 2.3.3, both families in
    one equation.)
    """

    def g(w):  # w c = x: ((w c)^2 - 1) sin(w L) - 2 w c cos(w L)
        return ((w * c) ** 2 - 1) * math.sin(w * length) - 2 * w * c * math.cos(w * length)

    roots, step, w = [], math.pi / length / 50, 1e-9
    while len(roots) < count:
        if g(w) * g(w + step) < 0:
            a, b = w, w + step
            for _ in range(80):
                m = (a + b) / 2
                a, b = (m, b) if g(a) * g(m) > 0 else (a, m)
            roots.append(a)
        w += step
    return torch.tensor([2 * c / (1 + (w * c) ** 2) / length for w in roots])


@pytest.mark.parametrize("c", [0.1, 0.5, 3.0])
def test_eigenvalues(c):
    """The first eight; the quadrature of a kernel with a kink is good to 1e-3 of the last."""
    field = tb.laws.RandomField(torch.linspace(0, 2.0, 9), 0.0, 1.0, c, marginal="normal", terms=8)
    assert_close(field.eigenvalue, exponential_eigenvalues(2.0, c, 8), rtol=2e-3, atol=0)


@pytest.mark.parametrize("kernel, share", [("exponential", 0.98), ("gaussian", 0.99)])
def test_covariance(kernel, share):
    """That of the expansion is the kernel, up to what the terms leave out, most of it at the ends;
    so is that of samples.
    """
    s = torch.linspace(0.05, 0.95, 10)
    field = tb.laws.RandomField(s, 5.0, 2.0, 0.4, kernel=kernel, marginal="normal")
    r = (s[:, None] - s).abs() / 0.4
    wanted = (-r).exp() if kernel == "exponential" else (-r * r).exp()
    made = (field.shape * field.eigenvalue) @ field.shape.mT
    assert_close(made, wanted, rtol=0, atol=0.04)
    assert_close(field.captured, made.diagonal())
    assert field.captured.mean() > share and field.captured.max() < 1 + 1e-6
    samples = tb.monte_carlo(lambda theta: theta, {"f": field}, 4096, chunk=4096)
    assert_close(samples.y.mean(0), torch.full((10,), 5.0), rtol=1e-3, atol=0)
    assert_close(torch.cov(samples.y.mT), 4 * made, rtol=0, atol=0.1)
    assert f"{field.terms} terms" in repr(field)


def test_mean_with_few_terms():
    """Two terms of a rough lognormal field hold a half of its variance at the ends, and all of its
    mean (Gauss and Hermite).
    """
    field = tb.laws.RandomField(torch.linspace(0, 1, 5), 3.0, 1.5, 0.3, terms=2)
    x, w = (torch.from_numpy(v) for v in np.polynomial.hermite_e.hermegauss(24))
    weights = (w[:, None] * w).flatten() / (2 * math.pi)
    mean = weights @ field.of_scores(torch.cartesian_prod(x, x))
    assert field.captured.min() < 0.6
    assert_close(mean, torch.full((5,), 3.0), rtol=1e-9, atol=0)


def test_lognormal():
    """Positive, with the mean and deviation of the field itself, less what is left out of the
    logarithm's variance.
    """
    field = tb.laws.RandomField(torch.linspace(0, 1, 5), 3.0, 1.5, 1.0, kernel="gaussian", terms=8)
    y = tb.monte_carlo(lambda theta: theta, {"f": field}, 8192, chunk=8192).y
    assert (y > 0).all()
    assert_close(y.mean(0), torch.full((5,), 3.0), rtol=2e-3, atol=0)
    assert_close(y.std(0), torch.full((5,), 1.5), rtol=3e-2, atol=0)


REFUSED = {
    "one place": (dict(s=[0.5]), r"RandomField's s \(1,\) was given"),
    "places back": (dict(s=[0.5, 0.2]), "increasing places"),
    "no length": (dict(correlation_length=0.0), "correlation_length = 0 was given; a positive"),
    "mean of a lognormal": (dict(mean=0.0), "mean = 0 was given; a positive"),
    "kernel": (dict(kernel="matern"), "'exponential', 'gaussian' are there"),
    "marginal": (dict(marginal="beta"), "'lognormal', 'normal' are there"),
    "too many terms": (dict(kernel="gaussian", terms=40), "40 terms.*fewer terms"),
}


@refusals(REFUSED)
def test_refused(changed):
    tb.laws.RandomField(
        **{**dict(s=[0.0, 0.5, 1.0], mean=1.0, deviation=0.1, correlation_length=2.0), **changed}
    )
