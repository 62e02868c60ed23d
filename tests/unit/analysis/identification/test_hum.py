"""A hum in the readings, of known or sought frequency."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

T = torch.linspace(0, 2, 200)
TURN = 2 * math.pi


def decay(theta):
    return torch.exp(-theta["b"][:, None] * T) * torch.sin(9 * T)


def noisy(sigma=0.01, seed=0):
    """The decay with b = 0.7, and 0.05 cos(2 pi 7.03 t - 0.4)."""
    random = torch.Generator().manual_seed(seed)
    hum = 0.05 * torch.cos(TURN * 7.03 * T - 0.4)
    return decay({"b": torch.tensor([0.7])})[0] + hum + sigma * torch.randn(200, generator=random)


def test_one_of_known_frequency_is_two_columns_of_the_closed_form():
    """Deviations are those of linear least squares with a cosine and a sine; the line in the
    residuals, which a fit without it names, is gone.
    """
    gauge = tb.Measurement(noisy(), 0.01, T, hum=7.03, name="gauge")
    assert any("a line at 6.965 Hz" in doubt for doubt in _doubts(tb.Measurement(noisy(), 0.01, T)))
    fit = tb.identify(decay, gauge, {"b": 0.5})
    assert fit.names[1:] == ("cosine of 7.03 Hz of gauge", "sine of 7.03 Hz of gauge")
    b = fit["b"]
    J = torch.stack((-T * torch.exp(-b * T) * torch.sin(9 * T), torch.cos(TURN * 7.03 * T),
                     torch.sin(TURN * 7.03 * T)), -1)  # fmt: skip
    expected = torch.linalg.inv(J.mT @ J).diagonal().sqrt() * 0.01
    assert_close(fit.deviation, expected, rtol=1e-5, atol=0)
    true = torch.tensor([0.7, 0.05 * math.cos(0.4), 0.05 * math.sin(0.4)])
    assert ((fit.theta - true).abs() < 3 * fit.deviation).all() and not fit.doubts


def _doubts(measured):
    return tb.identify(decay, measured, {"b": 0.5}).doubts


@pytest.mark.parametrize("derivatives", ["difference", "forward", "adjoint"])
@pytest.mark.parametrize("noise", ["white", "ar1"])
def test_a_sought_frequency_is_found_with_its_amplitudes(derivatives, noise):
    gauge = tb.Measurement(noisy(), 0.01, T, hum="f", name="gauge", noise=noise)
    fit = tb.identify(decay, gauge, {"b": 0.5, "f": 7.2}, derivatives=derivatives)
    assert fit.status == 0 and not fit.doubts
    assert (fit["f"] - 7.03).abs() < 3 * fit.deviation[1] < 0.02
    size = torch.hypot(fit["cosine of f of gauge"], fit["sine of f of gauge"])
    assert_close(size, torch.tensor(0.05), rtol=0, atol=3e-3)


def test_its_derivatives_are_those_of_the_residuals():
    """By differences of residuals, of two experiments with own frequencies and three starts, by its
    logarithm.
    """
    two = {name: tb.Measurement(noisy(seed=k), 0.01, T, hum=("f", 50.0), offset=True, name="gauge")
           for k, name in enumerate("ab")}  # fmt: skip
    start = {"b": 0.5, "f": tb.Parameter(7.1, "log", own=True)}
    fit = tb.identify(decay, two, start, tolerance=1e-9)
    problem, every = fit.problem, torch.arange(3)
    x = fit.x + 0.01 * torch.randn(3, len(fit.x), generator=torch.Generator().manual_seed(0))
    _, J = problem.linearised(x, every)
    h = 1e-6
    for k in range(len(fit.x)):
        step = torch.zeros_like(x)
        step[:, k] = h
        both = (problem.residuals(x + s * step, every) for s in (1, -1))
        column = (next(both) - next(both)) / (2 * h)
        assert_close(J[..., k], column, rtol=1e-5, atol=1e-5 * column.abs().max().item())


def test_it_is_carried_into_a_prediction_with_its_share_of_the_band():
    """At the readings the band is the fit's own; ahead what is not known of f makes it wider: the
    variance is that of the closed form's derivatives.
    """
    gauge = tb.Measurement(noisy(), 0.01, T, hum="f", name="gauge")
    fit = tb.identify(decay, gauge, {"b": 0.5, "f": 7.0})
    own = fit.predict(measurement="gauge")
    assert_close(own.y, fit.y, rtol=0, atol=1e-10)
    assert_close(own.deviation, fit.readings[0].deviation, rtol=1e-6, atol=0)
    at = torch.tensor([4.0, 4.05])

    def ahead(theta):
        return torch.exp(-theta["b"][:, None] * at) * torch.sin(9 * at)

    band = fit.predict(ahead, measurement="gauge", times=at)
    b, f, c, s = fit.theta
    cos, sin = torch.cos(TURN * f * at), torch.sin(TURN * f * at)
    J = torch.stack((-at * torch.exp(-b * at) * torch.sin(9 * at),
                     TURN * at * (s * cos - c * sin), cos, sin), -1)  # fmt: skip
    assert_close(band.deviation, ((J @ fit.covariance) * J).sum(-1).sqrt(), rtol=1e-5, atol=0)
    assert_close(band.y, ahead(dict(b=b[None]))[0] + c * cos + s * sin, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "hum, words",
    [(-50.0, "a positive frequency"), (float("nan"), "hum"), ((50, 50.0), "each frequency once"),
     ([], None)],
)  # fmt: skip
def test_others_are_refused(hum, words):
    if words is None:
        assert tb.Measurement(T, 1.0, T, hum=hum).hum == ()
        return
    with pytest.raises(ValueError, match=words):
        tb.Measurement(T, 1.0, T, hum=hum)


def test_one_without_times_or_a_parameter_is_refused():
    with pytest.raises(ValueError, match="a hum was given without times"):
        tb.Measurement(T, 1.0, hum=50.0)
    with pytest.raises(ValueError, match="the parameter 'f'"):
        tb.identify(decay, tb.Measurement(noisy(), 0.01, T, hum="f"), {"b": 0.5})
    with pytest.raises(ValueError, match="one number is wanted"):
        measured = tb.Measurement(noisy(), 0.01, T, hum="f")
        tb.identify(decay, measured, {"b": 0.5, "f": torch.tensor([7.0, 8.0])})
