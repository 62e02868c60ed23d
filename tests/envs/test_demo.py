"""The command line, and `demo --quick` from end to end."""

import json
import math
import os
import subprocess
import sys

import pytest
import torch
from torchbeam_envs import TipReachVectorEnv
from torchbeam_envs.demo.controllers import SCALE, Policy
from torchbeam_envs.demo.episodes import Record

from torchbeam.extend.commands import main


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "torchbeam", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "TORCHBEAM_ENGINE": "auto"},
    )


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    return out, run("demo", "--quick", "--out", str(out))


def test_quick_demo_runs(quick):
    out, done = quick
    assert done.returncode == 0, done.stderr
    assert "learning" in done.stderr  # the progress bar
    for word in (
        "nothing",
        "static force",
        "PD + static force",
        "learned",
        "final distance",
        "settling time",
    ):
        assert word in done.stdout
    assert {path.name for path in out.iterdir()} == {
        "demo.md",
        "demo.png",
        "demo.gif",
        "demo.json",
        "policy.pt",
    }
    assert (out / "demo.png").read_bytes()[:4] == b"\x89PNG" and (out / "demo.gif").read_bytes()[
        :6
    ] == b"GIF89a"


def test_every_number_is_there_and_finite(quick):
    result = json.loads((quick[0] / "demo.json").read_text())
    assert {
        "scores",
        "scores_on_finer_model",
        "learning",
        "pd_search",
        "settings",
        "versions",
        "seconds",
    } <= set(result)
    numbers = [x for x in _leaves(result) if isinstance(x, float)]
    assert len(numbers) > 40 and all(map(math.isfinite, numbers))
    scores = result["scores"]
    assert scores["learned"]["final_distance_m"] < scores["static force"]["final_distance_m"]
    assert sum(s["solver_failures"] for s in scores.values()) == 0


def test_policy_is_read_back_in_three_lines(quick):
    policy = Policy()
    policy.load_state_dict(torch.load(quick[0] / "policy.pt"))
    action = policy(torch.zeros(1, 17, dtype=torch.float64), torch.zeros(1, 2, dtype=torch.float64))
    assert action.tolist() == [[0.0, 0.0]]  # at rest on the target, what holds it
    assert len(SCALE) == TipReachVectorEnv(1, elements=2).single_observation_space.shape[0]


def test_scores_by_hand():
    """Two episodes of 0.6 s on a strip of 1 m: one comes within 20 mm after 0.3 s and stays, one
    leaves at the very end.
    """
    distance = torch.full((30, 2), 0.1, dtype=torch.float64)
    distance[15:] = 0.01
    distance[-1, 1] = 0.04
    record = Record(
        distance,
        torch.ones(30, 2, 2),
        distance,
        torch.zeros(31, 2, 3, 3),
        torch.zeros(2, dtype=torch.bool),
        torch.zeros(2, 3),
        0.02,
        1.0,
    )
    assert record.settling.tolist() == pytest.approx([0.3, 0.6])
    assert record.final.tolist() == pytest.approx([0.01, 0.013])
    assert record.scores()["share_within_2_percent"] == 0.5
    assert record.scores()["effort_N"] == pytest.approx(math.sqrt(2))


def test_commands_are_listed_and_explained(capsys):
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert "demo" in listed and "info" in listed and "cannot be loaded" not in listed
    assert main(["info"]) == 0
    assert "torch " in capsys.readouterr().out
    with pytest.raises(SystemExit) as stop:
        main(["nope"])
    assert stop.value.code == 2
    with pytest.raises(SystemExit) as stop:
        main(["demo", "--help"])
    assert stop.value.code == 0 and "--quick" in capsys.readouterr().out


def _leaves(tree):
    if isinstance(tree, dict):
        tree = tree.values()
    elif not isinstance(tree, list):
        return [tree]
    return [leaf for branch in tree for leaf in _leaves(branch)]
