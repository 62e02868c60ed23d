"""Environments by native code beside eager ones: what is seen, rewarded and differentiated is the
same.
"""

import numpy as np
import pytest
import torch
import torchbeam_envs

import torchbeam as tb

pytest.importorskip("llvmlite")


def pair(**keywords):
    return [
        torchbeam_envs.TipReachVectorEnv(5, engine=engine, elements=2, **keywords)
        for engine in ("compiled", "eager")
    ]


@pytest.mark.parametrize(
    "keywords", [dict(planar=True, randomize=True), dict(planar=False, delay=2, substeps=3)]
)
def test_episodes_are_the_eager_ones(keywords):
    """Eight steps with resets in between, the substeps of an interval in one native call: to the
    rounding of float32.
    """
    envs = pair(max_episode_steps=3, **keywords)
    first = [env.reset(seed=4)[0] for env in envs]
    np.testing.assert_allclose(*first, atol=1e-6)
    actions = (
        np.random.default_rng(1).uniform(-1, 1, (8, *envs[0].action_space.shape)).astype(np.float32)
    )
    actions[4, 1] = np.nan
    for action in actions:
        found, wanted = (env.step(action) for env in envs)
        np.testing.assert_allclose(found[0], wanted[0], atol=1e-6)
        np.testing.assert_allclose(found[1], wanted[1], atol=1e-9)
        for a, b in zip(found[2:4], wanted[2:4], strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(found[4]["distance"], wanted[4]["distance"], atol=1e-6)
    assert (
        envs[0].state.plant.stepper.compiled is not None
        and envs[1].state.plant.stepper.compiled is None
    )


def test_gradients_are_the_eager_ones():
    found = []
    for env in pair(planar=True, output="torch", delay=0):
        env.reset(seed=1)
        action = torch.full((5, 1), 0.3, requires_grad=True)
        reward = sum(env.step(action)[1].sum() for _ in range(2))
        found.append(torch.autograd.grad(reward, action)[0])
    torch.testing.assert_close(*found, rtol=1e-8, atol=1e-10)


def test_an_engine_that_does_not_exist_or_fit_is_refused():
    with pytest.raises(ValueError, match="engine = 'fast' was given"):
        torchbeam_envs.TipReachVectorEnv(1, engine="fast")
    with pytest.raises(ValueError, match="engine = 'compiled' with method = 'rk4' was given"):
        torchbeam_envs.TipReachVectorEnv(1, engine="compiled", method="rk4", gravity=None)


def test_a_reset_with_parameters_of_its_own_is_solved_natively(monkeypatch):
    """Where steps are native the load is raised by native code; the equilibria are those of torch
    to 1e-9 of the length, as both stop at residuals of 1e-8.
    """
    pytest.importorskip("llvmlite")
    asked, solve = [], tb.equilibrium
    monkeypatch.setattr(
        tb, "equilibrium", lambda *a, **kw: asked.append(kw.get("engine")) or solve(*a, **kw)
    )
    env = torchbeam_envs.TipReachVectorEnv(
        3, elements=2, substeps=1, engine="compiled", randomize={"stiffness": (0.7, 1.3)}
    )
    asked.clear()
    env.reset(seed=0)
    assert asked == ["compiled"]
    scene, start = env.state.plant.scene, env.state.start
    eager = solve(scene, inputs={"force": torch.zeros(3, 3).to(start.position)}, engine="eager")
    torch.testing.assert_close(start.position, eager.position, rtol=0, atol=1e-9 * 1.5)
    assert start.tip.position[:, 2].unique().numel() == 3
