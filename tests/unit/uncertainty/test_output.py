"""Output: tables hold the samples, files hold what the statistics say."""

import csv
import json
import sys

import pytest
import torch

import torchbeam as tb

LAWS = {"a": (0.0, 1.0), "f": tb.laws.RandomField([0.0, 1.0], 1.0, 0.1, 1.0)}


def function(theta):
    return torch.stack((theta[:, 0], torch.where(theta[:, 0] > 0.9, torch.nan, theta[:, 1])), -1)


@pytest.fixture(scope="module")
def samples():
    return tb.monte_carlo(function, LAWS, 256, replicates=8)


def test_pandas(samples):
    pytest.importorskip("pandas")
    table = samples.to_pandas()
    assert (
        list(table.columns) == ["a", "f[0]", "f[1]", "y[0]", "y[1]", "status", "replicate"]
        and len(table) == 256
    )
    assert (torch.from_numpy(table["y[0]"].to_numpy().copy()) == samples.y[:, 0]).all()
    assert (
        table["replicate"].value_counts().tolist() == [32] * 8
        and (table["status"] != 0).sum() == samples.failed
    )
    assert list(tb.monte_carlo(lambda theta: theta[:, 0], LAWS, 8).to_pandas().columns)[3] == "y"


def test_names_of_other_columns():
    """A law that is called as another column would be lost."""
    pytest.importorskip("pandas")
    with pytest.raises(ValueError, match="a law called 'status' were given"):
        tb.monte_carlo(lambda theta: theta[:, 0], {"status": (0.0, 1.0)}, 8).to_pandas()


def test_xarray(samples):
    pytest.importorskip("xarray")
    data = samples.to_xarray(dims=("time",), coords={"time": torch.tensor([0.0, 0.5])})
    assert data["y"].dims == ("sample", "time") and data["time"].values.tolist() == [0.0, 0.5]
    assert (torch.from_numpy(data["f[1]"].values) == samples.theta[:, 2]).all()
    assert samples.to_xarray()["y"].dims == ("sample", "axis_1")
    with pytest.raises(ValueError, match="a name for each axis"):
        samples.to_xarray(dims=())
    for coords in (3, {"a": [0.0, 1.0]}):
        with pytest.raises(
            ValueError,
            match=r"coords = .* were given; a dict, name -> places, of other names than a, f\[0\]",
        ):
            samples.to_xarray(coords=coords)


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_extra_missing(samples, name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=rf"{name} is wanted: pip install 'torchbeam\[uq\]'"):
        getattr(samples, f"to_{name}")()


def test_summary(samples, tmp_path):
    """JSON and CSV: the same numbers as the statistics'; a bound that is not there is null."""
    path = samples.write_summary(tmp_path / "summary.json", levels=(0.5, 0.999), interval=0.9)
    found = json.loads(path.read_text())
    assert (
        found["samples"] == 256
        and found["failed"] == samples.failed
        and found["reasons"] == samples.reasons
    )
    rows = {(row["quantity"], row["y"]): row for row in found["statistics"]}
    mean = samples.mean_interval(0.9)
    assert [rows["mean", "y[1]"][key] for key in ("estimate", "low", "high", "level")] == [
        *(x[1].item() for x in mean),
        0.9,
    ]
    assert (
        rows["quantile 0.999", "y[0]"]["high"] is None
        and rows["quantile 0.5", "y[0]"]["high"] is not None
    )
    with open(samples.write_summary(tmp_path / "new" / "summary.csv", levels=(0.5,))) as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 6 and float(lines[0]["estimate"]) == pytest.approx(samples.mean[0].item())
    stream = tb.monte_carlo_stream(function, LAWS, 256, replicates=8)
    assert stream.summary()["statistics"][0]["estimate"] == pytest.approx(samples.mean[0].item())
    assert (
        json.loads(stream.write_summary(tmp_path / "stream.json").read_text())["failed"]
        == samples.failed
    )
    with pytest.raises(ValueError, match=r"'summary.txt' was given; one that ends in"):
        samples.write_summary(tmp_path / "summary.txt")
