"""The adapter to stable-baselines3 keeps what the vector env says, and stable-baselines3 trains
through it.
"""

import numpy as np
import pytest
import torch
import torchbeam_envs

pytest.importorskip("stable_baselines3")

from training import sb3
from training.tuned import Task
from training.watch import Budget

torch.set_num_threads(1)
TINY = Task(
    "tiny", "torchbeam/TipReachPlanar-v1", dict(elements=2, substeps=1, max_episode_steps=4)
)


@pytest.fixture(autouse=True)
def single_precision():
    """stable-baselines3 makes its networks in the default dtype and gives them float32."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    yield
    torch.set_default_dtype(before)


def test_adapter_is_the_vector_env():
    """Two episodes of four steps, beside the env itself: observations, rewards, ends, and the
    observation before the reset.
    """
    env, plain = torchbeam_envs.Sb3VecEnv(TINY.make(3)), TINY.make(3)
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), plain.reset(seed=5)[0])
    push = np.full((3, 1), 0.5, dtype=np.float32)
    for k in range(8):
        observation, reward, done, infos = env.step(push)
        expected = plain.step(push)
        np.testing.assert_array_equal(observation, expected[0])
        np.testing.assert_allclose(reward, expected[1], rtol=1e-6)
        assert done.all() == (k % 4 == 3) and reward.dtype == np.float32
        for i, info in enumerate(infos):
            assert (
                ("terminal_observation" in info)
                == done[i]
                == info.get("TimeLimit.truncated", False)
            )
            if done[i]:
                np.testing.assert_array_equal(
                    info["terminal_observation"], expected[4]["final_obs"][i]
                )
                assert info["distance"] == expected[4]["final_info"]["distance"][i]
            else:
                assert info["distance"] == expected[4]["distance"][i]


def test_adapter_tells_the_parameters_of_each_episode():
    """Also those that begin by themselves, of the env behind it that are given others, and where a
    learner writes into what it was told.
    """
    randomize = {"stiffness": (0.8, 1.2), "gain": (0.9, 1.1)}
    env = torchbeam_envs.Sb3VecEnv(TINY.make(3, randomize=randomize, params_in_info=True))
    env.seed(0)
    env.reset()
    push, seen = np.zeros((3, 1), dtype=np.float32), set()
    for k in range(12):
        before = env.env.state.plant.params
        if k == 6:
            env.env.reset(options={"params": {"damping": 2e-3}})
            before = env.env.state.plant.params
        _, _, done, infos = env.step(push)
        for i, info in enumerate(infos):
            told = info["params"]
            own = {name: x[i].item() for name, x in before.items() if x.ndim}
            assert told == own or done[i]
            assert told.keys() == randomize.keys() | ({"damping"} if k >= 6 else set())
            seen.add(told["stiffness"])
            told["stiffness"] = -1.0
    assert len(seen) > 6 and -1.0 not in seen


def test_adapter_refuses_options():
    """Those that stable-baselines3 would give to the members one by one."""
    env = torchbeam_envs.Sb3VecEnv(TINY.make(2))
    env.set_options({"goal": [1.0, 0.0, 0.0]})
    with pytest.raises(ValueError, match="options were set"):
        env.reset()


def test_adapter_refuses_other_envs():
    for arguments in ({"autoreset_mode": "NextStep"}, {"output": "torch"}):
        with pytest.raises(
            ValueError, match=r'autoreset_mode="SameStep".*, with output="numpy", is wanted'
        ):
            torchbeam_envs.Sb3VecEnv(TINY.make(2, **arguments))


SMALL = {
    "ppo": dict(n_steps=8, batch_size=16, n_epochs=1),
    "sac": dict(learning_starts=8, gradient_steps=1, batch_size=8),
}


@pytest.mark.parametrize("algorithm", SMALL)
def test_trains_a_few_steps(algorithm, tmp_path):
    """And in the same bits when it is made again."""
    results = [
        sb3.train(
            TINY,
            algorithm,
            tmp_path / again,
            Budget(steps=32),
            name="run",
            episodes=2,
            final=2,
            progress=False,
            num_envs=4,
            **SMALL[algorithm],
        )
        for again in ("first", "second")
    ]
    result = results[0]
    assert {**result, "seconds": 0} == {**results[1], "seconds": 0}
    assert result["steps"] == 32 and np.isfinite(result["return"]) and result["episodes"] == 2
    folder = tmp_path / "first"
    assert {path.name for path in folder.iterdir()} == {"run.csv", "run.zip", "run.normal"}
    rows = (folder / "run.csv").read_text().splitlines()
    assert (
        rows[0].startswith("steps,seconds,validation_return")
        and rows[1].startswith("0,")
        and rows[-1].startswith("32,")
    )
