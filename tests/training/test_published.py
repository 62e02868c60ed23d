"""Published tasks: their metric against sums written out, and the table from files of runs."""

import json

import pytest
import torch

from training import published
from training.evaluate import DISCOUNT, discounted


def test_discounted_returns_are_the_sums_written_out():
    """Of an episode of five intervals and one that ends after three: from the start, and the mean
    over all starts of what follows until the end.
    """
    rewards = torch.tensor([[1.0, 2.0], [0.5, -1.0], [2.0, -10.0], [0.0, 0.0], [3.0, 0.0]]).double()
    total, start, mean = discounted(rewards, torch.tensor([5.0, 3.0]).double())
    for i, length in enumerate((5, 3)):
        own = rewards[:length, i].tolist()

        def after(k, own=own):
            return sum(DISCOUNT**j * r for j, r in enumerate(own[k:]))

        assert total[i].item() == pytest.approx(sum(own))
        assert start[i].item() == pytest.approx(after(0))
        assert mean[i].item() == pytest.approx(sum(after(k) for k in range(length)) / length)


def test_the_best_that_can_be_is_the_published_ceiling():
    """2 in each of 500 intervals, 160.7 as the mean over all starts and 198.7 from the first one,
    by the publication's own numbers for 501: to 0.3 %.
    """
    _, start, mean = discounted(torch.full((501, 1), 2.0).double(), torch.tensor([501.0]).double())
    assert (mean.item(), start.item()) == pytest.approx((160.7, 198.7), rel=3e-3)


def test_the_table_is_made_of_the_runs_that_are_there(tmp_path, capsys):
    """Five seeds of one task, one of another, and a run of no published task: rows with an interval
    where there are as many as that takes, lines of JSON, files.
    """
    runs = tmp_path / "runs"
    runs.mkdir()
    made = [("ik", seed, 100.0 + 10 * seed) for seed in range(5)]
    for task, seed, value in [*made, ("obstacles", 0, 30.0), ("reach", 0, -3.0)]:
        numbers = dict(discounted_mean=value, seconds=10.0, steps=1000, success=0.5)
        run = {"task": task, "algorithm": "shac", "seed": seed, "return": 5.0, **numbers}
        (runs / f"{task}-{seed}.json").write_text(json.dumps(run))
    assert published.main(["--table", "--out", str(tmp_path)]) == 0
    ik, obstacles = map(json.loads, capsys.readouterr().out.splitlines())
    assert (ik["task"], ik["mean"], ik["seeds"], ik["published"]) == ("ik", 120.0, 5, 197.4)
    assert 100 < ik["low"] < 120 < ik["high"] < 140
    assert obstacles["seeds"] == 1 and obstacles["low"] is None
    rows = json.loads((tmp_path / "published.json").read_text())["rows"]
    assert [row["task"] for row in rows] == ["ik", "obstacles"]
    assert "| 197.4 | 1,000 | 10 CPU s |" in (tmp_path / "published.md").read_text()
