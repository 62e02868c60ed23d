"""docs/own_soft_arm.md: its blocks run with small budgets, its tendons bend what the page says."""

import importlib
import re
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

import torchbeam as tb

PAGES = Path(__file__).parents[2] / "docs"
BLOCKS, (ARM, *_) = (
    re.findall(r"```python\n(.*?)```", (PAGES / name).read_text(), re.DOTALL)
    for name in ("own_soft_arm.md", "own_environment.md")
)


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """The first block, as a module of its own, in a folder where results go."""
    folder = tmp_path_factory.mktemp("six")
    (folder / "tendon_arm.py").write_text(ARM)
    (folder / "six_tendons.py").write_text(BLOCKS[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.chdir(folder)
        yield importlib.import_module("six_tendons")
    for name in ("tendon_arm", "six_tendons"):
        sys.modules.pop(name, None)
    for name in ("TendonArm-v0", "SixTendonArm-v0"):
        gymnasium.registry.pop(name, None)


def test_six_tendons_bend_two_segments(six):
    """In equilibrium, pulled by 4 N of the others' 2 N (N = T x eye beside it, each element bends
    by T r / EI): a tendon that ends in the middle bends the first half alone, one that runs on
    bends both; equal tensions bend nothing.
    """
    env = six.SixTendonVectorEnv(1, elements=4, gravity=None, payload=0.0)
    env.reset(seed=0)
    EI = 1e6 * np.pi * 0.01**4 / 4
    for k, halves in ((None, (0, 0)), (0, (1, 0)), (3, (1, 1))):
        pulls = {f"pull {i}": [4.0 if i == k else 2.0] for i in range(6)}
        rotation = tb.equilibrium(env.scene, inputs=pulls).rotation.reshape(5, 4)
        q = rotation[[0, 2, 4]]
        turns = 2 * torch.acos((q[1:] * q[:-1]).sum(-1).abs().clamp(max=1))
        wanted = 2.0 * 0.012 / EI * 0.15 * torch.tensor(halves).double()
        torch.testing.assert_close(turns, wanted, rtol=0.05, atol=1e-6)


def test_the_whole_arm_is_learned_on(six):
    """The blocks, with a budget of two updates: policies of both learners, scores on both meshes,
    plants drawn from the ranges; stable-baselines3's steps and the film.
    """
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("PIL")
    torch.set_default_dtype(torch.float32)
    names = dict(vars(six))
    small = [
        ("200_000", "128"),
        ("num_envs=32", "num_envs=4"),
        ("name=name", "name=name, episodes=2, final=2"),
    ]
    small += [("policy, 64", "policy, 2"), ("horizon=16", "horizon=4"), ("range(20)", "range(2)")]
    for block in BLOCKS[1:]:
        for a, b in small:
            block = block.replace(a, b)
        exec(block, names)
    for name in ("shac", "ppo"):
        assert (Path("out/arm") / f"{name}.pt").exists()
    env = names["learners"]["shac"].env
    for name, (low, high) in six.drawn.items():
        value = env.state.plant.params[name]
        assert ((low <= value) & (value <= high)).all() and value.unique().numel() == 4
    assert names["model"].num_timesteps == 64 and names["policy"].about["task"] == "six-tendons"
    assert Path("out/arm/arm.gif").stat().st_size > 1000
