"""The accuracy command: files, and numbers that do not depend on the batch."""

import csv
import json

from torchbeam.accuracy import main


def test_quick_run_writes_its_files(tmp_path, capsys):
    """N = 8 and 16 at 10 ms: the errors of the common dynamic case are 1.0 and 1.4 % (time error of mode 2 dominates at
    10 ms, and has the sign of the coarse mesh's), the same at batch 1 and 256, below 2 % in all."""
    assert main(["--quick", "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "accuracy.json").read_text())["rows"]
    assert [(r["elements"], r["batch"]) for r in rows] == [(8, 1), (16, 1), (8, 256), (16, 256)]
    assert all(0.005 < r["error"] < 0.02 and r["rate"] > 0 for r in rows)
    assert rows[0]["error"] == rows[2]["error"]
    assert len(list(csv.reader((tmp_path / "accuracy.csv").open()))) == 5
    assert (tmp_path / "accuracy.md").read_text().strip() in capsys.readouterr().out
