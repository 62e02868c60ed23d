"""Cost of samples: what is counted, with a hundred samples."""

import json

import pytest
import torch

from studies.uncertainty import scale
from studies.uncertainty.scale import LAWS, ScaleRun, main, rollout, run, static


def test_functions():
    """The strip bends as P/(3 EI) under small loads; a sudden load swings to nearly twice that."""
    EI, P = torch.tensor([1.0, 2.0]), torch.tensor([1e-3, 1e-3])
    w, status = static(EI, P)
    assert (status == 0).all() and w.tolist() == pytest.approx([1e-3 / 3, 1e-3 / 6], rel=0.02)
    swing, status = rollout(EI, P)
    assert (status == 0).all() and (swing / w).tolist() == pytest.approx([1.7, 1.7], abs=0.25)


def test_rows():
    """Samples of a folder take what their numbers take: theta, y and status, 32 bytes, and what a
    file adds.
    """
    row = run("static", "folder", 320, 160, 1)
    assert (
        row.samples == 320
        and row.failed == 0
        and 32 < row.disk < 64
        and row.cpu > 0
        and len(LAWS) == 2
    )
    assert run("static", "stream", 320, 160, 1).cells()[-1] == "-"


def test_command(tmp_path, monkeypatch, capsys):
    """Rows of both, by chunk size and to the end, with the fastest chunk; then those of another
    program, and what all samples would take it. A folder without scripts is refused before anything
    is measured.
    """
    made = []

    def fake(what, kind, samples, chunk, processes):
        made.append((what, kind, processes, chunk))
        return ScaleRun(what, kind, processes, chunk, samples, 1000.0 / chunk, 1.0, 0, 0.0, 32.0)

    monkeypatch.setattr(scale, "run", fake)
    printed = [
        dict(peer="other 1.0", what=what, processes=2, samples=n, seconds=2.0, failed=0, at_means=y)
        for what, n, y in (("static", 1000, 0.30), ("rollout", 100, 0.52))
    ]
    (tmp_path / "peers").mkdir()
    (tmp_path / "peers" / "script.py").write_text(
        "import json, sys\nif __name__ == '__main__' and '--samples' in sys.argv:\n"
        f"    print(*map(json.dumps, {printed}), sep='\\n')\n"
    )
    main(["--out", str(tmp_path), "--quick", "--peers", str(tmp_path / "peers")])
    rows = json.loads((tmp_path / "scale.json").read_text())["rows"]
    assert [(row["run"], row["samples"]) for row in rows[16:]] == [
        ("other 1.0", 1000),
        ("other 1.0", 100),
    ]
    text = (tmp_path / "scale.md").read_text()
    assert (
        (
            "other 1.0, static: 1,000,000 samples would take 2,000 s, extrapolated from 1,000; y "
            "at the means of the laws differs by 0.3 %."
        )
        in text
        and "100,000 samples would take 2,000 s" in text
        and "by 0.5 %" in text
    )
    assert len(rows) == 18 and {row["chunk"] for row in rows if row["run"] == "stream"} == {
        16384,
        4096,
    }
    assert ("rollout", "stream", 1, 4096) in made and "| static | kept |" in (
        tmp_path / "scale.md"
    ).read_text()
    for given, sentence in (
        (["--peers", str(tmp_path)], "one with scripts, as examples/peers is, is wanted"),
        (["--python", "no-such-python"], "a Python interpreter is wanted"),
    ):
        with pytest.raises(SystemExit):
            main(["--out", str(tmp_path), *given])
        assert sentence in capsys.readouterr().err
