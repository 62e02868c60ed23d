"""Intervals: Student's quantiles, covariance, profile likelihood, bootstrap."""

import math

import pytest
import torch
from torch.distributions import Gamma, LogNormal, Normal, Uniform
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, NOISE, T, wave
from torchbeam.analysis.identification import profile
from torchbeam.math.distributions import student_quantile


def test_intervals_of_a_linear_model():
    """All three are theta +- t deviation; the bootstrap's to what 4,000 repeats know
    (a quantile to 3 %).
    """
    X = torch.stack((torch.ones_like(T[:8]), T[:8]), -1)
    data = X @ torch.tensor([1.0, -0.5]) + NOISE[:8]
    fit = tb.identify(lambda theta: theta @ X.T, data, (0.5, 0.5))
    t = student_quantile(0.95, 6)
    exact = torch.stack((fit.theta - t * fit.deviation, fit.theta + t * fit.deviation), -1)
    assert_close(fit.freedom, torch.tensor([6.0, 6.0]), rtol=1e-9, atol=0)
    assert_close(fit.interval(0.9), exact, rtol=1e-6, atol=0)
    assert_close(fit.interval(0.9, "profile"), exact, rtol=1e-3, atol=1e-4)
    off = (fit.interval(0.9, "bootstrap", repeats=4000) - exact).abs() / fit.deviation[:, None]
    assert off.max() < 0.15


def test_profile_of_a_nonlinear_model():
    """sigma known: the ends are where the least chi^2 rises by z^2, which a search by hand over b
    finds.
    """
    data = CLEAN + 10 * NOISE
    fit = tb.identify(
        wave, data, {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}, sigma=0.5
    )

    def least(b):
        shape = torch.exp(-b * T)
        return ((shape * (shape @ data) / (shape @ shape) - data) / 0.5).square().sum().item()

    bottom, ends = least(fit["b"]), []
    for side in (-1, 1):
        near, far = fit["b"].item(), fit["b"].item() * 4.0**side
        for _ in range(60):
            middle = (near + far) / 2
            near, far = (
                (middle, far)
                if least(torch.tensor(middle)) - bottom < 1.959964**2
                else (near, middle)
            )
        ends.append(near)
    found = fit.interval(0.95, "profile")[1]
    assert_close(found, torch.tensor(ends), rtol=5e-3, atol=0)
    (one,) = fit.profile("b")
    assert_close(one.interval, found)
    middle = (one.values - fit["b"]).abs().argmin()
    assert (
        one.rise[middle] == 0
        and (one.rise[1 : middle + 1] < one.rise[:middle]).all()
        and (one.values.diff() > 0).all()
    )
    assert_close(
        one.rise, torch.tensor([least(b) - bottom for b in one.values]), rtol=1e-3, atol=1e-6
    )


def test_a_profile_of_fits_that_are_cut_short(monkeypatch):
    """Held fits of one iteration, from the ridge that the covariance says, are a little high; the
    interval stays to 10 %.
    """
    fit = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": tb.Parameter(1.0, "log")})
    whole = fit.interval(method="profile")
    monkeypatch.setattr(profile, "ITERATIONS", 1)
    width = (whole[:, 1] - whole[:, 0])[:, None]
    assert ((fit.interval(method="profile") - whole).abs() < 0.1 * width).all()


def test_what_is_not_told_has_no_interval():
    """The whole of what a parameter can be; others keep theirs."""

    def model(theta):
        return (theta["a"] * theta["b"])[:, None] * T + theta["c"][:, None]

    log = tb.Parameter(1.0, "log")
    start = {"a": log, "b": tb.Parameter(1.5, "log", bounds=(0.1, 9.0)), "c": 0.0}
    fit = tb.identify(model, 2 * T + 1 + 0.01 * NOISE, start)
    assert fit.status == 3 and fit.open.tolist() == [True, True, False]
    low, high = fit.interval().unbind(-1)
    assert low[0] == 0 and high[0] == math.inf
    assert_close(torch.stack((low[1], high[1])), torch.tensor([0.1, 9.0]))
    assert low[2] < 1 < high[2] and high[2] - low[2] < 0.01
    assert "not told by the data" in fit.summary()


def test_the_bootstrap_scatters_as_the_covariance():
    """One batch of repeats, few evaluations each; deviations those of the covariance to 10 %."""
    sizes = []

    def model(theta):
        sizes.append(len(theta["a"]))
        return wave(theta)

    fit = tb.identify(model, CLEAN + NOISE, {"a": 1.0, "b": 1.0}, sigma=0.05)
    sizes.clear()
    found = fit.bootstrap(800)
    assert (found.status == 0).all() and sum(sizes) < 800 * 15
    assert_close(found.theta.std(0), fit.deviation, rtol=0.1, atol=0)
    again = fit.bootstrap(800)
    assert_close(found.theta, again.theta)


@pytest.mark.parametrize("sigma", [0.002, None])
def test_repeats_say_the_same_of_any_function(sigma):
    """Deflections of a strip in a clamp of compliance c, which linear least squares find with their
    normal law, or Student's t: whether c is searched, or the stiffness 1/c, or its logarithm, the
    interval is that of c, which 4,000 repeats know to 5 % of its width, and the same to a
    hundredth: a fit ends by a step of a hundredth of a deviation. (That of c is 10 %.)
    """
    s = torch.linspace(0.125, 1, 8)
    data = (
        s**2 * (3 - s) / 6
        + s * 0.05
        + 0.002 * torch.tensor([1.0, -1.0, -0.5, 0.5, 1.0, -1.0, -1.0, 1.0])
    )

    def strip(theta):
        clamp = theta["c"] if "c" in theta else 1 / theta["k"]
        return theta["b"][:, None] * (s**2 * (3 - s) / 6) + clamp[:, None] * s

    found = []
    for one in ({"c": 0.05}, {"k": 20.0}, {"k": tb.Parameter(20.0, "log")}):
        fit = tb.identify(strip, data, {"b": 1.0, **one}, sigma=sigma)
        ends = fit.interval(method="bootstrap", repeats=4000)[1]
        found.append(ends if "c" in one else 1 / ends.flip(0))
        if "c" in one:
            assert ((ends - fit.interval()[1]).abs() < 0.05 * (ends[1] - ends[0])).all()
    for other in found[1:]:
        assert_close(other, found[0], rtol=0, atol=1e-2 * (found[0][1] - found[0][0]).item())


def test_repeats_between_the_ends_of_a_uniform_prior():
    """As between bounds; a tenth of the repeats end at the nearer one, which is the interval's
    end.
    """
    fits = [
        tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": tb.Parameter(0.7, **limits)}, sigma=0.05)
        for limits in ({"prior": Uniform(0.69, 0.9)}, {"bounds": (0.69, 0.9)})
    ]
    prior, bounds = (fit.interval(method="bootstrap") for fit in fits)
    assert_close(prior, bounds, rtol=1e-9, atol=0)
    assert_close(prior[1, 0].item(), 0.69, rtol=1e-9, atol=0)


def test_as_many_parameters_as_data():
    """No sigma, and nothing left to know it by: a hint says so, and profile and bootstrap are
    refused.
    """
    fit = tb.identify(lambda theta: wave(theta)[:, :2], CLEAN[:2], {"a": 1.0, "b": 1.0})
    assert any("as many parameters as data" in hint for hint in fit.hints)
    assert not tb.identify(
        lambda theta: wave(theta)[:, :2], CLEAN[:2], {"a": 1.0, "b": 1.0}, sigma=0.1
    ).hints
    for method in ("profile", "bootstrap"):
        with pytest.raises(ValueError, match=f"a {method} of as many parameters as data"):
            fit.interval(method=method)


def test_the_bootstrap_repeats_normal_priors():
    """Readings of a sum, each number with a normal prior, and of one with a log-normal: repeats
    scatter as the posterior of the conditional normal law (3,000 repeats: 1.3 %), and intervals are
    those of the covariance to what quantiles know (3 %).
    """
    start = {
        "a": tb.Parameter(
            torch.tensor([0.7, 0.7]),
            prior=Normal(torch.tensor([1.0, 0.5]), torch.tensor([0.3, 0.4])),
        ),
        "c": tb.Parameter(1.0, "log", own=True, prior=LogNormal(0.1, 0.05)),
    }
    models = {
        "x": lambda theta: theta["a"].sum(-1, keepdim=True),
        "y": lambda theta: theta["c"][:, None] + theta["a"][:, :1],
    }
    data = {"x": tb.Measurement([2.0], 0.1), "y": tb.Measurement([2.0], 0.5, offset=True)}
    fit = tb.identify(models, data, start)
    found = fit.bootstrap(3000)
    assert (found.status == 0).all()
    assert_close(found.x.std(0), fit.x_covariance.diagonal().sqrt(), rtol=0.05, atol=0)
    assert_close(
        found.x.T.cov(), fit.x_covariance, rtol=0, atol=0.05 * fit.x_covariance.max().item()
    )
    off = (fit.interval(method="bootstrap", repeats=3000) - fit.interval()).abs()[
        :2
    ] / fit.deviation[:2, None]
    assert off.max() < 0.15


def test_bootstraps_that_are_refused():
    """Of priors that are no observation with normal noise; levels that are none."""
    with pytest.raises(
        ValueError, match=r"with the prior Gamma\(.*\) of 'b' was asked for; normal, log-normal"
    ):
        tb.identify(
            wave, CLEAN, {"a": 1.0, "b": tb.Parameter(1.0, prior=Gamma(9.0, 9.0))}, sigma=0.1
        ).bootstrap(50)
    found = tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": 1.0}).bootstrap(50)
    with pytest.raises(
        ValueError, match=r"50 repeats are too few for a level of 0\.95; 80 or more"
    ):
        found.interval()
    for level in (0.0, 1.0):
        with pytest.raises(ValueError, match="between 0 and 1 is wanted"):
            found.interval(level)
