"""training/policies/: the policies that are kept give the scores that stand beside them."""

import json
from pathlib import Path

import pytest
import torch

from training import cards
from training.evaluate import evaluate, evaluate_outside
from training.policies import load
from training.tuned import TASKS

torch.set_num_threads(1)
FOLDER = Path(cards.__file__).parent / "policies"
SCORES = json.loads((FOLDER / "scores.json").read_text())
SHORT = "reach-shac.pt", "track-uncertain-shac.pt"


@pytest.mark.parametrize(
    "name",
    [name if name in SHORT else pytest.param(name, marks=pytest.mark.long) for name in SCORES],
)
def test_scores_are_made_again(name):
    """Of all held-out episodes, and of plants outside of the training range, to 1e-9: the networks
    are of float64.
    """
    policy, kept = load(FOLDER / name), SCORES[name]
    # files of before tasks left frames to their learners have them among these
    task = TASKS[kept["task"]].seen(policy.about["arguments"].get("frames", 0))
    assert policy.about["scores"]["return"] == kept["return"]
    assert (policy.about["env"], policy.about["arguments"]) == (task.env, task.arguments)
    judged = [(evaluate(task, policy, kept["episodes"]), kept)]
    if kept.get("outside"):
        judged.append((evaluate_outside(task, policy, kept["episodes"]), kept["outside"]))
    for scores, expected in judged:
        for key in scores.keys() & expected:  # shares of time are not of all that are kept
            assert scores[key] == pytest.approx(expected[key], rel=1e-9, abs=1e-12)


def test_cards_are_those_of_the_files():
    assert (FOLDER / "README.md").read_text() == cards.cards(FOLDER)
    assert {path.name for path in FOLDER.glob("*.pt")} == {*SCORES}
