"""Environments by native code beside eager ones: what is seen, rewarded and differentiated is the
same.
"""

import copy

import numpy as np
import pytest
import torch
import torchbeam_envs
from torch.utils._python_dispatch import TorchDispatchMode
from torchbeam_envs.uncertain import UNCERTAIN

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


def test_plants_of_a_reset_step_as_new_ones():
    """Some of three begin again: their equilibrium and a step are to the bit those of a copy of the
    scene, of which nothing is known (the same operations on the same shapes).
    """
    env = torchbeam_envs.TipReachVectorEnv(
        3, elements=2, substeps=1, autoreset_mode="Disabled", **UNCERTAIN["TipReach"]
    )
    env.reset(seed=0)
    env.step(np.full((3, 2), 0.5))
    env.reset(options={"reset_mask": np.array([False, True, True])})
    plant, start = env.state.plant, env.state.start
    none = {"force": torch.zeros(3, 3, dtype=torch.float64)}
    scene = copy.deepcopy(plant.scene)
    rest = tb.equilibrium(scene, inputs=none, engine="compiled")
    assert torch.equal(start.position[1:], rest.position[1:])
    new = tb.Stepper(scene, env.config.control_interval, env.config.method, halvings=2)
    after, anew = (stepper(rest, force=none["force"] + 0.1) for stepper in (plant.stepper, new))
    for name in ("position", "rotation", "velocity", "stress"):
        assert torch.equal(getattr(after, name), getattr(anew, name)), name


class Operations(TorchDispatchMode):
    """Counts torch's operations."""

    count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.count += 1
        return function(*args, **(kwargs or {}))


@pytest.mark.parametrize("env, most", [("TipReach", 3.2), ("FlutterHold", 1.9)])
def test_a_reset_of_some_costs_few_operations(env, most):
    """At the uncertain level, over those of a step, with what the next step has to ask anew: 3.05
    with an equilibrium, 1.75 without. Operations, as times depend on the machine.
    """
    own = getattr(torchbeam_envs, f"{env}VectorEnv")(8, autoreset_mode="Disabled", **UNCERTAIN[env])
    some, push = {"reset_mask": np.arange(8) < 1}, np.zeros((8, 2))
    own.reset(seed=0)

    def counted(call):
        with Operations() as operations:
            call()
        return operations.count

    for _ in range(2):  # the first compiles, and fills caches
        reset = counted(lambda: own.reset(options=some)) + counted(lambda: own.step(push))
        step = counted(lambda: own.step(push))
    assert reset - step < most * step
