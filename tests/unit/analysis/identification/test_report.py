"""A fit's page of HTML."""

import re

import pytest
import torch

import torchbeam as tb

T = torch.linspace(0, 1, 30)


@pytest.fixture(scope="module")
def fit():
    def model(theta):
        y = theta["a <1>"][:, None] + theta["b"][:, None] * T
        return torch.stack((y, 2 * y), -1), theta["c"][:, None].expand(-1, 1)

    random = torch.Generator().manual_seed(0)
    noise = 0.05 * torch.randn(30, 2, generator=random)
    values = torch.stack((1 + 2 * T, 2 + 4 * T), -1) + noise + 0.2 * torch.sin(40 * T)[:, None]
    values[3, 0] = torch.nan
    data = [tb.Measurement(values, 0.05, T, name="laser & co"), tb.Measurement([3.0], 0.1)]
    return tb.identify(model, data, {"a <1>": 0.5, "b": 1.0, "c": 1.0})


def test_it_holds_all_of_it(fit, tmp_path):
    later = torch.linspace(1, 2, 9)
    line = fit.theta[0] + fit.theta[1] * later
    predicted = fit.predict(lambda theta: theta["a <1>"][:, None] + theta["b"][:, None] * later)
    measured = torch.where(torch.arange(9) < 6, line, line + 10)
    given = {"held out": (later, predicted, measured), "beyond": (later, predicted)}
    path = fit.report(tmp_path / "deep" / "report.html", level=0.9, predictions=given)
    page = path.read_text()
    assert all(doubt.replace("'", "&#x27;") in page for doubt in
               (one.replace("&", "&amp;") for one in fit.doubts))  # fmt: skip
    assert fit.doubts
    assert "a &lt;1&gt;" in page
    assert "90 % interval" in page
    low, high = fit.interval_without_warning(0.9)[1].tolist()
    assert f"{low:.5g} to {high:.5g}" in page
    assert "laser &amp; co 1" in page
    # of nine readings two thirds are on the line
    assert "Of 9 readings that were measured 67 % lie in them" in page
    assert len(re.findall("data:image/png;base64,", page)) == 4  # a series, correlations, two
    assert not re.findall(r"(src|href)=\"(?!data:)", page)  # nothing from elsewhere


def test_of_a_file_and_of_single_readings(fit, tmp_path):
    fit.save(tmp_path / "fit.pt")
    tb.Fit.load(tmp_path / "fit.pt").report(tmp_path / "one.html")
    single = tb.identify(lambda p: p["a"][:, None], tb.Measurement([3.0], 0.1), {"a": 1.0})
    page = single.report(tmp_path / "two.html").read_text()
    assert "Nothing looks wrong" in page
    assert "data:image" not in page


def test_refusals(fit, tmp_path):
    with pytest.raises(ValueError, match=r"\.html"):
        fit.report(tmp_path / "report.pdf")
    for given in ([1], {"a": 1}, {"a": (T, T)}):
        with pytest.raises(ValueError, match="prediction"):
            fit.report(tmp_path / "report.html", predictions=given)
    predicted = fit.predict(lambda theta: theta["b"][:, None] * T)
    with pytest.raises(ValueError, match="one for each reading is wanted"):
        fit.report(tmp_path / "report.html", predictions={"a": (T[:3], predicted)})
