"""Pictures of an identification: they hold the fit's numbers."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

pytest.importorskip("matplotlib")
T = torch.linspace(0, 1, 30)
NOISE = 0.1 * torch.randn(30, 2, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def fit():
    """A line and its double in time, in no order, and a number; one parameter has no say."""

    def model(theta):
        line = theta["a"][:, None] + theta["b"][:, None] * T.flip(0)
        return [torch.stack((line, 2 * line), -1), theta["b"] + 0 * theta["c"]]

    line = 1 + 2 * T.flip(0)
    record = tb.Measurement(torch.stack((line, 2 * line), -1) + NOISE, 0.1, T.flip(0), name="gauge")
    return tb.identify(model, [record, tb.Measurement(2.0, 0.5)], {"a": 0.5, "b": 1.0, "c": 1.0})


def test_fit_and_residuals(fit, tmp_path):
    """Two channels over time above their residuals, in the order of time; the single number is left
    out.
    """
    axes = tb.plot.fit(fit)
    assert len(axes) == 4 and [a.get_title() for a in axes[:2]] == ["gauge 0", "gauge 1"]
    order = fit.readings[0].times.argsort()
    for k in (0, 1):
        y, data = (v[order, k] for v in (fit.y[0], fit.readings[0].data))
        dots, line = axes[k].lines
        assert_close(torch.from_numpy(np.asarray(dots.get_ydata())), data)
        assert_close(torch.from_numpy(np.asarray(line.get_ydata())), y)
        assert_close(torch.from_numpy(np.asarray(axes[2 + k].lines[0].get_ydata())), data - y)
        band = axes[k].collections[0].get_paths()[0].vertices[:, 1]
        # noise, and what the parameters leave open
        assert 1.96 * 0.1 < band.max() - y.max() < 1.96 * 0.15
    assert tb.plot.save(axes[0], tmp_path / "fit.png").stat().st_size > 5000


def test_correlation(fit):
    """Numbers of what is told; the parameter that has no say is left grey."""
    ax = tb.plot.correlation(fit)
    image = np.ma.filled(ax.images[0].get_array(), np.nan)
    assert_close(torch.from_numpy(image[:2, :2]), fit.correlation[:2, :2])
    assert np.isnan(image[2]).all() and len(ax.texts) == 4
    assert [label.get_text() for label in ax.get_xticklabels()] == ["a", "b", "c"]


def test_profile(fit):
    (one,) = fit.profile("b")
    ax = tb.plot.profile(one)
    assert_close(torch.from_numpy(ax.lines[0].get_xdata()), one.values)
    assert_close(torch.from_numpy(ax.lines[0].get_ydata()), one.rise)
    assert [line.get_xdata()[0] for line in ax.lines[1:3]] == one.interval.tolist()
    assert ax.get_xlabel() == "b"


def test_single_readings_have_no_curve():
    fit = tb.identify(lambda theta: theta["b"], 2.0, {"b": 1.0}, sigma=0.1)
    with pytest.raises(ValueError, match="a fit to single readings was given"):
        tb.plot.fit(fit)


def test_the_band_of_sigma_that_only_weighs():
    """Residuals' band: 1.96 of the noise that the misfit says over T - 1 degrees of freedom,
    whatever factor sigma has.
    """
    for sigma in (None, 7.0):
        one = tb.identify(
            lambda theta: theta["b"][:, None] * T, 2 * T + NOISE[:, 0], {"b": 1.0}, sigma=sigma,
            absolute_sigma=False,
        )  # fmt: skip
        band = tb.plot.fit(one)[1].collections[0].get_paths()[0].vertices[:, 1].max()
        squares = (one.y - 2 * T - NOISE[:, 0]).square().sum()
        assert band == pytest.approx(1.96 * (squares / (len(T) - 1)).sqrt().item())
