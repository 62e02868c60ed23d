"""Losses of Huber and Student: estimates that outliers do not carry away, with their deviations."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.line_fits import TRUE, N, T, line
from torchbeam.analysis.identification.losses import HUBER, STUDENT


def noise(seed, share=0.1):
    """0.05, and of some readings 1."""
    random = torch.Generator().manual_seed(seed)
    e = 0.05 * torch.randn(N, generator=random)
    return torch.where(torch.rand(N, generator=random) < share, 20 * e, e)


def identified(values, loss, sigma=None, **options):
    data = tb.Measurement(values, sigma, T, name="laser", loss=loss)
    return tb.identify(line, data, {"a": 1.0, "b": 1.0}, **options)


def lost(loss, u):
    if loss == "student":
        return (STUDENT + 1) / 2 * torch.log1p(u.square() / STUDENT)
    return torch.where(u.abs() < HUBER, u.square() / 2, HUBER * (u.abs() - HUBER / 2))


@pytest.mark.parametrize("loss", ["huber", "student"])
@pytest.mark.parametrize("sigma", [0.05, None])
def test_the_loss_is_least(loss, sigma):
    values = 1 + 2 * T + noise(0)
    fit = identified(values, loss, sigma)
    theta = fit.theta.clone().requires_grad_()
    scale = sigma or fit.scale
    total = lost(loss, (theta[0] + theta[1] * T - values) / scale).sum()
    (slope,) = torch.autograd.grad(total, theta)
    assert fit.status == 0
    # of a misfit that one deviation of a parameter changes
    assert_close(slope * fit.deviation, torch.zeros(2), rtol=0, atol=5e-3)
    assert 0.03 < scale < 0.09  # of 0.05, and a tenth of them twenty times that


def test_outliers_do_not_carry_it_away():
    squares = torch.stack([identified(1 + 2 * T + noise(k), None).theta for k in range(20)]) - TRUE
    for loss in ("huber", "student"):
        off = torch.stack([identified(1 + 2 * T + noise(k), loss).theta for k in range(20)]) - TRUE
        assert (off.square().mean(0) < 0.25 * squares.square().mean(0)).all()


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_intervals_hold(loss):
    """95 % intervals hold the truth in 86 % or more of 60 sets, three deviations of such a count
    below 95 %.
    """
    inside = torch.zeros(2)
    for seed in range(60):
        low, high = identified(1 + 2 * T + noise(seed), loss).interval(0.95).unbind(-1)
        inside += (low <= TRUE) & (high >= TRUE)
    assert (inside / 60 > 0.86).all(), inside


def test_of_normal_noise_hubers_scale_is_the_deviation():
    random = torch.Generator().manual_seed(0)
    scales = [
        identified(1 + 2 * T + 0.05 * torch.randn(N, generator=random), "huber").scale
        for _ in range(20)
    ]
    assert_close(torch.tensor(scales).mean(), torch.tensor(0.05), rtol=0.05, atol=0)


def test_with_memory_and_by_channel():
    values = 1 + 2 * T + noise(0)
    data = tb.Measurement(values, times=T, name="laser", loss="huber", noise="ar1")
    fit = tb.identify(line, data, {"a": 1.0, "b": 1.0}, noise="channel")
    assert fit.status == 0
    assert 0.03 < fit.noise["laser"] < 0.09
    assert fit.memory["laser"] < 0.5
    with pytest.raises(ValueError, match="by misfits"):
        fit.profile("a")


def test_refusals():
    with pytest.raises(ValueError, match="'cauchy' was given"):
        tb.Measurement(T, 0.1, loss="cauchy")
