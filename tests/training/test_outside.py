"""Plants outside of the training range: what they are drawn from, which are taken."""

import json

import pytest
import torch
from torchbeam_envs import UNCERTAIN

from training import evaluate as evaluation
from training.evaluate import evaluate_outside, main, scores
from training.policies import Policy, save
from training.tuned import HELD_OUT, OUTSIDE, TASKS, WIDER, Task, widened

torch.set_num_threads(1)
DRAWN = {"stiffness": (0.7, 1.3), "gain": (0.9, 1.1)}
TINY = Task(
    "tiny",
    "torchbeam/TipReachPlanar-v1",
    dict(elements=2, substeps=1, max_episode_steps=4, randomize=DRAWN),
)


def test_every_uncertain_number_has_a_wider_range():
    """Half as wide again; damping by its factor, what begins with none upwards."""
    for level in UNCERTAIN.values():
        for name, (low, high) in level["randomize"].items():
            wide_low, wide_high = WIDER[name]
            if name == "damping":
                assert wide_low == pytest.approx(low / 1.5) and wide_high == pytest.approx(
                    1.5 * high
                )
            elif wide_low == low:
                assert low <= 0.001 and wide_high == pytest.approx(1.5 * high)
            else:
                assert wide_high - wide_low == pytest.approx(1.5 * (high - low))
                assert wide_high + wide_low == pytest.approx(high + low)
    for name, task in TASKS.items():
        assert (widened(task) is not None) == name.endswith("-uncertain")
    assert widened(TINY.varied(randomize=True)) is None
    # of a range that is wider already there is nothing outside
    assert widened(TINY.varied(randomize={"stiffness": (0.1, 9.0)})) is None


def test_each_plant_is_outside_in_a_number(monkeypatch):
    """And it is on the same episodes that everybody plays: of 64 wide plants 4/9 lie inside of both
    ranges and are left out.
    """
    played = []
    monkeypatch.setattr(evaluation, "evaluate", lambda *given: played.append(given) or {})
    for _ in range(2):
        evaluate_outside(TINY, lambda x: x, 48)
    task, _, episodes, seeds, env = played[0]
    assert seeds == played[1][3] and len(set(seeds)) == episodes == 48
    assert min(seeds) >= OUTSIDE and OUTSIDE - HELD_OUT > 256
    assert 60 < max(seeds) - OUTSIDE < 120
    env.reset(seed=seeds)
    found = env.state.plant.params
    beyond = {
        name: (found[name] < low) | (found[name] > high) for name, (low, high) in DRAWN.items()
    }
    assert (beyond["stiffness"] | beyond["gain"]).all()
    assert not beyond["stiffness"].all() and not beyond["gain"].all()
    assert task.arguments["randomize"] == {name: WIDER[name] for name in DRAWN}


def test_scores_have_both(tmp_path, capsys):
    """Also by the command, which refuses a policy of a plant that is known."""
    env = TINY.make(1)
    inputs, actions = (
        space.shape[0] for space in (env.single_observation_space, env.single_action_space)
    )
    policy = Policy((inputs, 8, actions), squash=True).double()
    whole = scores(TINY, policy, 4)
    outside = whole.pop("outside")
    assert outside == evaluate_outside(TINY, policy, 4) and outside["return"] != whole["return"]
    assert whole == evaluation.evaluate(TINY, policy, 4)
    assert scores(TINY.varied(randomize=None), policy, 4)["outside"] is None
    for name, task in (("drawn", TINY), ("known", TINY.varied(randomize=None))):
        about = {"task" if key == "name" else key: value for key, value in vars(task).items()}
        save(policy, tmp_path / f"{name}.pt", **about)
    assert main([str(tmp_path / "drawn.pt"), "--outside", "--episodes", "4"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["return"] == outside["return"]
    with pytest.raises(SystemExit):
        main([str(tmp_path / "known.pt"), "--outside"])
    assert "plants are uncertain is wanted" in capsys.readouterr().err
