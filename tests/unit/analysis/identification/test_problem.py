"""Problem: several experiments, offsets and drifts, status, sigma, the way to derivatives."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, NOISE, T, wave


def test_experiments_share_parameters():
    """Two experiments, one decay rate, amplitudes of their own: what one fit of both together by
    hand gives.
    """
    data = {
        "one": 2 * torch.exp(-0.7 * T) + NOISE,
        "two": 5 * torch.exp(-0.7 * T[:30]) - NOISE[:30],
    }
    models = {"one": wave, "two": lambda theta: wave(theta)[:, :30]}
    fit = tb.identify(models, data, {"b": 1.0, "a": tb.Parameter(1.0, own=True)})
    assert (
        fit.names == ("b", "one.a", "two.a")
        and set(fit.y) == {"one", "two"}
        and fit.y["two"].shape == (30,)
    )

    def both(theta):
        return torch.cat(
            [theta[:, k : k + 1] * torch.exp(-theta[:, :1] * t) for k, t in ((1, T), (2, T[:30]))],
            -1,
        )

    known = tb.identify(both, torch.cat(tuple(data.values())), (1.0, 1.0, 1.0))
    assert_close(fit.theta, known.theta, rtol=1e-6, atol=0)
    assert_close(fit.covariance, known.covariance, rtol=1e-4, atol=0)


def test_offset_and_drift_are_parameters_of_the_instrument():
    """Each channel's constant and slope come back, with the covariance of linear least squares;
    trials cost no more.
    """
    asked = []

    def model(theta):
        asked.append(len(theta["a"]))
        return torch.stack((wave(theta), 2 * wave(theta)), -1)

    clean = torch.stack((CLEAN, 2 * CLEAN), -1)
    data = clean + torch.tensor([0.3, -1.0]) + T[:, None] * torch.tensor([0.0, 0.2])
    data[5:9, 1] = math.nan
    record = tb.Measurement(data, 0.01, T, offset=True, drift=True, name="laser")
    fit = tb.identify(model, record, {"a": 1.0, "b": 1.0})
    assert fit.names[2:] == (
        "offset of laser 0", "offset of laser 1", "drift of laser 0", "drift of laser 1",
    )  # fmt: skip
    assert_close(fit.theta, torch.tensor([2.0, 0.7, 0.3, -1.0, 0.0, 0.2]), rtol=1e-6, atol=1e-6)
    assert max(asked) == 2 * 2 + 1
    X = torch.zeros(40, 2, 6)
    X[:, 0, 0], X[:, 1, 0] = CLEAN / 2, CLEAN
    X[:, 0, 1], X[:, 1, 1] = -T * CLEAN, -2 * T * CLEAN
    for k in (0, 1):
        X[:, k, 2 + k], X[:, k, 4 + k] = 1, T
    X = X.reshape(80, 6)[~data.flatten().isnan()]
    assert_close(fit.covariance, 1e-4 * torch.linalg.inv(X.mT @ X), rtol=1e-4, atol=1e-12)
    assert_close(fit.y[6, 1], clean[6, 1] - 1 + 0.2 * T[6], rtol=1e-6, atol=0)


def test_a_status_is_a_trial_that_failed():
    """(y, status): samples that failed do not count, whatever their numbers say, and the start
    counts as failed too.
    """

    def model(theta):
        bad = theta["b"] < 0.3
        return torch.where(bad[:, None], CLEAN, wave(theta)), bad.long()

    fit = tb.identify(model, CLEAN, {"a": 1.0, "b": 3.0})
    assert fit.status == 0 and (fit.history[..., 1] >= 0.3).all()
    assert_close(fit.theta, torch.tensor([2.0, 0.7]), rtol=1e-6, atol=0)
    vector = tb.identify(
        lambda x: model({"a": x[:, 0], "b": x[:, 1]}), CLEAN, torch.tensor([[1.0, 0.1], [1.0, 1.0]])
    )
    assert (
        vector.statuses.tolist() == [4, 0] and "the model failed at 1 of 2 starts" in vector.message
    )
    with pytest.raises(ValueError, match="a start"):
        tb.identify(model, CLEAN, {"a": 1.0, "b": 0.1})


def test_sigma_that_only_weighs():
    """absolute_sigma=False: any factor of sigma gives the same fit, covariance and intervals, those
    of the misfit.
    """
    sigma, start = 0.05 * (1 + T), {"a": 1.0, "b": 1.0}
    fits = [
        tb.identify(wave, CLEAN + NOISE, start, sigma=c * sigma, absolute_sigma=False)
        for c in (1.0, 7.0)
    ]
    assert_close(fits[0].interval(), fits[1].interval(), rtol=1e-6, atol=0)
    absolute = tb.identify(wave, CLEAN + NOISE, start, sigma=sigma)
    assert_close(fits[0].theta, absolute.theta, rtol=1e-6, atol=0)
    factor = absolute.misfit.square() * 40 / 38
    assert_close(fits[0].covariance, factor * absolute.covariance, rtol=1e-5, atol=0)
    assert_close(fits[0].freedom, torch.tensor([38.0, 38.0]), rtol=1e-9, atol=0)
    assert (absolute.freedom == math.inf).all()


def test_differences_of_many_periods_are_those_of_a_shorter_step():
    """A decay of 40 periods turns by a quarter of a radian where its frequency changes by 1e-3: the
    differences of a tenth of the step are taken, and found the same, but for a step that was asked
    for.
    """
    t = torch.linspace(0, 1, 400)

    def decay(theta):
        w, d = (theta[name][..., None] for name in ("w", "d"))
        return torch.cos(2 * math.pi * w * t) * torch.exp(-d * t)

    exact = {"w": torch.tensor(40.0), "d": torch.tensor(1.0)}
    start = {"w": 40.1, "d": 1.2}
    fit = tb.identify(decay, decay(exact), start)  # a SlowPathWarning would be an error
    assert fit.derivatives == "difference"
    assert_close(fit.theta, torch.tensor([40.0, 1.0]), rtol=1e-6, atol=0)
    with pytest.warns(tb.SlowPathWarning, match="differences of 'w' depend on their step"):
        assert tb.identify(decay, decay(exact), start, relative_step=1e-4).derivatives == "forward"


def test_differences_of_a_model_that_jumps_are_those_of_a_shorter_step():
    """A model that jumps by 1e-5, as where a step's parts are one more, next to the start: steps
    down to 1e-6 see the jump, which is the whole of their difference, those of 1e-7 and 1e-8 do
    not; b, which has none, keeps the step that was right, whose rounding is a ten-thousandth.
    """
    seen = []

    def jumping(theta):
        seen.append(theta["b"].unique())
        return wave(theta) + 1e-5 * (theta["a"] > 1 + 3e-7)[:, None] * torch.cos(T)

    fit = tb.identify(jumping, CLEAN, {"a": 1.0, "b": 1.0})  # a SlowPathWarning would be an error
    assert fit.derivatives == "difference"
    assert_close(fit.theta, torch.tensor([2.0, 0.7]), rtol=1e-4, atol=0)
    chosen = seen[5]  # after two passes to begin with and four shorter ones
    assert_close((chosen - 1).abs().max().item(), 1e-4, rtol=1e-6, atol=0)


def test_automatic_derivatives():
    """Differences where they are good; forward mode, with a warning, where noise of the model, here
    1e-5, spoils them.
    """

    def rough(theta):
        return wave(theta) + 1e-5 * torch.sin(1e9 * (theta["a"] + theta["b"])).detach()[:, None]

    start = {"a": 1.0, "b": 1.0}
    assert tb.identify(wave, CLEAN, start).derivatives == "difference"
    with pytest.warns(
        tb.SlowPathWarning, match="forward mode, .* differences of '[ab]' depend on their step"
    ):
        fit = tb.identify(rough, CLEAN, start, tolerance=1e-4)
    assert fit.derivatives == "forward"
    assert_close(fit.theta, torch.tensor([2.0, 0.7]), rtol=1e-4, atol=0)
