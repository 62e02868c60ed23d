"""training/variance.py: both estimates are of one gradient, and the measure of their spread."""

import json

import pytest
import torch

from training import variance
from training.policies import Policy
from training.tuned import TASKS, Task

torch.set_num_threads(1)
TINY = Task(
    "tiny",
    "torchbeam/TipReachPlanar-v1",
    dict(elements=2, substeps=1, max_episode_steps=4, control_interval=0.1),
)


def test_both_estimates_are_of_one_gradient():
    """Two of the three intervals are moved by actions: means of 60 estimates of 32 episodes agree
    within four standard errors along the gradient and across it, the one through the simulation has
    the lesser variance (it has 15 times less), and beyond the end of the episode (4 intervals)
    nothing changes.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        policy = Policy((11, 4, 1), squash=True, activation="elu", deviation=0.3)
    found = variance.gradients(TINY, policy, 3, 60, 32)
    mean = found["simulation"].mean(0)
    for direction in (mean, mean.flip(0)):
        direction = direction / direction.norm()
        along = {name: rows @ direction for name, rows in found.items()}
        error = sum(x.var() / len(x) for x in along.values()).sqrt()
        assert abs(along["simulation"].mean() - along["likelihood"].mean()) < 4 * error
    along = found["likelihood"] @ mean / mean.norm()
    assert along.mean() > 4 * along.std() / len(along) ** 0.5  # it is not lost in noise
    spread = variance.spread(found)
    assert spread["likelihood"]["relative"] > 5 * spread["simulation"]["relative"]
    short, long = (variance.gradients(TINY, policy, k, 2, 4)["simulation"] for k in (4, 6))
    assert torch.equal(short, long)


def test_spread_by_hand():
    """Of 1 +- 1 and of 1 +- 3 in one parameter; the square of the mean is less by a half."""
    rows = {"simulation": torch.tensor([[0.0], [2.0]]), "likelihood": torch.tensor([[-2.0], [4.0]])}
    found = variance.spread(rows)
    assert found["simulation"] == {"variance": 2.0, "relative": None}
    rows = {name: torch.cat((row, row)) for name, row in rows.items()}
    found = variance.spread(rows)
    square = 1 - 4 / 3 / 4
    assert found["simulation"]["relative"] == pytest.approx(4 / 3 / square)
    assert found["likelihood"]["relative"] == pytest.approx(12 / square)


def test_command(tmp_path, monkeypatch):
    monkeypatch.setitem(TASKS, "tiny", TINY)
    monkeypatch.setattr(variance, "HORIZONS", (1, 3))
    monkeypatch.setattr(variance, "POLICIES", {"untrained": 0, "trained": 1})
    given = ["--tasks", "tiny", "--repeats", "3", "--episodes", "2", "--out", str(tmp_path)]
    assert variance.main(given) == 0
    rows = json.loads((tmp_path / "variance.json").read_text())["rows"]
    assert len(rows) == 2 * 2 * 2 and all(row["variance"] >= 0 for row in rows)
    lines = (tmp_path / "variance.md").read_text().splitlines()
    assert sum(line.startswith("| tiny |") for line in lines) == len(rows) / 2
    assert (tmp_path / "variance.png").exists()
    with pytest.raises(SystemExit):
        variance.main([*given, "--repeats", "1"])
