"""training/skrl.py: skrl's PPO on the vector envs through its own wrapper."""

import numpy as np
import pytest
import torch

pytest.importorskip("skrl")

from tests.cases.tiny_task import SHORT as TINY
from training import skrl
from training.tuned import TRAINING
from training.watch import Budget

torch.set_num_threads(1)
SMALL = dict(num_envs=4, rollouts=8, mini_batches=2, hidden=8)


def test_trains_a_few_steps(tmp_path):
    """In the same bits when it is made again, and writes nothing beside its files."""
    results = [
        skrl.train(
            TINY,
            tmp_path / again,
            Budget(steps=96),
            name="run",
            episodes=2,
            final=2,
            progress=False,
            **SMALL,
        )
        for again in ("first", "second")
    ]
    result = results[0]
    assert {**result, "seconds": 0} == {**results[1], "seconds": 0}
    assert result["steps"] == 96 and np.isfinite(result["return"]) and result["episodes"] == 2
    assert {path.name for path in (tmp_path / "first").iterdir()} == {"run.csv", "run.skrl"}
    rows = (tmp_path / "first/run.csv").read_text().splitlines()
    assert rows[0].startswith("steps,seconds,validation_return") and rows[-1].startswith("96,")


def test_the_policy_acts_as_the_agent_does(tmp_path):
    """Without noise; episodes are those of training, seed by seed."""
    agent, env = skrl.make(TINY, 3, tmp_path, **SMALL)
    observation, _ = env.reset()
    expected, _ = TINY.make(4).reset(seed=TRAINING + 30_000)
    np.testing.assert_array_equal(observation, expected)
    agent.init()
    _, outputs = agent.act(observation, None, timestep=0, timesteps=1)
    action = skrl.Greedy(agent)(observation.double())
    assert torch.allclose(action, outputs["mean_actions"].double().clamp(-1, 1), atol=1e-7)
