"""A baseline of a known shape, beside offset and drift."""

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals

T = torch.linspace(0, 1, 40)


def slow(t):
    return torch.log1p(10 * t)


def test_a_baseline_is_found_and_carried_into_a_prediction():
    model = lambda theta: torch.sin(theta["w"][:, None, None] * T[:, None])  # noqa: E731
    data = torch.sin(8 * T) + 0.3 + 0.2 * slow(T)
    gauge = tb.Measurement(data[:, None], 1e-3, T, offset=True, baseline=slow, name="gauge")
    fit = tb.identify(model, gauge, {"w": 7.0})
    torch.testing.assert_close(fit.theta, torch.tensor([8.0, 0.3, 0.2]), rtol=0, atol=1e-6)
    assert fit.names[2] == "baseline of gauge"
    torch.testing.assert_close(fit.y, data[:, None], rtol=0, atol=1e-6)


def test_one_of_another_shape_or_without_times_is_refused():
    with pytest.raises(ValueError, match="without times"):
        tb.Measurement(T, 1.0, baseline=slow)
    odd = tb.Measurement(T, 1.0, T, baseline=lambda t: t[:2])
    with pytest.raises(ValueError, match=r"the same, or \(times, k\), is wanted"):
        tb.identify(lambda p: p["a"][:, None] * T, odd, {"a": 1.0})


def test_slow_baselines_are_all_polynomials_and_splines_that_begin_at_zero():
    """The degree without a constant; beyond the ends along the tangent."""
    for degree in (1, 2, 3):
        rows = tb.SlowBaseline(0.0, 1.0, degree=degree)(T)
        powers = torch.stack([T**k for k in range(1, degree + 1)], -1)
        left = powers - rows @ torch.linalg.lstsq(rows, powers).solution
        assert rows.shape == powers.shape and left.abs().max() < 1e-12
    spline = tb.SlowBaseline(0.0, 1.0, spacing=0.3)  # knots at 1/4, 1/2, 3/4
    rows = spline(T)
    assert rows.shape == (40, 6) and (rows[0] == 0).all()
    kink = torch.relu(T - 0.25) ** 3
    left = kink - rows @ torch.linalg.lstsq(rows, kink[:, None]).solution[:, 0]
    assert left.abs().max() < 1e-12
    one = torch.tensor(1.0)
    ahead = spline(torch.tensor([1.0, 1.5, 2.0]))
    slope = (spline(one[None]) - spline(one[None] - 1e-6))[0] / 1e-6
    torch.testing.assert_close(ahead[1] - ahead[0], ahead[2] - ahead[1])
    torch.testing.assert_close(ahead[1] - ahead[0], 0.5 * slope, rtol=1e-4, atol=1e-4)


def test_a_spline_takes_a_wandering_zero_away_from_a_decay():
    model = lambda p: torch.exp(-p["b"][:, None] * T) * torch.sin(30 * T)  # noqa: E731
    random = torch.Generator().manual_seed(0)
    wander = 0.2 * torch.sin(2 * T) + 0.1 * T**3
    data = model({"b": torch.tensor([1.0])})[0] + wander + 1e-3 * torch.randn(40, generator=random)
    slow = tb.SlowBaseline(0, 1, spacing=0.5)
    gauge = tb.Measurement(data, 1e-3, T, offset=True, baseline=slow, name="gauge")
    fit = tb.identify(model, gauge, {"b": 0.5})
    assert not fit.doubts and (fit.theta[0] - 1).abs() < 3 * fit.deviation[0] < 0.02
    assert fit.names[2] == "baseline[0] of gauge"


@refusals(
    (dict(first=1.0, last=1.0), "a later end is wanted"),
    (dict(first=0.0, last=1.0, spacing=0.0), "200 pieces at most"),
    (dict(first=0.0, last=1.0, degree=0), "degree"),
)
def test_slow_baselines_of_no_length_or_stiffness_are_refused(given):
    tb.SlowBaseline(**given)


def test_a_drift_beside_one_is_refused():
    with pytest.raises(ValueError, match="drift=False is wanted"):
        tb.Measurement(T, 1.0, T, drift=True, baseline=tb.SlowBaseline(0, 1))
