"""Products of deviations of motion and parameters: against draws, and against derivatives."""

import torch
from torch.distributions import LogNormal

import torchbeam as tb
from torchbeam.analysis.estimation.products import Products

from .test_kalman_filter import DT, TIP, randn, strip


def test_mean_and_covariance_are_those_of_draws():
    """Of 400,000: within five deviations of what they say."""
    products = Products(randn(2, 3, 4))  # 2 parameters, 3 numbers, 4 of z
    root = 0.5 * randn(7, 6, seed=1)
    mean, rows = products(root[:, :4], root[:, 4:])
    drawn = randn(400_000, 7, seed=2) @ root
    z, p = drawn.split((4, 2), -1)
    values = torch.einsum("kp,prn,kn->kr", p, products.slopes, z)
    far = values - values.mean(0)
    deviation = (far.square().mean(0) / len(far)).sqrt()
    assert ((values.mean(0) - mean).abs() < 5 * deviation).all()
    covariance = rows.mT @ rows
    assert (far.mT @ far / len(far) - covariance).abs().max() < 0.03 * covariance.abs().max()


def test_slopes_are_those_of_the_derivatives():
    """What the derivatives by z of one interval change by, where the stiffness is 1 % more."""
    E = tb.Parameter(1.0, transform="log", prior=LogNormal(0.0, 0.1))
    model = tb.linearize(strip(), inputs={"u": (0.0, 0, 0)}).reduced(2)
    f = tb.KalmanFilter(
        lambda p: strip(p["E"]), TIP, dt=DT, noise=1e-3, parameters={"E": E}, model=model
    )
    plain, stiffer = (
        tb.Stepper(strip(1.01**k), DT).jacobian(model.state, torch.zeros(3), model)[0]
        for k in (-1, 1)
    )
    slope = (stiffer - plain) / (2 * torch.tensor(1.01).log())
    scale = slope.abs().max()
    assert (f.products.slopes[0, :4] - slope).abs().max() < 1e-3 * scale
