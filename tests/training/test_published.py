"""Published tasks: their metric against sums written out, and the table from files of runs."""

import argparse
import json

import pytest
import torch

from training import published, results, tuned
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
    """Five seeds of one task, one of another, one of an older release without the metric, a
    controller that learns nothing, and a run of no published task: rows with an interval where
    there are as many as that takes, lines of JSON, files, curves.
    """
    runs = tmp_path / "runs"
    runs.mkdir()
    made = [("ik", "student", seed, 100.0 + 10 * seed) for seed in range(5)]
    made += [
        ("obstacles", "shac", 0, 30.0),
        ("reach", "shac", 0, -3.0),
        ("follow", "shac", 0, None),
    ]
    for task, learner, seed, value in [*made, ("reach-pose", "resolved-rate", None, 2100.0)]:
        run = {"task": task, "algorithm": learner, "seed": seed, "return": 5.0, "success": 0.5}
        run |= {"discounted_mean": value} if seed is not None and value else {}
        run |= {"return": value} if seed is None else {}
        run |= dict(seconds=None if seed is None else 10.0, steps=0 if seed is None else 1000)
        name = f"{task}-{learner}" + ("" if seed is None else f"-{seed}")
        (runs / f"{name}.json").write_text(json.dumps(run))
        log = "steps,seconds,validation_return\n0,0,-50\n500,4,0\n1000,9,5\n"
        (runs / f"{name}.csv").write_text(log)
    assert published.main(["--table", "--out", str(tmp_path)]) == 0
    lines = map(json.loads, capsys.readouterr().out.splitlines())
    follow, ik, obstacles, pose = lines
    assert (ik["task"], ik["mean"], ik["seeds"], ik["published"]) == ("ik", 120.0, 5, 197.4)
    assert 100 < ik["low"] < 120 < ik["high"] < 140
    assert obstacles["seeds"] == 1 and obstacles["low"] is None
    assert (follow["mean"], follow["published"], follow["return"]) == (None, None, 5.0)
    assert (pose["metric"], pose["mean"], pose["seconds"]) == ("return", 2100.0, None)
    rows = json.loads((tmp_path / "published.json").read_text())["rows"]
    assert [row["task"] for row in rows] == ["follow", "ik", "obstacles", "reach-pose"]
    text = (tmp_path / "published.md").read_text()
    assert (
        "| student of ResolvedRate | 120.0 [" in text
        and "| 197.4 | 5.0 | 50 % | 1,000 | 10 CPU s | 0.37 h | 5 |" in text
    )
    assert (tmp_path / "published.png").exists()


def test_what_is_wanted_is_ten_seeds_and_the_controllers():
    """Of what is learned; of what is led alone the controllers, on as many episodes as is said. A
    way is there where nothing is random.
    """
    options = argparse.Namespace(seeds=10, tasks=[*published.PUBLISHED], share=1.0, episodes=256)
    wanted = published.plan(options)
    count: dict[str, dict[str, int]] = {}
    for run in wanted:
        own = count.setdefault(run.task, {})
        own[run.algorithm] = own.get(run.algorithm, 0) + 1
    led = {"zero": 1, "resolved-rate": 1}
    assert count["ik"] == led | {"student": 10}
    assert count["reach-nest"] == led | {"waypoints": 1, "student": 10}
    assert count["obstacles"] == led | {"waypoints": 1, "shac": 10}
    assert count["obstacles-3d"] == led | {"via-point": 1}  # nothing that we tried learns it
    assert wanted[results.Run("obstacles", "shac", 3)][1] == 1
    assert wanted[results.Run("track-target", "zero", None)][1] == 16
    assert {*published.PUBLISHED} == {*tuned.PUBLISHED}
