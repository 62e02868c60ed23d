"""Parameters: by name, of any shape, their coordinates and bounds, drawn starts."""

import math

import pytest
import torch
from torch.distributions import Beta, HalfNormal, Uniform
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, NOISE, T, wave
from torchbeam.analysis.identification.parameters import Parameters


def test_parameters_by_name():
    """Numbers and tensors of any shape, each with its own coordinate; `fit[name]` has its shape."""

    def model(theta):
        assert theta["c"].shape[1:] == (2, 3) and theta["a"].ndim == 1
        return torch.cat(
            (theta["c"].flatten(1), theta["a"][:, None] * theta["b"][:, None], theta["b"][:, None]),
            -1,
        )

    data = torch.tensor([1.0, -2, 3, -4, 5, 6, 2.0, 0.25])
    start = {
        "a": tb.Parameter(1.0, "log"),
        "c": torch.zeros(2, 3),
        "b": tb.Parameter(0.5, "logit", bounds=(0, 1)),
    }
    fit = tb.identify(model, data, start)
    assert fit.names == ("a", *(f"c[{i}]" for i in range(6)), "b") and fit.status == 0
    assert_close(fit["c"], data[:6].reshape(2, 3), rtol=1e-6, atol=1e-9)
    assert_close(torch.stack((fit["a"], fit["b"])), torch.tensor([8.0, 0.25]), rtol=1e-6, atol=0)
    assert fit["c[1]"] == fit["c"][0, 1]


def test_logit_stays_inside():
    """Data that pull a parameter to its bound: it ran away to it, and nothing on the way is
    beyond.
    """
    fit = tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, "logit", bounds=(0.0, 0.5))})
    assert (fit.history[..., 1] < 0.5).all() and fit["b"] > 0.499
    plain = tb.identify(wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))})
    logarithm = tb.identify(
        wave, CLEAN, {"a": 1.0, "b": tb.Parameter(0.2, "log", bounds=(0.01, 0.5))}
    )
    for one in (plain, logarithm):
        assert_close(one["b"].item(), 0.5, rtol=1e-12, atol=0)
        assert "b is at its bound, 0.5" in one.message
    assert_close(plain["a"], fit["a"], rtol=1e-2, atol=0)


def test_a_bound_is_gone_along():
    """With b held at its bound, a is the best for that b: linear least squares."""
    fit = tb.identify(wave, CLEAN, {"a": 5.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))})
    shape = torch.exp(-0.5 * T)
    assert_close(fit["a"], (shape @ CLEAN) / (shape @ shape), rtol=1e-6, atol=0)


def test_starts_are_drawn():
    """Within the factor, the first as given; of many, those that fit best are followed, and the
    others looked at once; finished starts are not evaluated again.
    """
    sizes = []

    def model(theta):
        sizes.append(len(theta["b"]))
        return wave(theta)

    start = {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}
    fit = tb.identify(model, CLEAN, start, starts=100, spread=5.0, follow=10)
    first = fit.history[0]
    assert (
        first.shape == (100, 2)
        and (first[0] == 1).all()
        and first.min() >= 0.2
        and first.max() <= 5.0
    )
    # evenly spread, in logarithms
    assert first.log().std(0).min() > 0.8 * math.log(5) / math.sqrt(3)
    assert (fit.statuses == 5).sum() == 90 and (fit.statuses == 0).sum() == 10
    assert (
        sum(sizes) < 100 + 10 * 5 * 20
        and fit.misfits[fit.statuses == 5].min() >= fit.misfits[fit.statuses == 0].max()
    )
    assert_close(
        fit.starts[fit.statuses == 0], torch.tensor([2.0, 0.7]).expand(10, 2), rtol=1e-5, atol=0
    )


def test_starts_from_zero_want_a_size():
    """Without one all starts would be the same one."""
    with pytest.raises(ValueError, match=r"starts = 4 were asked for with b from 0 on"):
        tb.identify(wave, CLEAN, {"a": 1.0, "b": 0.0}, starts=4)


# parameter -> least and largest start, and whether they are drawn evenly by the logarithm
LIMITED = {
    "log between bounds": (tb.Parameter(1.0, "log", bounds=(0.01, 2.0)), 0.01, 2.0, True),
    "log below a bound": (tb.Parameter(1.0, "log", bounds=(0.0, 2.0)), 0.2, 2.0, True),
    "between bounds": (tb.Parameter(1.0, bounds=(-3.0, 2.0)), -3.0, 2.0, False),
    "above a bound": (tb.Parameter(1.0, bounds=(0.5, math.inf)), 0.5, 5.0, True),
    "of a sign": (tb.Parameter(-1.0, bounds=(-math.inf, -0.5)), -5.0, -0.5, True),
    "from zero": (tb.Parameter(0.0, scale=2.0, bounds=(-1.0, math.inf)), -1.0, 2.0, False),
    "uniform": (tb.Parameter(0.4, prior=Uniform(0.3, 0.5)), 0.3, 0.5, False),
    "beta, log": (tb.Parameter(0.9, "log", prior=Beta(2.0, 2.0)), 0.18, 1.0, True),
    "truncated": (tb.Parameter(1.0, prior=HalfNormal(1.0)), 0.2, 5.0, True),
}


@pytest.mark.parametrize("name", LIMITED)
def test_starts_are_drawn_within_limits(name):
    """None is cut: between bounds and the ends of a prior's support, evenly in the coordinate, in
    each tenth as many.
    """
    one, least, largest, by_log = LIMITED[name]
    entries = {"a": one, "other": 1.0}
    drawn = (
        Parameters.of(entries, False, None, None, [], torch.zeros(3))
        .more_starts(1025, 5.0, 0)
        .start[1:, 0]
    )
    assert one.prior is None or torch.isfinite(one.prior.log_prob(drawn)).all()
    a, b, values = (
        (torch.as_tensor(v).abs().log() if by_log else torch.as_tensor(v))
        for v in (least, largest, drawn)
    )
    share = ((values - a) / (b - a)).clamp(0, 1 - 1e-12)
    assert_close(
        torch.bincount((10 * share).long(), minlength=10) / 1024,
        torch.full((10,), 0.1),
        rtol=0,
        atol=0.01,
    )
    assert share.max() > 0.98 and share.min() < 0.02


def test_a_model_that_ignores_a_parameter():
    fit = tb.identify(wave, CLEAN, {"a": 1.0, "b": 1.0, "c": tb.Parameter(2.0, "log")})
    assert fit.status == 3 and fit.unidentifiable == ("the misfit does not change with c (here 2)",)
    fit, two = (
        tb.identify(wave, CLEAN + NOISE, {"a": 1.0, "b": 1.0, **more}) for more in ({"c": 2.0}, {})
    )
    assert_close(fit.interval()[:2], two.interval(), rtol=0.02, atol=0)  # a degree of freedom of 38
    assert_close(fit.interval()[2], torch.tensor([-math.inf, math.inf])) and torch.isfinite(
        fit.freedom
    ).all()
