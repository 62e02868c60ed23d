"""Fit: summary, file, hints, progress, refinement."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.wave_cases import CLEAN, NOISE, T, wave
from torchbeam.analysis.identification.hints import unit_hints
from torchbeam.analysis.identification.readings import Readings


def test_a_summary_and_a_file(tmp_path):
    fit = tb.identify(
        {"one": wave},
        {"one": tb.Measurement(CLEAN + NOISE, 0.05, T, offset=True)},
        {"a": 1.0, "b": 1.0},
    )
    text = fit.summary()
    for part in (
        "parameter",
        "95 % interval",
        "one.offset",
        "misfit (RMS)",
        "sigma of 40 data, 3 parameters",
        "converged in",
    ):
        assert part in text
    fit.save(tmp_path / "fit.pt")
    back = tb.Fit.load(tmp_path / "fit.pt")
    assert back.summary() == text and repr(back) == repr(fit)
    assert_close(back.interval(0.8), fit.interval(0.8))
    assert_close(back["b"], fit["b"])
    assert_close(back.readings[0].y, fit.readings[0].y)
    with pytest.raises(ValueError, match="a profile of a fit from a file"):
        back.profile()
    (tmp_path / "other.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"other\.pt' was given, which is no saved fit"):
        tb.Fit.load(tmp_path / "other.pt")
    whole = torch.load(tmp_path / "fit.pt", weights_only=True)
    less = {name: x for name, x in whole.items() if name != "theta"}
    for content in ({"torchbeam fit": 2}, less, {**whole, "later": 1}, {**whole, "readings": 3}):
        torch.save(content, tmp_path / "other.pt")
        with pytest.raises(ValueError, match=r"other\.pt' was given, which holds no fit of this"):
            tb.Fit.load(tmp_path / "other.pt")


def test_hints():
    """Units, a misfit above sigma, residuals that are alike; none of them where all is well."""
    start = {"a": 1.0, "b": 1.0}
    with pytest.warns(UserWarning, match="is a unit off by 1000") as told:
        fit = tb.identify(wave, 1000 * CLEAN, start)
    assert told[0].filename == __file__
    assert (
        "times the model's at the start" in fit.hints[0] and "off by\n  1000 (mm" in fit.summary()
    )
    with pytest.warns(UserWarning, match="is a unit off by 1000"):
        fit = tb.identify(wave, 1e-3 * CLEAN, start)
    assert "times the data's" in fit.hints[0]
    fit = tb.identify(wave, tb.Measurement(CLEAN + 0.3 * torch.sin(6 * T), 0.05, T), start)
    assert (
        "times what sigma says" in fit.hints[0]
        and "residuals of neighbouring readings are alike" in fit.hints[1]
    )
    assert tb.identify(wave, tb.Measurement(CLEAN + NOISE, 0.05, T), start).hints == ()


def test_a_line_of_progress(capsys):
    pytest.importorskip("tqdm")
    tb.identify(wave, CLEAN, {"a": 1.0, "b": 1.0}, progress=True)
    assert "identify: 100%" in capsys.readouterr().err


def test_a_fit_refined_by_a_finer_model():
    """The fit of one model carried over to another: where a search with that ends, to a hundredth
    of a deviation, at one sample an evaluation; a model that has little to do with it is refused.
    """
    asked = []

    def finer(theta):
        asked.append(len(theta["a"]))
        return wave(theta) * (1 + 0.02 * T)

    start = {"a": tb.Parameter(1.0, "log"), "b": tb.Parameter(1.0, "log")}
    data = tb.Measurement(CLEAN + NOISE, 0.05, T, offset=True)
    fit = tb.identify(wave, data, start).refined(finer)
    assert set(asked) == {1} and len(asked) < 12 and fit.status == 0
    direct = tb.identify(finer, data, start)
    assert ((fit.theta - direct.theta).abs() < 0.02 * direct.deviation).all()
    assert_close(fit.y, direct.y, rtol=0, atol=1e-3)
    assert_close(fit.deviation, direct.deviation, rtol=0.1, atol=0)
    with pytest.raises(ValueError, match="differs too much"):
        fit.refined(lambda theta: -3 * wave(theta))
    with pytest.raises(ValueError, match="models of x were given; those of None are wanted"):
        fit.refined({"x": finer})


def test_a_fit_at_a_bound_is_refined_along_it():
    """b is held where the coarse fit left it; a goes to the finer model's best for that b, linear
    least squares.
    """
    start = {"a": 1.0, "b": tb.Parameter(0.2, bounds=(0.0, 0.5))}
    fit = tb.identify(wave, CLEAN + NOISE, start, sigma=0.05).refined(
        lambda theta: 0.98 * wave(theta)
    )
    shape = 0.98 * torch.exp(-0.5 * T)
    assert fit.status == 0 and fit["b"] == 0.5
    # a hundredth of a deviation
    assert_close(fit["a"], shape @ (CLEAN + NOISE) / (shape @ shape), rtol=1e-3, atol=0)


@pytest.mark.parametrize(("factor", "unit"), [(180 / math.pi, "degrees"), (1 / 9.80665, "g for m")])
def test_a_unit_of_a_fit_that_fails(factor, unit):
    """Degrees and g are asked for where a fit has not converged, and not where it has."""
    data = factor * CLEAN[:, None]
    reading = Readings(None, ("y",), None, data, CLEAN[:, None], None)
    (said,) = unit_hints([reading], [False], False)
    assert unit in said and "is a unit off by" in said
    assert unit_hints([reading], [False], True) == ()
