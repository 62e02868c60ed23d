"""The soft arm that torques drive: splines, drag and compliance against closed forms, the target's
motion and the rewards as published, and what the arm without action returns.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torchbeam_envs import (
    FollowTargetVectorEnv,
    ReachBehindVectorEnv,
    ReachPoseVectorEnv,
    TrackTargetVectorEnv,
)
from torchbeam_envs.baselines import ResolvedRate
from torchbeam_envs.torque_arm import Viscous, moving, spline

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam import extend
from training.ways import RESOLVED

MADE = dict(autoreset_mode="Disabled", output="torch")


@pytest.mark.parametrize("points", [(0.4, 0.9), tuple(k / 7 for k in range(1, 7))])
def test_splines_are_those_that_interpolate(points):
    """At the points an identity, 0 at both ends; cubic polynomials that are 0 there are themselves,
    to rounding.
    """
    places = np.linspace(0, 1, 33)
    np.testing.assert_allclose(spline(points, np.array(points)), np.eye(len(points)), atol=1e-12)
    shares = spline(points, places)
    np.testing.assert_allclose(shares[:, [0, -1]], 0, atol=1e-12)
    for cubic in (lambda x: x * (1 - x), lambda x: x * (1 - x) * (2 - x)):
        np.testing.assert_allclose(cubic(np.array(points)) @ shares, cubic(places), atol=1e-12)


def test_the_medium_resists_by_the_published_numbers():
    law = Viscous(torch.tensor(30.0).double())
    v, w = torch.tensor([[[1.0, 2, 3]], [[-1.0, 0, 2]]]).double()
    point = extend.LoadPoint(torch.eye(3).double(), velocity=v, spin=w)
    force, couple = law.wrench(point, 0.0, {})
    torch.testing.assert_close((force, couple), (-30 * v, -30 * w))


def test_couples_twist_the_arm_as_they_add_up():
    """About the tangent, at rest: the tip's turn is the sum of the couples 75 S(k / 20) N m times
    how far out they act, over GJ = 65.4 N m^2. Couples at nodes are half of an element's at each
    end: their mean place is the element's middle, 0.025 m in from its end.
    """
    env = ReachPoseVectorEnv(1, **MADE)
    env.reset(seed=0)
    values = 0.01 * torch.arange(1.0, 7).double()
    action = torch.zeros(1, 18).double()
    action[0, 12:] = values
    turn = tb.equilibrium(env.scene, inputs=env.task.inputs(action)).tip.rotation
    turned = torch.atan2(turn[0, 0, 1], turn[0, 2, 1])  # of d1 from z, about y
    ends = np.arange(1, 21) / 20
    couples = 75 * values.numpy() @ spline(env.config.points, ends)
    GJ = 10e6 / 1.5 * math.pi / 2 * 0.05**4
    assert GJ == pytest.approx(65.4, rel=1e-3)
    half = (couples.sum() - couples[0] / 2) * 0.025  # the first element twists by half of itself
    expected = ((couples * (ends - 0.025)).sum() - half) / GJ
    assert abs(turned.item()) == pytest.approx(expected, rel=1e-6)


def test_the_jacobian_is_that_of_equilibria():
    """Of all twelve actions about the straight arm, against central differences, to 1e-6 m."""
    env = TrackTargetVectorEnv(1, **MADE)
    env.reset(seed=0)
    way = 1e-5 * torch.eye(12).double()

    def tips(share):
        return tb.equilibrium(env.scene, inputs=env.task.inputs(share)).tip.position

    slopes = (tips(way) - tips(-way)) / 2e-5
    moved, _ = env.task.tip_jacobian(env.state)
    torch.testing.assert_close(moved[0], slopes.mT, rtol=0, atol=1e-6)


def test_an_arm_stands_by_the_couples_that_hold_it():
    """In equilibria of random couples these are found again, to 0.1 %. They turn with nodes, not
    with elements, by second order: of a quarter of the couples the share is a sixteenth. Damped,
    they are smaller.
    """
    env = TrackTargetVectorEnv(4, **MADE)
    env.reset(seed=0)
    action = torch.rand(4, 12, generator=torch.Generator().manual_seed(0)).double() - 0.5
    off = []
    for share in (0.4, 0.1):
        held = tb.equilibrium(env.scene, inputs=env.task.inputs(share * action))
        now = extend.with_values(env.state, beam=held)
        off.append((env.task.standing(now, 1e-14) - share * action).norm() / share)
        damped = env.task.standing(now, 0.1)
        assert (damped.norm(dim=-1) < share * action.norm(dim=-1)).all()
    assert off[0] < 1e-3 * action.norm() and off[1] < off[0] / 14


def test_moves_from_what_holds_the_arm_come_sooner():
    """A viscous arm that starts from there with a gain of 6 is at a place that stays within 0.3 s,
    0.02 m off; from what acts it takes longer. Only torques hold an arm.
    """
    off = []
    env = TrackTargetVectorEnv(1, speed=0.0, control_interval=7e-3, **MADE)
    for settings in (dict(gain=6.0, damping=0.2, lead=0.0, standing=1e-9), RESOLVED["reach-nest"]):
        observation, _ = env.reset(seed=0, options={"goal": [0.4, 0.5, 0.2, 0.0, 0.0, 0.0]})
        controller = ResolvedRate(env, **settings)
        controller.begin(env)
        for _ in range(43):
            observation, *_, info = env.step(controller(observation))
        off.append(info["distance"].item())
    assert off[0] < 0.02 < off[1]
    with pytest.raises(ValueError, match=r"standing = 1\.0 was given for FollowTarget"):
        ResolvedRate(FollowTargetVectorEnv(1, elements=5), standing=1.0)
    with pytest.raises(ValueError, match="standing = -1"):
        ResolvedRate(env, standing=-1.0)


def test_what_acts_follows_the_action_by_the_rate():
    """1,000 1/s: of an interval of 1.4 ms in two, from 0 to 1 the means are those of a ramp that
    ends after 1 ms; from -1 to 1 it gets to 0.4.
    """
    env = ReachBehindVectorEnv(1, elements=10, substeps=2, **MADE)
    env.reset(seed=0)
    gain = env.task.drives[0].gain

    def means(action):
        return [(given["torque"] / gain[0])[0, 1::3][0].item() for given in
                env.task.inputs(action, env.state)]  # fmt: skip

    one = torch.tensor([[1.0, 0.0]]).double()
    assert means(one) == pytest.approx([0.35, (1.4 - 0.5 - 0.7 * 0.35) / 0.7])
    now = extend.with_values(env.state, memory=-one)
    ends = env.task.next_memory(now, one)
    torch.testing.assert_close(ends, torch.tensor([[0.4, 0.0]]).double())


def test_targets_turn_round_before_walls():
    """0.5 m/s, 0.05 m before a wall; a new direction after 500 intervals; a coordinate that starts
    nearer to a wall stays there, as published.
    """
    env = TrackTargetVectorEnv(2, elements=2, **MADE)
    goal = [[0.5485, 0.5, 0.0, 0.5, 0.0, 0.0], [0.57, 0.5, 0.0, 0.5, 0.0, 0.0]]
    env.reset(seed=0, options={"goal": goal})
    now, still = env.state, torch.zeros(2, 12).double()
    places = []
    for k in range(600):
        memory = env.task.next_memory(now, still)
        now = extend.with_values(now, memory=memory, steps=now.steps + 1)
        places.append(env.task.moving(now)[0])
        velocity = env.task.moving(now)[1]
        if k == 498:
            assert velocity[0].tolist() == [-0.5, 0.0, 0.0]
    x = torch.stack(places)
    assert 0.55 < x[:, 0, 0].max() < 0.551 and x[498, 0, 0] < 0.25
    assert x[:499, 1, 0].min() > 0.569 and x[:499, 1, 0].max() < 0.571
    assert velocity[0, 1].abs() > 0 and velocity.norm(dim=-1) == pytest.approx([0.5, 0.5])
    torch.testing.assert_close(moving(velocity)[:, 0], torch.full((2,), 0.5).double())
    assert moving(0 * velocity).abs().max() == 0


def test_rewards_are_as_published():
    """By distance and misalignment, each case of the specification."""
    env = ReachPoseVectorEnv(1, elements=2, **MADE)
    env.reset(seed=0)

    def reward(d, o):
        measures = {
            "distance": torch.tensor([d]).double(),
            "misaligned": torch.tensor([o]).double(),
        }
        return -env.task.cost(extend.with_values(env.state, measures=measures)).item()

    for d, o, bonus in (
        (0.2, 0.0, 0.0), (0.08, 0.5, 0.5 + 0.5 * 0.5), (0.08, 0.06, 1 + 0.5 * 0.94),
        (0.02, 0.5, 0.75 + 1.5 + 1.5 * 0.5), (0.02, 0.06, 1.47 + 1.5 + 1.5 * 0.94),
        (0.0, 0.0, 6.0),
    ):  # fmt: skip
        assert reward(d, o) == pytest.approx(bonus - d**2 - 0.5 * o**2)


@pytest.mark.parametrize("nest, still", [(False, -4866), (True, -3794)])
def test_an_arm_that_stays_returns_what_is_published(nest, still):
    """What an interval costs at the start, times 3571."""
    env = ReachBehindVectorEnv(1, nest=nest, **MADE)
    env.reset(seed=0)
    assert -3571 * env.task.cost(env.state).item() == pytest.approx(still, abs=1)


def test_sizes_are_as_published():
    for kind, own, observations, actions in (
        (TrackTargetVectorEnv, {}, 44, 12), (ReachPoseVectorEnv, {}, 52, 18),
        (ReachBehindVectorEnv, {}, 160, 2), (ReachBehindVectorEnv, dict(nest=True), 220, 4),
    ):  # fmt: skip
        env = kind(1, **own)
        assert env.single_observation_space.shape == (observations,)
        assert env.single_action_space.shape == (actions,)


@refusals(
    (dict(rate=0.0), "rate = 0"), (dict(points=(0.5,)), r"points = \(0.5,\) was given"),
    (dict(planar=True), "planar = True was given"),
    (dict(viscous=-1.0), "viscous = -1.0 was given"),
    (dict(points=(0.9, 0.4)), "two or more that grow from above 0"),
)  # fmt: skip
def test_bad_arguments_are_refused(arguments):
    TrackTargetVectorEnv(1, **arguments)


def test_the_tip_moves_as_in_the_program_that_the_tasks_were_published_with():
    """Within 2 % of its motion of PyElastica's, under random actions held for 0.14 s: of an arm
    whose first element bends as the others do it is 10 % off.
    """
    known = json.loads((Path(__file__).parent / "soft_arm_tips.json").read_text())["tips"]
    theirs = np.array([*known.values()])
    drawn = [np.random.default_rng(int(seed)).uniform(-1, 1, (15, 12)) for seed in known]
    env, ours = TrackTargetVectorEnv(len(known)), []
    env.reset(seed=0)
    for k in range(500):
        env.step(np.stack([actions[k // 100] for actions in drawn]))
        if k % 50 == 49:
            ours.append(env.episodes.beam.position[:, -1].numpy().copy())
    apart = np.linalg.norm(np.stack(ours, 1) - theirs, axis=-1)
    moved = np.linalg.norm(theirs - [0.0, 1.0, 0.0], axis=-1)
    assert (apart**2).mean() ** 0.5 < 0.02 * (moved**2).mean() ** 0.5
