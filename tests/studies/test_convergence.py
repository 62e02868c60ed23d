"""The study of converge: which scenes it asks, what it tells, how it goes on."""

import csv
import json
import math

import pytest

from studies import convergence
from studies.convergence import ConvergedScene, kinds, main, question, report


def row(scene, rtol, **changed):
    values = dict(
        scene=scene, family="sudden", kind="motion", read="tip", rtol=rtol,
        setting="6 linked elements", estimated=rtol / 2, error=rtol / 3, seconds=0.01, setup=0.5,
        best="4 linked elements", ratio=1.5, runs=5, search=6.0, converged=True,
    )  # fmt: skip
    return ConvergedScene(**values | changed)


def test_it_goes_on_where_it_was_cut_off(tmp_path, monkeypatch, capsys):
    """Scenes that are there are not measured again, of the same seed."""
    asked = []

    def measure(number, rtol, exhaustive, seed):
        asked.append((number, rtol, exhaustive))
        return row(number, rtol)

    monkeypatch.setattr(convergence, "measure", measure)
    main(["--out", str(tmp_path), "--scenes", "2"])
    main(["--out", str(tmp_path), "--scenes", "4", "--resume"])
    assert asked == [(k, rtol, k % 3 == 0) for k in range(4) for rtol in (1e-2, 1e-3)]
    with open(tmp_path / "convergence.csv") as file:
        assert len(list(csv.DictReader(file))) == 8
    assert json.loads((tmp_path / "convergence.json").read_text())["seed"] == convergence.SEED
    main(["--out", str(tmp_path), "--scenes", "1", "--resume", "--seed", "7"])
    assert len(asked) == 10


def test_misses_are_named():
    """Each that was not accepted, is wrong, dear, or was dear to find; only these."""
    rows = [
        row(0, 1e-2), row(1, 1e-2, error=0.02), row(2, 1e-2, converged=False),
        row(3, 1e-2, ratio=2.5), row(4, 1e-2, search=12.0, ratio=math.nan),
    ]  # fmt: skip
    summary, each = report(rows).split("\n\nMedians")
    assert "| 0.01 | all | 5 | 4 | 4 of 5 | 3 of 4 | 2.00 | 1.5 | 2 of 3 |" in summary
    named = [int(line.split("|")[1]) for line in each.splitlines() if line[2:3].isdigit()]
    assert named == [1, 2, 3, 4]
    assert "Medians" not in report(rows[:1])


@pytest.mark.parametrize("number", [k for k, (_, kind) in enumerate(kinds()) if kind == "modes"])
def test_frequencies_are_three(number):
    """Without those of rigid motions."""
    asked = question(number, 1)
    frequency = asked.read(asked.solve(asked.scene))
    assert frequency.shape == (1, 3) and (frequency > 0).all()
