"""noise="ar1" and "repeats": correlation from reading to reading is found, and deviations hold."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.line_fits import TRUE, N, T, alike, line
from torchbeam.analysis.identification.memory import LARGEST


def identified(values, sigma=0.05, times=T, noise="ar1", **options):
    data = tb.Measurement(values, sigma, times, name="laser", noise=noise)
    return tb.identify(line, data, {"a": 1.0, "b": 1.0}, **options)


def restricted(rho, values, times, free):
    """Minus twice the restricted log-likelihood, by dense matrices; theta and its covariance."""
    known = ~values.isnan()
    at, y = times[known], values[known]
    V = rho ** ((at[:, None] - at).abs() / times.sort().values.diff().median())
    X = torch.stack((torch.ones_like(at), at), -1)
    inverse = torch.linalg.inv(V if free else 0.05**2 * V)
    A = X.T @ inverse @ X
    theta = torch.linalg.solve(A, X.T @ inverse @ y)
    squares = (y - X @ theta) @ inverse @ (y - X @ theta)
    scale = squares / (len(y) - 2) if free else 1.0
    size = (len(y) - 2) * squares.log() if free else squares
    value = size - torch.logdet(inverse) + torch.logdet(A)
    return value, theta, scale * torch.linalg.inv(A)


@pytest.mark.parametrize("sigma", [0.05, None])
def test_restricted_likelihood_by_dense_matrices(sigma):
    """Irregular times in any order, and a gap: rho is where the restricted likelihood is largest,
    estimate and covariance are those of generalised least squares.
    """
    random = torch.Generator().manual_seed(1)
    times = T[torch.randperm(N, generator=random)]
    values = 1 + 2 * times + alike(3, 0.8)[times.argsort().argsort()]
    values[5:9] = torch.nan

    def model(theta):
        return theta["a"][:, None] + theta["b"][:, None] * times

    data = tb.Measurement(values, sigma, times, name="laser", noise="ar1")
    fit = tb.identify(model, data, {"a": 1.0, "b": 1.0})
    rho = torch.tensor(fit.memory["laser"])
    assert 0.5 < rho < 0.95
    value, theta, covariance = restricted(rho, values, times, sigma is None)
    for beside in (rho - 0.01, rho + 0.01):
        assert restricted(beside, values, times, sigma is None)[0] > value
    assert_close(fit.theta, theta, rtol=1e-6, atol=0)
    assert_close(fit.covariance, covariance, rtol=1e-5, atol=0)


def test_intervals_hold():
    """95 % intervals of a line through noise of correlation 0.8 hold the truth in 88 % or more of
    60 sets (three deviations of such a count below 95 % are 86 %), as independent noise in less
    than 70 %.
    """
    share = {}
    for noise in ("ar1", "white"):
        inside = torch.zeros(2)
        for seed in range(60):
            fit = identified(1 + 2 * T + alike(seed, 0.8), None, noise=noise)
            low, high = fit.interval_without_warning(0.95).unbind(-1)
            inside += (low <= TRUE) & (high >= TRUE)
        share[noise] = inside / 60
    assert (share["ar1"] > 0.88).all(), share
    assert (share["white"] < 0.7).all(), share


def test_channels_have_noise_of_their_own_size():
    values = torch.stack((1 + 2 * T + alike(0, 0.7), 1 + 2 * T + 10 * alike(1, 0.7)), -1)
    data = tb.Measurement(values, times=T, name="laser", noise="ar1")
    fit = tb.identify(
        lambda theta: line(theta)[..., None].expand(-1, N, 2),
        data,
        {"a": 1.0, "b": 1.0},
        noise="channel",
    )
    small, large = fit.noise.values()
    assert 5 < large / small < 20
    assert 0.4 < fit.memory["laser"] < 0.9


def test_of_independent_noise_it_is_as_without():
    values = 1 + 2 * T + alike(0, 0.0)
    ar1, white = identified(values), identified(values, noise="white")
    assert ar1.memory["laser"] < 0.3
    assert_close(ar1.theta, white.theta, rtol=0, atol=0.3 * white.deviation.max().item())


def test_residuals_raise_no_alarm_and_the_rest_goes_on(tmp_path):
    fit = identified(1 + 2 * T + alike(0, 0.8))
    assert fit.doubts == ()
    assert "correlation 0." in fit.summary()
    fit.save(tmp_path / "fit.pt")
    assert tb.Fit.load(tmp_path / "fit.pt").memory == fit.memory
    laplace, profile, bootstrap = (
        fit.interval(0.9, method, repeats=400) for method in ("laplace", "profile", "bootstrap")
    )
    assert_close(profile, laplace, rtol=1e-2, atol=0)
    assert_close(bootstrap, laplace, rtol=0, atol=0.4 * fit.deviation.max().item())
    # what was read, as it was read: residuals are data less the model
    reading = fit.readings[0]
    assert_close(reading.y, line({"a": fit["a"][None], "b": fit["b"][None]})[0])
    misfit = (reading.y - reading.data).square().mean().sqrt() / 0.05
    assert_close(fit.misfit, misfit)


def test_ways_to_derivatives_agree():
    fits = [
        identified(1 + 2 * T + alike(0, 0.8), derivatives=way)
        for way in ("difference", "forward", "adjoint")
    ]
    for fit in fits[1:]:
        assert_close(fit.theta, fits[0].theta, rtol=1e-3, atol=0)
        assert_close(fit.memory["laser"], fits[0].memory["laser"], rtol=1e-2, atol=0)


def test_noise_that_hardly_forgets_stays_below_one():
    fit = identified(1 + 2 * T + 0.05 * torch.linspace(-1, 1, N).sign() * T.sqrt())
    assert 0 < fit.memory["laser"] < LARGEST


def test_repeats_count_as_what_they_are():
    """Eight repeats, each with a slope of its own: the mean slope is known as by eight numbers,
    whatever there is of readings; the offset of each is its own.
    """
    random = torch.Generator().manual_seed(0)
    slopes = 2 + 0.3 * torch.randn(8, generator=random)
    data = {
        f"run {k}": tb.Measurement(k + slope * T + 1e-4 * alike(k, 0.0), 0.05, T, noise="repeats")
        for k, slope in enumerate(slopes.tolist())
    }
    start = {"a": tb.Parameter(1.0, own=True), "b": 1.0}
    fit = tb.identify(line, data, start)
    b = fit.names.index("b")
    assert_close(fit.theta[b], slopes.mean(), rtol=1e-4, atol=0)
    assert_close(fit.deviation[b], slopes.std() / 8**0.5, rtol=1e-4, atol=0)
    assert_close(fit.freedom[b], torch.tensor(7.0))
    # an own offset: as its readings tell it, and as far as the slope moves it
    own = 0.05**2 / N + (0.5 * fit.deviation[b]) ** 2
    assert_close(fit.deviation[0], own.sqrt(), rtol=1e-3, atol=0)


def test_refusals():
    with pytest.raises(ValueError, match="two that repeat each other"):
        tb.identify(line, tb.Measurement(T, 0.1, T, noise="repeats"), {"a": 1.0, "b": 1.0})
    with pytest.raises(ValueError, match="two have one time"):
        tb.Measurement(T, 0.1, torch.zeros(N), noise="ar1")
    with pytest.raises(ValueError, match="whose blocks count squares"):
        tb.Measurement(T, 0.1, T, noise="blocks", loss="huber")
    with pytest.raises(ValueError, match="count on normal noise"):
        tb.identify_fields(
            lambda p: p["f"],
            tb.Measurement(T, 0.1, T, noise="ar1"),
            {"f": torch.zeros(N)},
            {"f": tb.Smoothness(2)},
        )
    data = {k: tb.Measurement(T, 0.05, T, noise="repeats") for k in "ab"}
    fit = tb.identify(line, data, {"a": 1.0, "b": 1.0})
    with pytest.raises(ValueError, match="noise='repeats' was asked for"):
        fit.bootstrap(10)
