"""Every case of the verification table within its bound, and the command that writes it."""

import csv
import json
from importlib import resources
from pathlib import Path

import pytest

from torchbeam.verify import CASES, main, run


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}: {case.quantity}")
def test_case(case):
    """The bound and its reason stand with the case; it is not a tenth wider than need be where it is the mesh's own error."""
    result = run(case)
    assert result.error <= case.bound, f"{result.ours} where {result.reference} is wanted: {case.why}"
    if case.why.startswith("elements are of second order"):
        assert result.error >= 0.7 * case.bound, f"{result.error:.2e}: the bound {case.bound:.1e} is too wide"


def test_every_reference_file_is_used():
    """The copies in the package are the tests' own."""
    here, there = Path(__file__).parent / "reference", resources.files("torchbeam") / "data"
    files = {path.name for path in here.glob("*.json")}
    assert files <= {path.name for path in there.iterdir()}
    assert all((here / name).read_text() == (there / name).read_text() for name in files)


def test_command(tmp_path, capsys):
    assert main(["--filter", "Greenhill", "--out", str(tmp_path)]) == 0
    (row,) = json.loads((tmp_path / "verify.json").read_text())["results"]
    assert row["ok"] and row["reference"] == 7.8373
    assert len(list(csv.reader((tmp_path / "verify.csv").open()))) == 2
    table = (tmp_path / "verify.md").read_text()
    assert "| column under its own weight | Greenhill 1881" in table and table in capsys.readouterr().out
