"""Results of the commands: one heading in every file, one sentence of it under every table."""

import json
from pathlib import Path

import pytest
import torch

from studies.rates import main as rates
from torchbeam.core.results import measured_on, sentence, table, write

STORED = Path(__file__).parents[3] / "docs" / "results"
FILES = sorted(STORED.glob("*/*.json"))


def test_heading_says_machine_threads_dtype_and_versions():
    heading, threads = measured_on(), torch.get_num_threads()
    assert list(heading) == ["machine", "cores", "threads", "dtype", "python", "versions"]
    assert heading["threads"] == threads and heading["dtype"] == "float64"
    assert heading["versions"]["torch"].startswith(torch.__version__.split("+")[0])
    text = sentence(heading)
    parts = (
        heading["machine"], f"{threads} thread", "float64", f"torch {heading['versions']['torch']}",
    )  # fmt: skip
    assert all(part in text for part in parts)
    assert "dtype" not in measured_on(dtype=None) and measured_on(threads=4)["threads"] == 4
    assert sentence({"threads": 2, "rows": []}) == "Measured on: 2 threads."


def test_files_hold_what_was_written(tmp_path):
    text = table(("case", "error"), [("a", "1e-3"), ("b", "")], words=1)
    assert text.splitlines() == ["| case | error |", "|---|---:|", "| a | 1e-3 |", "| b |  |"]
    write(tmp_path / "new", "cases", text, {"rows": [1, 2]}, ("case", "error"), [("a", 1e-3)])
    assert (tmp_path / "new" / "cases.md").read_text() == text + "\n"
    assert json.loads((tmp_path / "new" / "cases.json").read_text()) == {"rows": [1, 2]}
    assert (tmp_path / "new" / "cases.csv").read_text().splitlines() == ["case,error", "a,0.001"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_stored_results_have_the_heading(file):
    """Versions and threads are told, and the table beside the numbers ends in the sentence about
    them.
    """
    heading = json.loads(file.read_text())
    assert "torch" in heading["versions"] and heading["threads"] >= 1
    if file.stem != "demo":  # its table is shown with the settings, not timed
        assert file.with_suffix(".md").read_text().strip().endswith(sentence(heading))


def test_rates_command_writes_its_files(tmp_path, capsys):
    """The dense route takes longer than nothing and stands beside the sweep; files agree with what
    is printed.
    """
    assert rates(["--quick", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "rates.json").read_text())
    assert {row["what"] for row in found["rows"]} == {
        "sweep", "minimal", "linalg.solve alone", "dense",
    }  # fmt: skip
    assert all(0 < row["minimum_ms"] <= row["median_ms"] for row in found["rows"])
    assert (tmp_path / "rates.md").read_text() == capsys.readouterr().out
    assert len((tmp_path / "rates.csv").read_text().splitlines()) == 5
