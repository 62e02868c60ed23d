"""Exponents of linear models with the period of a turn."""

import math

import numpy as np
import torch

from torchbeam.linear.periodic import exponents


def mathieu(psi):
    """x'' + 0.1 x' + (a - 2 q cos 2t) x = 0, t = psi, and one uncoupled of w = 0.3."""
    eye = torch.eye(2, dtype=torch.float64).expand(len(psi), 2, 2)
    K = torch.zeros(len(psi), 2, 2, dtype=torch.float64)
    K[:, 0, 0] = 1.2 - torch.cos(2 * psi)
    K[:, 1, 1] = 0.09
    return eye, 0.1 * eye, K


def by_runge_kutta(steps=2000):
    """Exponents of the first, whose turn is 2 pi."""
    h, X = 2 * math.pi / steps, np.eye(2)

    def rates(t):
        return np.array([[0.0, 1.0], [-(1.2 - math.cos(2 * t)), -0.1]])

    for k in range(steps):
        A, B, C = (rates(h * (k + s)) for s in (0, 0.5, 1))
        a = A @ X
        b = B @ (X + h / 2 * a)
        c = B @ (X + h / 2 * b)
        X = X + h / 6 * (a + 2 * b + 2 * c + C @ (X + h * c))
    return np.log(np.linalg.eigvals(X).astype(complex)) / (2 * math.pi)


def test_mathieus_equation_at_sixth_order():
    """Its exponents are those of Runge and Kutta's method at 2000 steps; halving the step divides
    the error by about 64. The oscillator of 0.3 rad/s beside it keeps its own.
    """
    one, expected = torch.ones((), dtype=torch.float64), max(by_runge_kutta().real)
    off = []
    for steps in (16, 32):
        value, shape = exponents(mathieu, one, steps, 3, 10 * one)
        value, shape = value[:, 0], shape[:, 0]  # of the largest harmonic
        own = value[(shape[:, 1].abs() > 0.9 * shape.norm(dim=-1)).nonzero()[0]]
        # the frequency that damping leaves
        assert abs(own.imag.item() - math.sqrt(0.09 - 0.05**2)) < 1e-8
        off.append(abs(value.real.max().item() - expected))
    assert off[1] < 1e-8 and 50 < off[0] / off[1] < 75


def test_the_harmonic_that_is_seen_most_names_the_frequency():
    """A frequency of 5.3 turns comes back as such, and not as 0.3."""

    def matrices(psi):
        eye = torch.ones(len(psi), 1, 1, dtype=torch.float64)
        return eye, 0 * eye, 5.3**2 * eye

    one = torch.ones((), dtype=torch.float64)
    value = exponents(matrices, one, 64, 1, 10 * one).exponent
    assert abs(value[0, 0].imag - 5.3) < 1e-4
