"""What lies between a controller and its beam: latency, lag and gain of actuators, bias of sensors;
an elastic clamp, a mass on the tip.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import torchbeam_envs as envs
from torchbeam_envs.imperfections import acting, acting_ahead

import torchbeam as tb

SMALL = dict(elements=2, substeps=1, planar=True, output="torch")
EVERY = {
    "latency": (0.0, 2.0), "lag": (0.0, 0.02), "gain": (0.9, 1.1), "bias": (0.0, 0.01),
    "tip_mass": (0.0, 0.02), "clamp": (0.001, 0.05), "damping": (0.0005, 0.002),
}  # fmt: skip


BLOCK_RATE = dict(
    section="silicone rod", length=0.3, elements=2, gravity=None, damping=None, form="block_rate",
    method="rk4", solver={"options": {"step_size": 5e-4}},
)  # fmt: skip


def reach(n=1, **changes):
    return envs.TipReachVectorEnv(n, **{**SMALL, **changes})


def actions(n=1, steps=5):
    return torch.sin(torch.arange(1.0, 1 + steps * n)).reshape(steps, n, 1)


def run(env, actions, **params):
    """(steps, n, o) observations, and the last state of the episodes."""
    env.reset(seed=1, options={"params": params} if params else None)
    seen = [env.step(action)[0] for action in actions]
    return torch.stack(seen), env.state


def test_whole_latency_is_delay():
    """Of 0 and 2 intervals beside a delay of 1, against delays of 1 and 3."""
    late = reach(2, randomize={"latency": (0, 2)})
    asked = actions().expand(-1, 2, -1)
    _, now = run(late, asked, latency=[0.0, 2.0])
    for row, delay in enumerate((1, 3)):
        _, same = run(reach(delay=delay), actions())
        apart = now.beam.position[row] - same.beam.position[0]  # of two samples, and of one alone
        assert apart.abs().max() < 1e-12
        assert torch.equal(now.acting[row], same.acting[0])


def test_between_whole_ones_the_mean_acts():
    """1.25 intervals and a delay of 1: an action begins a quarter into the third interval."""
    _, now = run(reach(randomize={"latency": (0, 2)}), actions(), latency=1.25)
    expected = 0.75 * actions()[-3] + 0.25 * actions()[-4]
    assert (now.acting - expected).abs().max() < 1e-15


def test_actuators_lag_and_have_a_gain():
    asked = actions()
    _, now = run(reach(delay=0), asked, lag=0.02)
    acting = torch.zeros(1)
    for action in asked[:, 0]:
        acting = acting + (1 - math.exp(-1)) * (action - acting)
    assert (now.acting[0] - acting).abs().max() < 1e-15
    _, now = run(reach(2, delay=0), asked.expand(-1, 2, -1), lag=[0.0, 0.02], gain=0.5)
    _, half = run(reach(delay=0), 0.5 * asked)
    assert (now.beam.position[0] - half.beam.position[0]).abs().max() < 1e-12
    assert torch.equal(now.acting[0], asked[-1, 0])


def test_what_acts_follows_from_all_that_was_asked():
    """Of four arms, each with a latency and a lag of its own, at once: as step by step."""
    late, lag = torch.tensor([0.0, 0.6, 1.25, 2.0]), torch.tensor([0.02, 0.0, 0.02, 0.015])
    env, asked = reach(4, randomize={"latency": (0, 2)}), actions(4, 12)
    _, now = run(env, asked, latency=late.tolist(), lag=lag.tolist())
    due = torch.cat((asked.flip(0)[env.config.delay :], asked.new_zeros(2, 4, 1))).movedim(0, 1)
    found = acting(due, late, lag, env.config.control_interval, 2)
    assert (found - now.acting).abs().max() < 1e-14
    assert now.acting.abs().min() > 1e-3


def test_what_will_act_follows_from_what_waits():
    """Over the next intervals, of arms with a latency and a lag of their own, at once: as step by
    step; and of arms without either.
    """
    late, lag = torch.tensor([0.0, 0.6, 1.25, 2.0]), torch.tensor([0.02, 0.0, 0.02, 0.015])
    for env, given in (
        (reach(4, randomize={"latency": (0, 2)}), dict(latency=late.tolist(), lag=lag.tolist())),
        (reach(4), {}),
    ):
        _, now = run(env, actions(4, 5), **given)
        plan, interval = actions(4, 6).movedim(0, 1), env.config.control_interval
        waits = (now.pending,) if now.late is None else (now.late, now.pending)
        ahead = acting_ahead(
            now.acting, torch.cat((*waits, plan), 1), *(
                now.plant.params[name] for name in ("latency", "lag")
            ), interval, env.simulation.spare,
        )  # fmt: skip
        for k, action in enumerate(plan.unbind(1)):
            acts, pending, waiting = env.simulation.acting(now, action)
            now = replace(now, acting=acts, pending=pending, late=waiting)
            assert (ahead[:, k] - acts).abs().max() < 1e-14


def test_bias_stays_through_an_episode():
    plain, _ = run(reach(2), actions(2))
    seen, _ = run(reach(2), actions(2), bias=[0.0, 0.01])
    off = seen - plain
    assert not off[:, 0].any() and (off[:, 1] - off[0, 1]).abs().max() < 1e-12
    sensors = off[0, 1, -9:-1]  # behind the target, before what waits
    assert (sensors != 0).all() and sensors.std() < 0.03 and sensors.unique().numel() == 8


def test_an_elastic_clamp_turns():
    """By its share of what bends the beam: L^2 F clamp (L/EI) more displacement under a tip force,
    beside F L^3/(3 EI) less a sixteenth, by two elements of constant strain.
    """
    env = reach(2, gravity=None, force=(1e-3, 1e-3), delay=0, randomize={"clamp": (0.01, 0.05)})
    env.reset(options={"params": {"clamp": [0.001, 0.051]}})
    inputs = env.task.inputs(torch.ones(2, 1))
    tip = tb.equilibrium(env.scene, inputs=inputs).tip.position[:, 1]
    assert tip[1] / tip[0] == pytest.approx((1 + 3.2 * 0.051) / (1 + 3.2 * 0.001), rel=1e-4)


def test_batch_is_singles_and_all_is_drawn():
    many = reach(2, randomize=EVERY, noise=0.01, autoreset_mode="SameStep", max_episode_steps=3)
    _, info = many.reset(seed=4)
    assert set(info["params"]) == set(EVERY)
    assert all(value.unique().numel() == 2 for value in info["params"].values())
    asked = actions(2)
    seen = [many.step(action)[0] for action in asked]
    for k in range(2):
        one = reach(1, randomize=EVERY, noise=0.01, autoreset_mode="SameStep", max_episode_steps=3)
        one.reset(seed=4 + k)
        for step, observation in enumerate(seen):
            alone = one.step(asked[step, k : k + 1])[0]
            assert (alone[0] - observation[k]).abs().max() < 1e-9, (k, step)


def test_gradients_by_them():
    """Against differences; by a lag of 0, which nothing follows, exactly 0."""
    env = reach(randomize={"latency": (0, 2)}, delay=0)
    usual = {"latency": 0.6, "lag": 0.015, "gain": 1.0, "bias": 0.01, "tip_mass": 0.01}

    def answer(**params):
        seen, now = run(env, actions(), **{**usual, **params})
        return seen.sum() + now.beam.tip.position.sum()

    for name in usual:
        x = torch.tensor(usual[name], dtype=torch.float64, requires_grad=True)
        answer(**{name: x}).backward()
        h = 1e-6
        with torch.no_grad():
            slope = (answer(**{name: usual[name] + h}) - answer(**{name: usual[name] - h})) / (
                2 * h
            )
        assert x.grad.item() == pytest.approx(slope.item(), rel=1e-4, abs=1e-7), name
    x = torch.tensor(0.0, dtype=torch.float64, requires_grad=True)
    answer(lag=x).backward()
    assert x.grad == 0


def test_gain_is_of_what_a_task_remembers_too():
    """The published arm keeps its curvature: half the gain is half the actions."""
    tips = []
    for gain, size in ((0.5, 0.2), (1.0, 0.1)):
        env = envs.FollowTargetVectorEnv(1, elements=5, substeps=1, planar=True, output="torch")
        env.reset(seed=0, options={"params": {"gain": gain}})
        for _ in range(3):
            env.step(torch.full((1, env.task.actions), size))
        tips.append(env.state.beam.tip.position)
    assert (tips[0] - tips[1]).abs().max() < 1e-12


def test_bad_input():
    env = reach(2)
    env.reset(seed=0)
    part = {"reset_mask": torch.tensor([True, False]), "params": {"clamp": 0.01}}
    with pytest.raises(ValueError, match="clamp was given for some episodes"):
        env.reset(options=part)
    env.reset(options={**part, "reset_mask": torch.tensor([True, True])})
    assert (env.simulation.parameters_of(env.episodes)["clamp"] == 0.01).all()
    with pytest.raises(ValueError, match="a dictionary of"):
        envs.TipReachVectorEnv(1, randomize=True, **BLOCK_RATE)
    env = reach(randomize={"latency": (0, 1.5)})
    with pytest.raises(ValueError, match="the largest that randomize draws is 2"):
        env.reset(options={"params": {"latency": 3.0}})
    with pytest.raises(ValueError, match="lag = "):
        env.reset(options={"params": {"lag": -1.0}})
    drawn = reach(randomize=True).simulation.ranges
    assert set(drawn) == {"stiffness", "mass", "offset", "damping"}


@pytest.mark.parametrize("task", envs.UNCERTAIN)
def test_uncertain_level(task):
    """Every episode of the level draws, runs, and lets a few random actions do without failing."""
    level = envs.UNCERTAIN[task]
    made = dict(elements=2, substeps=1, planar=True, params_in_info=True)
    env = getattr(envs, f"{task}VectorEnv")(4, **made, **level)
    _, info = env.reset(seed=0)
    assert set(info["params"]) == set(level["randomize"])
    env.action_space.seed(0)
    for _ in range(3):
        observation, _, terminated, _, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation) and not terminated.any()


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("task", envs.UNCERTAIN)
def test_a_reset_does_not_depend_on_who_else_is_reset(task, planar):
    """At the uncertain level, by masks and by autoreset: what begins is, to the bit, what begins
    where all do, with the stream that it has; and what goes on does as without a reset.
    """
    made = dict(elements=2, substeps=1, planar=planar, frames=2, max_episode_steps=4)
    some, rest = np.array([False, True, False, True, False]), 4
    few, alone, all_at_once = (
        getattr(envs, f"{task}VectorEnv")(
            5, autoreset_mode="Disabled", params_in_info=True, **made, **envs.UNCERTAIN[task]
        )
        for _ in range(3)
    )
    for env in (few, alone):
        env.reset(seed=0)
    push = np.random.default_rng(0).uniform(-0.5, 0.5, (rest, *few.action_space.shape))
    for env in (few, alone):
        env.step(push[0])
    begun, info = few.reset(seed=7, options={"reset_mask": some})
    fresh, told = all_at_once.reset(seed=7)
    for k in range(1, rest):
        np.testing.assert_array_equal(begun[some], fresh[some])
        for name, value in told["params"].items():
            np.testing.assert_array_equal(info["params"][name][some], value[some])
        begun, _, _, _, info = few.step(push[k])
        fresh, _, _, _, told = all_at_once.step(push[k])
        going = alone.step(push[k])[0]
        np.testing.assert_array_equal(begun[~some], going[~some])
