"""Pictures of uncertainty: lines and strips stand where the numbers are."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")
LAWS = {"a": (0.0, 1.0), "b": tb.laws.Normal(0.0, 0.1)}


def drawn(ax, path):
    ink = (np.asarray(Image.open(tb.plot.save(ax, path, dpi=60)).convert("L")) < 200).mean()
    assert 0.002 < ink < 0.6, ink


def total(theta):
    return torch.where(theta[:, 0] > 0.95, torch.nan, theta.sum(-1))


@pytest.mark.parametrize("run", [tb.monte_carlo, tb.monte_carlo_stream])
def test_histogram(run, tmp_path):
    """Mean and quantiles with their intervals; the bars' area is 1; failures are told."""
    samples = run(total, LAWS, 2048, replicates=16)
    ax = tb.plot.histogram(samples, levels=(0.05, 0.95), name="w / m")
    drawn(ax, tmp_path / "histogram.png")
    x = [line.get_xdata()[0] for line in ax.lines]
    assert_close(
        torch.tensor(x),
        torch.cat((samples.mean[None], samples.quantile((0.05, 0.95)))),
        rtol=1e-9,
        atol=0,
    )
    if run is tb.monte_carlo:
        strips = [(p.get_x(), p.get_x() + p.get_width()) for p in ax.patches[60:]]
        assert strips[0] == pytest.approx([v.item() for v in list(samples.mean_interval())[1:]])
        assert sum(p.get_width() * p.get_height() for p in ax.patches[:60]) == pytest.approx(1)
    assert any("failed" in text.get_text() for text in ax.texts) and ax.get_xlabel() == "w / m"


def test_histogram_of_one_value():
    """Of a stream and of samples: a bar about the value."""
    for run in (tb.monte_carlo, tb.monte_carlo_stream):
        ax = tb.plot.histogram(
            run(lambda theta: 0 * theta[:, 0] + 2, {"u": (0.0, 1.0)}, 64, replicates=16), bins=10
        )
        low, high = ax.get_xlim()
        assert low < 2 < high and ax.get_ylim()[1] >= 9


def test_convergence(tmp_path):
    """Slopes are in the legend; points are the errors."""
    runs = {
        design: tb.monte_carlo(
            lambda theta: theta.sum(-1), LAWS, 4096, design=design, replicates=16
        )
        for design in ("plain", "sobol")
    }
    ax = tb.plot.convergence(runs, 0.5)
    drawn(ax, tmp_path / "convergence.png")
    slopes = [float(text.get_text().split()[-1]) for text in ax.get_legend().get_texts()]
    assert -0.8 < slopes[0] < -0.2 and slopes[1] < -0.9
    assert_close(torch.from_numpy(ax.lines[0].get_ydata()), runs["plain"].convergence(0.5)[1])
    alone = tb.plot.convergence(runs["plain"], 0.5)  # the samples themselves
    assert_close(alone.lines[0].get_ydata(), ax.lines[0].get_ydata())


def test_tornado(tmp_path):
    """Bars from the base to both ends, the largest swing on top."""
    table = tb.tornado(lambda theta: theta[:, 0] - 2 * theta[:, 1], LAWS)
    ax = tb.plot.tornado(table, name="w / m")
    drawn(ax, tmp_path / "tornado.png")
    ends = sorted(
        bar.get_x() + bar.get_width() for bar in ax.patches if abs(bar.get_y() + 0.3 - 1) < 1e-9
    )
    assert ends == pytest.approx(sorted([table.low[0].item(), table.high[0].item()]))
    assert [text.get_text() for text in ax.get_yticklabels()] == ["a", "b"]


def test_bands(tmp_path):
    """Median and band over time, six thin lines."""
    t = torch.linspace(0, 1, 11)
    samples = tb.monte_carlo(lambda theta: theta[:, :1] * t, LAWS, 256, replicates=8)
    ax = tb.plot.bands(t, samples, level=0.8)
    drawn(ax, tmp_path / "bands.png")
    assert len(ax.lines) == 7
    assert_close(torch.from_numpy(ax.lines[0].get_ydata()), samples.bands(0.8).estimate[1])
    assert len(tb.plot.bands(t, samples, interval=None).lines) == 1


def test_refused():
    several = tb.monte_carlo(lambda theta: theta, LAWS, 64, replicates=4)
    for call, sentence in (
        (lambda: tb.plot.histogram(several), r"a y \(2,\) was given to histogram"),
        (lambda: tb.plot.convergence({"": several}), r"a y \(2,\) was given to convergence"),
        (
            lambda: tb.plot.tornado(tb.tornado(lambda theta: theta, LAWS)),
            r"a y \(2,\) was given to tornado",
        ),
        (
            lambda: tb.plot.bands(torch.ones(3), several),
            r"t \(3,\) and y \(2,\) were given to bands",
        ),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()
