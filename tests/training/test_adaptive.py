"""training/adaptive.py: batches are stored, made again only where they are missing, and put
together.
"""

import json

import pytest
import torch

from training import adaptive, results
from training.evaluate import evaluate, make
from training.tuned import HELD_OUT, TASKS

torch.set_num_threads(1)
TIMES = {"median": 1.0, "most": 2.0, "between": 0.5}
WORDS = ["--tasks", "reach", "--controllers", "bound", "--jobs", "1", "--episodes"]


def test_a_command_that_was_cut_off_goes_on(tmp_path, monkeypatch):
    """Batches of 2 of 3 and of 4 episodes, scored by a function of their seeds: what is there is
    not played again, and shares weigh by episodes.
    """
    played = []

    def scored(run, first):
        played.append((first, run.episodes))
        if first == 2 and played.count((2, 1)) == 1 and run.episodes == 1:
            raise RuntimeError("cut off")
        seeds = torch.arange(first, first + run.episodes).double()
        mean = seeds.mean().item()
        return {"return": -mean, "success": mean / 8, "within": 0.5, "ended": run.episodes}

    monkeypatch.setattr(adaptive, "BATCH", 2)
    monkeypatch.setattr(adaptive, "episodes", scored)
    monkeypatch.setattr(adaptive, "decisions", lambda run: TIMES)
    words = [*WORDS, "3", "--out", str(tmp_path)]
    assert adaptive.main(words) == 1 and not (tmp_path / "adaptive.md").exists()
    assert adaptive.main(words) == 0 and played == [(0, 2), (2, 1), (2, 1)]
    (row,) = json.loads((tmp_path / "adaptive.json").read_text())["rows"]
    assert row["total"] == pytest.approx(-1.0) and row["lost"] == 3 and row["most"] == 2.0
    assert adaptive.main([*WORDS, "4", "--out", str(tmp_path)]) == 0 and played[3:] == [(2, 2)]
    assert adaptive.main([*WORDS, "4", "--outside", "--out", str(tmp_path)]) == 0
    assert played[4:] == [(0, 2), (2, 2)]  # another question
    monkeypatch.setattr(adaptive, "code", lambda: "another")
    assert adaptive.main([*WORDS, "4", "--outside", "--out", str(tmp_path)]) == 0
    assert played[6:] == [(0, 2), (2, 2)]  # by other code


def test_batches_are_the_first_held_out_episodes(monkeypatch):
    """By MPC of a short horizon: each batch scores as those episodes of all, to rounding."""
    small = TASKS["reach-uncertain"].varied(elements=2, max_episode_steps=3)
    monkeypatch.setitem(TASKS, "reach-uncertain", small)
    monkeypatch.setitem(adaptive.CONTROLLERS, "bound", lambda env, _: adaptive.MPC(env, horizon=3))
    runs = [adaptive.Run("reach", "bound", first, 2, False) for first in (0, 2)]
    found = [adaptive.episodes(run, run.first)["return"] for run in runs]
    whole = make(small, 4)
    total = evaluate(small, adaptive.MPC(whole, horizon=3), 4, HELD_OUT, whole)["return"]
    assert sum(found) / 2 == pytest.approx(total, abs=1e-9)
    assert found[0] != found[1]


def test_failures_are_told_by_name(tmp_path, capsys):
    """Of any work, in this process."""
    run = adaptive.Run("reach", "bound", 0, 2, False)

    def fails(*_):
        raise ValueError("nothing to see")

    assert results.made(fails, [(run, tmp_path)], 1) == 1
    assert "reach-bound-0 failed: ValueError: nothing to see" in capsys.readouterr().out
    assert "Traceback" in (tmp_path / "reach-bound-0.failed").read_text()
