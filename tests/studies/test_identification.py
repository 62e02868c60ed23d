"""The coverage study: its files, and what the stored ones say; repeats as one batch."""

import json
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from studies import field_coverage
from studies.batched_calls import AT_ONCE, as_one_batch
from studies.identification import CASES, LEVEL, main

STORED = Path(__file__).parents[2] / "docs" / "results" / "identification" / "identification.json"


@pytest.mark.long
def test_quick_run_writes_its_files(tmp_path, capsys):
    assert main(["--quick", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "identification.md").read_text()
    found = json.loads((tmp_path / "identification.json").read_text())
    rows, (field,) = found["rows"], found["fields"]
    assert text.strip() in capsys.readouterr().out
    assert [r["parameter"] for r in rows] == ["EI", "tau", "clamp", "tip"] * 2 and {
        r["repeats"] for r in rows
    } == {4}
    assert len((tmp_path / "identification.csv").read_text().splitlines()) == 9
    assert all(r["converged"] == 4 and r["error"] < 4 for r in rows)
    assert (
        field["repeats"] == field["settled"] == 4
        and field["error"] < 4
        and 3 < field["determined"] < field_coverage.ELEMENTS
    )


def test_repeats_are_one_batch():
    """Newton's iterations for roots, each repeat as many as it wants: the function is asked once
    for all that are not done, by fifty at most; what it raises goes through.
    """
    sizes = []

    def square(x):
        sizes.append(len(x))
        return x.square()

    def root(a, calls):
        x = torch.ones(1)
        while (calls(square, x) - a).abs() > 1e-12 * a:
            x = x - (calls(square, x) - a) / (2 * x)
        return x

    a = torch.linspace(1.0, 100.0, AT_ONCE + 3)
    assert_close(torch.cat(list(as_one_batch(root, a))), a.sqrt(), rtol=1e-12, atol=0)
    assert sizes[0] == AT_ONCE and sum(sizes) > 5 * len(a) and len(sizes) < 60

    def refuse(x):
        raise ValueError("no root")

    with pytest.raises(ValueError, match="no root"):
        list(as_one_batch(lambda a, calls: calls(refuse, a), a[:2, None]))


def test_stated_intervals_hold_the_truth():
    """95 % intervals of models that are right, or refined, with a clock that is known or a
    parameter: 92 to 98 % of all parameters of a case of 200 repeats, and each parameter's own share
    within three deviations of what so many repeats know.
    """
    rows = json.loads(STORED.read_text())["rows"]
    wrong = {
        c.name
        for c in CASES
        if (c.mesh[0] > 6 and not c.refined) or (c.clock and not c.known_clock)
    }
    good = [r for r in rows if r["case"] not in wrong]
    assert len(good) >= 17
    for r in good:
        assert abs(r["coverage"] - LEVEL) <= 3 * (LEVEL * (1 - LEVEL) / r["converged"]) ** 0.5, r
    for name in {r["case"] for r in good if r["repeats"] >= 200}:
        some = [r["coverage"] for r in good if r["case"] == name and r["method"] == "laplace"]
        assert 0.92 <= sum(some) / len(some) <= 0.98, name


def test_stated_intervals_of_fields_hold_the_truth():
    """95 % intervals of 200 smooth fields: 92 to 98 % of all elements, and each element's own
    within three deviations of what so many repeats know. Of dents, which the prior does not expect:
    no less where rows are sharp, in the dent and beside it.
    """
    rows = {r["case"]: r for r in json.loads(STORED.read_text())["fields"]}
    least = LEVEL - 3 * (LEVEL * (1 - LEVEL) / field_coverage.REPEATS) ** 0.5
    assert set(rows) == {case.name for case in field_coverage.CASES}
    assert all(r["repeats"] == r["settled"] == field_coverage.REPEATS for r in rows.values())
    for name in ("smooth, weight found", "smooth, weight and noise found"):
        assert 0.92 <= rows[name]["covered"] <= 0.98 and rows[name]["lowest"] >= least
    sharp, normal = rows["dent, sharp"], rows["dent, normal law"]
    assert min(sharp[part] for part in ("covered", "lowest", "dents", "neighbours")) >= least
    assert sharp["dents"] > normal["dents"] and sharp["determined"] < normal["determined"]
