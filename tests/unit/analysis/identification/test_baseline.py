"""A baseline of a known shape, beside offset and drift."""

import pytest
import torch

import torchbeam as tb

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
    with pytest.raises(ValueError, match="the same is wanted"):
        tb.Measurement(T, 1.0, T, baseline=lambda t: t[:2]).nuisance()
