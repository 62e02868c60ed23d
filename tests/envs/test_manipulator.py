"""The upright soft arm: its command against closed forms, the target's motion, and both rewards as
published.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torchbeam_envs import FollowTargetVectorEnv, InverseKinematicsVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import ResolvedRate, Zero

import torchbeam as tb

SMALL = dict(elements=10, substeps=1, autoreset_mode="Disabled")


def test_a_command_bends_the_arm_into_an_arc():
    """Without gravity all segments turned by 0.4 rad: ten chords, each as long as its element, of
    arcs that begin at 1/40 and end at 39/40 of the length. At rest to 1e-6 after 12 s, as damped
    modes fall by exp(-1.6 t). As nothing loads the arm, the tip's Jacobian is that of the
    equilibria, against differences, to the 1 % by which chords are moved like their middles.
    """
    env = FollowTargetVectorEnv(1, planar=True, gravity=None, **SMALL | {"substeps": 4})
    env.reset(seed=0)
    for k in range(120):
        env.step(np.full((1, 5), -1.0 if k < 8 else 0.0))
    torch.testing.assert_close(env.task.command(env.state), torch.full((1, 5), -0.4).double())
    x, _, z = env.state.beam.position[0, -1].tolist()
    at_node = 0.4 * np.interp(
        np.arange(11) / 10, np.array([1, 7, 15, 23, 31, 39]) / 40, np.arange(6)
    )
    turns = (at_node[1:] + at_node[:-1]) / 2
    assert (abs(x), z) == pytest.approx((np.sin(turns).mean(), np.cos(turns).mean()), abs=1e-6)
    still = env.task.command(env.state) / env.task.limits
    way = torch.eye(5, dtype=torch.float64) * 1e-5

    def tips(share):
        return tb.equilibrium(env.scene, inputs=env.task.inputs(share)).tip.position

    slopes = (tips(still + way) - tips(still - way)) / (2e-5 * env.task.limits[:, None])
    moved, turned = env.task.tip_jacobian(env.state)
    torch.testing.assert_close(moved[0], slopes.mT, rtol=0, atol=5e-3)
    torch.testing.assert_close(turned[0, 1].abs(), torch.ones(5).double(), rtol=1e-9, atol=0)


def test_the_command_keeps_to_its_limits_and_is_reached_evenly():
    """Steps of 0.05 rad a segment, at most 2 (twist: pi / 2); of an interval of two substeps the
    means are a quarter and three quarters of the change, both with what damping times its rate is.
    """
    env = InverseKinematicsVectorEnv(2, elements=5)
    env.reset(seed=0)
    push = torch.ones(2, 15, dtype=torch.float64)
    first, second = (given["curvature"] for given in env.task.inputs(push, env.state))
    lead = env.config.damping / env.config.control_interval
    torch.testing.assert_close(first / (0.25 + lead), second / (0.75 + lead))
    # over the elements, of 0.2 m, all segments turn by 0.05 rad: twist, and both ways of bending
    sums = 0.2 * second.unflatten(1, (5, 3)).sum(1)
    torch.testing.assert_close(sums, torch.full((2, 3), (0.75 + lead) * 5 * 0.05).double())
    near = env.state.memory + 0.98 * env.task.limits
    commanded = env.task.commanded(env.state, 50 * near)
    wanted = torch.tensor([2.0] * 10 + [math.pi / 2] * 5, dtype=torch.float64)
    torch.testing.assert_close(commanded, wanted.expand(2, -1))


def test_the_tip_moves_as_the_published_rod_does():
    """Within 2 % of its motion, RMS, where that rod's first edge is held and its steps damp: of an
    arm that bends from its foot, and whose damping holds the natural curvature back, 7 % off.
    """
    known = json.loads((Path(__file__).parent / "discrete_arm_tips.json").read_text())
    actions, theirs = (torch.tensor(known[x], dtype=torch.float64) for x in ("actions", "tips"))
    env = FollowTargetVectorEnv(4, planar=True, output="torch", autoreset_mode="Disabled")
    env.reset(seed=0)
    ours = []
    for k in range(30):
        env.step(actions[k // 10])
        ours += [env.state.beam.position[:, -1, [0, 2]]] if k % 5 == 4 else []
    apart, moved = torch.stack(ours) - theirs, theirs - torch.tensor([0.0, 1.0]).to(theirs)
    assert apart.norm() < 0.02 * moved.norm()


@pytest.mark.parametrize("elements", [20, 40])
def test_the_clamp_holds_the_first_fortieth_on_every_mesh(elements):
    """There nothing bends or twists: a tip couple turns the tip by what is left of the length."""
    env = FollowTargetVectorEnv(1, elements=elements, gravity=None)
    compliance = env.task.usual.compliance[:, 4, 4] / elements
    EI = 1e7 * math.pi / 4 * 0.05**4
    assert compliance.sum().item() == pytest.approx((1 - 1 / 40) / EI, rel=1e-12)
    assert compliance[0].item() == pytest.approx(
        (1 / 40 if elements == 20 else 0.0) / EI, abs=1e-15
    )


def test_targets_move_as_published():
    """Of 400 over 100 intervals: all at 0.5 m/s, in the box but for one interval's way; a new
    direction in 2.5 % of intervals (four deviations), besides those of who is outside; a sub-env's
    path does not depend on how many there are.
    """
    task = FollowTargetVectorEnv(400, elements=5).task
    many, few = (FollowTargetVectorEnv(n, elements=5) for n in (400, 2))
    many.reset(seed=0), few.reset(seed=0)
    now, own, turned, inside = many.state, few.state, 0, 0
    for _ in range(100):
        place, velocity = task.moving(now)
        torch.testing.assert_close(velocity.norm(dim=-1), torch.full((400,), 0.5).double())
        assert ((place > task.low - 0.0501) & (place < task.high + 0.0501)).all()
        within = ((place >= task.low) & (place <= task.high)).all(-1)
        ends = [
            type(x)(**{**vars(x), "memory": m, "steps": x.steps + 1})
            for x, m in ((s, task.next_memory(s, s.acting)) for s in (now, own))
        ]
        after = task.moving(ends[0])[1]
        turned += int((within & (after != velocity).any(-1)).sum())
        inside += int(within.sum())
        now, own = ends
    torch.testing.assert_close(now.memory[:2], own.memory, rtol=0, atol=0)
    share, spread = turned / inside, (0.025 * 0.975 / inside) ** 0.5
    assert abs(share - 0.025) < 4 * spread


@pytest.mark.parametrize(
    ("d", "off", "reward"),
    [
        (0.2, 0.3, -0.04 - 0.045),
        (0.07, 0.2, -0.0049 - 0.02 + 1 - 0.1),
        (0.07, 0.05, -0.0049 - 0.00125 + 1.5 - 0.025),
        (0.04, 0.2, -0.0016 - 0.02 + 4 - 0.4),
        (0.04, 0.07, -0.0016 - 0.00245 + 4.5 - 0.14),
        (0.04, 0.01, -0.0016 - 0.00005 + 6 - 0.02),
    ],
)
def test_rewards_are_as_published(d, off, reward):
    kinematics, follow = (
        kind(1, elements=5) for kind in (InverseKinematicsVectorEnv, FollowTargetVectorEnv)
    )
    for env in (kinematics, follow):
        env.reset(seed=0)
        env.state.measures["distance"] = torch.tensor([d])
    kinematics.state.measures["misaligned"] = torch.tensor([off])
    assert -kinematics.task.cost(kinematics.state).item() == pytest.approx(reward, rel=1e-6)
    bonus = 2.0 if d < 0.05 else 0.5 if d < 0.1 else 0.0
    assert -follow.task.cost(follow.state).item() == pytest.approx(-(d**2) + bonus, rel=1e-6)


def test_a_smooth_reward_has_the_bonuses_as_its_limit_and_leads_to_them():
    """Of a width of 1 mm, 1 cm and more from the steps it is the published one, to exp(-10) of a
    bonus; of 3 cm its slope is that of differences, and at the first step ten times that of d^2.
    """

    def rewards(env, d):
        env.state.measures["distance"] = d
        return -env.task.cost(env.state)

    apart = torch.tensor([0.0, 0.04, 0.06, 0.09, 0.11, 0.3], dtype=torch.float64)
    sharp, soft, plain = (
        FollowTargetVectorEnv(6, elements=5, smooth=smooth) for smooth in (1e-3, 0.03, 0.0)
    )
    for env in (sharp, soft, plain):
        env.reset(seed=0)
    torch.testing.assert_close(rewards(sharp, apart), rewards(plain, apart), rtol=0, atol=1e-4)
    d = torch.full((6,), 0.05, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(rewards(soft, d).sum(), d)
    around = rewards(soft, d.detach() + 1e-6) - rewards(soft, d.detach() - 1e-6)
    torch.testing.assert_close(slope, around / 2e-6, rtol=1e-6, atol=0)
    assert (slope < -10 * 2 * 0.05).all()


def test_the_tip_is_turned_by_twist():
    """Upright without gravity, all segments twisted by 0.1 rad: the tip has turned about z by half
    a radian, to where a target of that turn is not misaligned.
    """
    env = InverseKinematicsVectorEnv(1, gravity=None, **SMALL | {"substeps": 4})
    _, info = env.reset(seed=0, options={"goal": [0.0, 0.0, 1.0, 0.5]})
    assert info["misaligned"][0] == pytest.approx(math.sin(0.25) ** 2, rel=1e-6)
    twist = np.concatenate((np.zeros(10), np.ones(5)))[None]
    signs = []
    for k in range(30):
        observation, *_, info = env.step(twist if k < 2 else 0 * twist)
        signs.append(info["misaligned"][0])
    assert signs[-1] < 1e-9 and info["distance"][0] < 1e-9
    np.testing.assert_allclose(observation[0, :4], observation[0, 22:26], atol=1e-5)


def test_resolved_rate_follows():
    """Thirty intervals from the start, in space and in the plane: nearer than without action, and
    by more reward.
    """
    for planar in (False, True):
        env = FollowTargetVectorEnv(8, planar=planar, elements=5, autoreset_mode="Disabled")
        scores = []
        for controller in (Zero(), ResolvedRate(env)):
            observation, _ = env.reset(seed=0)
            controller.begin(env)
            total = 0.0
            for _ in range(30):
                observation, reward, *_, info = env.step(controller(observation))
                total = total + reward
            scores.append((total.mean(), info["distance"].mean()))
        assert scores[1][0] > scores[0][0] + 1 and scores[1][1] < 0.5 * scores[0][1]
    with pytest.raises(ValueError, match="a soft arm"):
        ResolvedRate(TipReachVectorEnv(1, elements=2))
    with pytest.raises(ValueError, match=r"damping = 0\.0 was given; a positive"):
        ResolvedRate(FollowTargetVectorEnv(1), damping=0.0)  # all at their bounds leave nothing


def test_resolved_rate_makes_the_most_of_bounded_actions():
    """The least squares of the docstring under the bounds of actions, in random shapes, some
    commands at their limits: by the conditions of Karush, Kuhn and Tucker where an action is free,
    to 1e-9, which actions that are merely clipped do not meet. Commands stay within limits.
    """
    env = FollowTargetVectorEnv(16, elements=5, output="torch", autoreset_mode="Disabled")
    env.reset(seed=3)
    for _ in range(45):
        env.step(2 * torch.rand(16, 10, generator=torch.Generator().manual_seed(1)) - 1)
    now, task, damping = env.state, env.task, 0.01
    command = task.command(now)
    assert (command.abs() == 2.0).any()
    tip = now.beam.position[:, -1]
    target = tip + 0.08 * torch.tensor([[1.0, 0.5, -0.7]], dtype=tip.dtype)
    controller = ResolvedRate(env, damping=damping, lead=0.0)
    controller.begin(env)
    action = controller.towards(now, target, target)
    after = command + task.change * action
    assert action.abs().max() <= 1 and after.abs().max() <= 2 + 1e-12
    J = task.change * task.tip_jacobian(now)[0]
    eye = damping**2 * torch.eye(3, dtype=J.dtype)

    def slope(x):
        off = (J @ x[..., None])[..., 0] - (target - tip)
        return (J.mT @ off[..., None])[..., 0] + damping**2 * x

    free = (action.abs() < 1 - 1e-9) & (after.abs() < 2 - 1e-9)
    assert 0.2 < free.double().mean() < 0.9
    assert (slope(action) * free).abs().max() < 1e-9
    clipped = (J.mT @ torch.linalg.solve(J @ J.mT + eye, (target - tip)[..., None]))[..., 0]
    assert (slope(clipped.clamp(-1, 1)) * free).abs().max() > 1e-4


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (FollowTargetVectorEnv, dict(elements=12), "a multiple of 5"),
        (FollowTargetVectorEnv, dict(force=(1.0, 1.0)), "force was given"),
        (FollowTargetVectorEnv, dict(turns=1.5), "turns = 1.5"),
        (FollowTargetVectorEnv, dict(bend=0.0), "bend = 0.0"),
        (FollowTargetVectorEnv, dict(method="rk4", form="block_rate", gravity=None), "'nodal'"),
        (InverseKinematicsVectorEnv, dict(planar=True), "planar = True"),
        (InverseKinematicsVectorEnv, dict(yaw=4.0), "yaw = 4.0"),
    ],
)
def test_bad_arguments_are_refused(kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        kind(**arguments)


def test_resolved_rate_leads_the_turn_too():
    """To a place and a turn about the vertical that the arm can have, after 10 s within 2 cm and
    0.02; without `turn` it comes to the place alone.
    """
    off = []
    env = InverseKinematicsVectorEnv(1, elements=5, output="torch", autoreset_mode="Disabled")
    for turn in (0.2, 0.0):
        observation, _ = env.reset(seed=0, options={"goal": [0.3, 0.2, 0.8, 0.8]})
        controller = ResolvedRate(env, gain=0.15, lead=0.15, damping=0.001, turn=turn)
        controller.begin(env)
        for _ in range(100):
            observation, *_, info = env.step(controller(observation))
        assert info["distance"].item() < 0.02
        off.append(info["misaligned"].item())
    assert off[0] < 0.02 and off[1] > 0.1
