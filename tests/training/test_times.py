"""training/times.py: seconds are shared out whole, and nothing changes because somebody looks."""

import json

import pytest
import torch

from tests.cases.tiny_task import SHORT as TINY
from training import results, shac, times
from training.tuned import TASKS

torch.set_num_threads(1)


def test_innermost_part_counts(monkeypatch):
    now = iter(range(100))
    monkeypatch.setattr(times.time, "process_time", lambda: float(next(now)))
    clock = times.Clock()
    clock.enter("networks")
    clock.enter("forward")
    clock.leave()
    clock.turn("backward")
    clock.leave()
    clock.enter("rest")
    assert clock.seconds == {"forward": 1.0, "backward": 1.0, "networks": 2.0, "rest": 2.0}


def test_a_learner_that_is_watched_learns_the_same():
    """SHAC, in the same bits: marks on the way back are the identity; the way back through the
    simulation takes time.
    """

    def learned(clock=None):
        learner = shac.SHAC(TINY, shac.Arguments(num_envs=4, horizon=8, hidden=(8,)))
        for _ in range(2):
            if clock is None:
                learner.iteration(0.0)
            else:
                with times.watched(clock):
                    learner.iteration(0.0)
        return learner.policy.state_dict()

    clock = times.Clock()
    plain, watched, after = learned(), learned(clock), learned()
    assert all(torch.equal(plain[key], watched[key]) for key in plain)
    assert all(torch.equal(plain[key], after[key]) for key in plain)
    assert all(value > 0 for value in clock.seconds.values()) and clock.inside == ["rest"]


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(TASKS, "tiny", TINY)
    monkeypatch.setattr(times, "WARM", 32)
    names = ["ppo", "shac"]
    for name in names:
        learner, arguments, _ = results.LEARNERS[name]
        small = {"tiny": dict(num_envs=4, horizon=8, hidden=(8,))}
        monkeypatch.setitem(results.LEARNERS, name, (learner, arguments, small))
    options = ["--tasks", "tiny", "--seconds", "0.05", "--out", str(tmp_path), "--algorithms"]
    assert times.main([*options, *names]) == 0
    rows = json.loads((tmp_path / "times.json").read_text())["rows"]
    assert [row["algorithm"] for row in rows] == names
    for row in rows:
        assert sum(row[part] for part in times.PARTS) == pytest.approx(1.0)
        assert (row["backward"] > 0) == (row["algorithm"] == "shac")
    assert "| tiny | SHAC |" in (tmp_path / "times.md").read_text()
    with pytest.raises(SystemExit):
        times.main(["--seconds", "0"])


@pytest.mark.parametrize("library, name", [("stable_baselines3", "sb3-ppo"), ("skrl", "skrl-ppo")])
def test_libraries_are_watched_too(library, name, monkeypatch):
    pytest.importorskip(library)
    monkeypatch.setattr(times, "WARM", 32)
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)  # in which they make their networks
    try:
        row = times.measure(TINY, name, 0.05)
    finally:
        torch.set_default_dtype(before)
    assert row["steps"] > 0 and row["backward"] == 0
    assert row["forward"] > 0 and row["networks"] > 0
