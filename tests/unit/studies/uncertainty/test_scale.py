"""Cost of samples: what is counted, with a hundred samples."""

import json

import pytest
import torch

from torchbeam.studies.uncertainty import scale
from torchbeam.studies.uncertainty.scale import LAWS, Row, main, rollout, run, static


def test_functions():
    """The strip bends as P/(3 EI) under small loads; a sudden load swings to nearly twice that."""
    EI, P = torch.tensor([1.0, 2.0]), torch.tensor([1e-3, 1e-3])
    w, status = static(EI, P)
    assert (status == 0).all() and w.tolist() == pytest.approx([1e-3 / 3, 1e-3 / 6], rel=0.02)
    swing, status = rollout(EI, P)
    assert (status == 0).all() and (swing / w).tolist() == pytest.approx([1.7, 1.7], abs=0.25)


def test_rows():
    """Samples of a folder take what their numbers take: theta, y and status, 32 bytes, and what a file adds."""
    row = run("static", "folder", 320, 160, 1)
    assert row.samples == 320 and row.failed == 0 and 32 < row.disk < 64 and row.cpu > 0 and len(LAWS) == 2
    assert run("static", "stream", 320, 160, 1).cells()[-1] == "-"


def test_command(tmp_path, monkeypatch):
    """Rows of both, by chunk size and to the end, with the fastest chunk."""
    made = []

    def fake(what, kind, samples, chunk, processes):
        made.append((what, kind, processes, chunk))
        return Row(what, kind, processes, chunk, samples, 1000.0 / chunk, 1.0, 0, 0.0, 32.0)

    monkeypatch.setattr(scale, "run", fake)
    main(["--out", str(tmp_path), "--quick"])
    rows = json.loads((tmp_path / "scale.json").read_text())["rows"]
    assert len(rows) == 16 and {row["chunk"] for row in rows if row["run"] == "stream"} == {16384, 4096}
    assert ("rollout", "stream", 1, 4096) in made and "| static | kept |" in (tmp_path / "scale.md").read_text()
