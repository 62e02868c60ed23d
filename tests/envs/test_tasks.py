"""Every registered task keeps the contract; and what each of them says of itself is so."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
import torchbeam_envs
from gymnasium.utils.env_checker import check_env

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.extend import quaternions as quat

SMALL = dict(elements=2, substeps=1)
ARMS = dict(elements=5, substeps=1)  # of a segment each
EPISODES = json.loads((Path(__file__).parent / "env_episodes.json").read_text())
TASKS = [
    "TipReach", "TipTrack", "FlutterHold", "Slew", "Payload", "TwoLink", "FollowTarget",
    "ReachObstacles", "Peg", "Gripper",
]  # fmt: skip
VERSION = dict.fromkeys(TASKS, 1) | {"Payload": 2, "ReachObstacles": 0}
IDS = [f"torchbeam/{t}{planar}-v{VERSION[t]}" for t in TASKS for planar in ("", "Planar")]
SPATIAL = "InverseKinematics", "TrackTarget", "ReachPose", "ReachBehind", "ReachBehindNest"
ARM_IDS = [f"torchbeam/{name}-v{int(name == 'InverseKinematics')}" for name in SPATIAL]
IDS += ARM_IDS
# each task in its plane, and one in space: they differ in the beam alone
ONCE = [
    pytest.param(id, marks=[pytest.mark.long] * (id not in ("torchbeam/TipReach-v1", *ARM_IDS[:3])))
    if "Planar" not in id
    else id
    for id in IDS
]


def small(id):
    if "Obstacles" in id:  # of half a second an interval
        return dict(elements=5, substeps=10)
    return ARMS if "Target" in id or id in ARM_IDS else SMALL


def vector(id, n, **changes):
    return gymnasium.make_vec(id, num_envs=n, **{**small(id), **changes})


def once_long(ids):
    """What takes long to compile, and is another's code but for a third axis, is `long`."""
    slow = "torchbeam/Peg-v1", "torchbeam/Gripper-v1"
    return [pytest.param(id, marks=[pytest.mark.long] * (id in slow)) for id in ids]


@pytest.mark.parametrize("id", once_long(IDS))
def test_contract(id):
    """Gymnasium's own checker; a spec that goes through JSON; observations within their bounds
    under wild actions; an end.
    """
    env = gymnasium.make(id, max_episode_steps=4, **small(id))
    check_env(env.unwrapped, skip_render_check=True)
    spec = gymnasium.envs.registration.EnvSpec.from_json(gymnasium.spec(id).to_json())
    assert json.loads(env.spec.to_json())["id"] == id and spec.max_episode_steps >= 50
    assert env.metadata["render_modes"] == ["rgb_array", "human"]
    observation, _ = env.reset(seed=1)
    for k in range(4):
        assert observation in env.observation_space
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (
            np.isfinite(reward)
            and not info["solver_failed"]
            and not terminated
            and truncated == (k == 3)
        )


@pytest.mark.parametrize("make", [vector, lambda id, n: gymnasium.make(id, **small(id)).unwrapped])
@pytest.mark.parametrize("id", IDS)
def test_a_pickled_env_is_the_env(id, make):
    """As other processes get it, and copies: in the midst of episodes, with its random numbers."""
    env = make(id, 2)
    first, _ = env.reset(seed=1)
    there = pickle.loads(pickle.dumps(env))
    assert np.array_equal(there.reset()[0], env.reset()[0])  # the next episodes
    assert np.array_equal(there.reset(seed=1)[0], first)


@pytest.mark.parametrize("id", ONCE)
def test_vector_is_single_and_everything_may_vary(id):
    """Two members with parameters drawn at random, noise and every sensor, against two single envs;
    to rounding.
    """
    made = dict(randomize=True, noise=0.01, sensors=("tip", "gauges", "full"), params_in_info=True)
    many = vector(id, 2, **made)
    each = [gymnasium.make(id, **small(id), **made) for _ in range(2)]
    observation, info = many.reset(seed=4)
    assert all(np.ptp(value) > 0 for value in info["params"].values())
    for i, one in enumerate(each):
        np.testing.assert_allclose(one.reset(seed=4 + i)[0], observation[i], atol=1e-6)
    for _ in range(2):
        action = many.action_space.sample()
        observation, reward, *_ = many.step(action)
        for i, one in enumerate(each):
            o, r, *_ = one.step(action[i])
            np.testing.assert_allclose(o, observation[i], atol=1e-5)
            assert r == pytest.approx(reward[i], rel=1e-5)


@pytest.mark.parametrize("id", ONCE)
def test_invalid_actions_and_failures_keep_to_themselves(id):
    """Member 1 of 3 acts NaN, then gets an impossible velocity: it fails, its neighbours do not
    change by a bit.
    """
    well, ill = (vector(id, 3, autoreset_mode="Disabled") for _ in range(2))
    others, push = [0, 2], np.full(well.action_space.shape, 0.2)
    bad = push.copy()
    bad[1] = np.nan
    for env in (well, ill):
        env.reset(seed=0)
    well.step(push)
    assert ill.step(bad)[4]["action_invalid"].tolist() == [False, True, False]
    beam = ill.state.beam
    thrown = torch.where(torch.tensor([False, True, False])[:, None, None], 1e20, beam.velocity)
    ill.set_state(replace(ill.state, beam=replace(beam, velocity=thrown)))
    a, b = well.step(push), ill.step(push)
    np.testing.assert_array_equal(a[0][others], b[0][others])
    assert b[2].tolist() == [False, True, False] and np.isfinite(b[0]).all()
    left, most = ill.config.intervals - 1, ill.simulation.worst
    assert b[1][1] == (ill.config.failure_reward if most is None else -most * left)
    assert b[4]["solver_failed"].tolist() == [False, True, False]


@pytest.mark.parametrize("task", TASKS)
def test_gradient_of_a_return_by_policy_weights(task):
    """16 steps of a linear policy in the plane; directional derivative against central differences
    with h = 1e-5, whose truncation and rounding are below 1e-5 of it.
    """
    env = vector(f"torchbeam/{task}Planar-v{VERSION[task]}", 2, output="torch")
    torch.manual_seed(0)
    policy = torch.nn.Linear(*env.single_observation_space.shape, *env.single_action_space.shape)
    weights = list(policy.parameters())
    directions = [torch.randn_like(w) for w in weights]

    def total():
        observation, _ = env.reset(seed=2)
        rewards = 0.0
        for _ in range(16):
            observation, reward, *_ = env.step(0.2 * torch.tanh(policy(observation)))
            rewards = rewards + reward.sum()
        return rewards

    slope = sum(
        (g * d).sum()
        for g, d in zip(torch.autograd.grad(total(), weights), directions, strict=True)
    ).item()

    @torch.no_grad()
    def moved(h):
        for w, d in zip(weights, directions, strict=True):
            w += h * d
        value = total().item()
        for w, d in zip(weights, directions, strict=True):
            w -= h * d
        return value

    assert slope == pytest.approx((moved(1e-5) - moved(-1e-5)) / 2e-5, rel=1e-5)


# TipTrack


@pytest.mark.parametrize(
    ("path", "planar"),
    [
        ("circle", False),
        ("random", False),
        ("lemniscate", True),
        pytest.param("lemniscate", False, marks=pytest.mark.long),
        pytest.param("circle", True, marks=pytest.mark.long),
        pytest.param("random", True, marks=pytest.mark.long),
    ],
)
def test_target_of_tip_track(path, planar):
    """It starts at the tip, stays within the share of the force, closes after a period, and is
    where the preview said.
    """
    env = torchbeam_envs.TipTrackVectorEnv(
        8, path=path, planar=planar, period=0.4, delay=0, **SMALL
    )
    observation, _ = env.reset(seed=0)
    d = 2 if planar else 3
    np.testing.assert_allclose(observation[:, :d], 0, atol=1e-5)  # the polynomial's error
    t = torch.linspace(0.1, 0.5, 81, dtype=torch.float64).expand(8, -1)  # after the ramp
    target = env.task.target_at(env.state, t)
    torch.testing.assert_close(target[:, 0], target[:, -1])
    force = torchbeam_envs.reach.holding_action(
        env.scene, target[0, ::20], env.task.actions, env.task.inputs
    )
    assert torch.linalg.vector_norm(force, dim=-1).max() < 0.5 + 1e-3
    if path == "circle" and not planar:
        torch.testing.assert_close(
            *(torch.linalg.vector_norm(f, dim=-1) for f in (force[1:], force[:-1])),
            rtol=1e-3,
            atol=0,
        )
    for _ in range(6):
        ahead = observation[:, 2 * d : 3 * d] * env.task.length
        velocity = observation[:, d : 2 * d] * env.task.speed.item()
        before = env.task.target(env.state)[:, 0, env.task.vector].numpy()
        observation = env.step(np.zeros(env.action_space.shape))[0]
        target = env.task.target(env.state)[:, 0]
        np.testing.assert_allclose(
            ahead, (target - env.start.position[:, -1])[:, env.task.vector], atol=1e-5
        )
        np.testing.assert_allclose(
            velocity * 0.02, target[:, env.task.vector].numpy() - before, atol=1e-5
        )


# FlutterHold


def test_thrust_is_becks():
    """Undamped, the strip is stable at 0.95 and flutters at 1.05 times Beck's load; 12 elements are
    within 2 % of 20.05.
    """
    growth = []
    for thrust in (0.95, 1.05):
        env = torchbeam_envs.FlutterHoldVectorEnv(1, thrust=thrust, damping=None, elements=12)
        push = tb.Scene(
            env.scene.beam, [e for e in env.scene.effects if getattr(e, "follower", False)]
        )
        growth.append(tb.modes(push, tb.equilibrium(push), count=2).eigenvalue.real.max().item())
    assert abs(growth[0]) < 1e-3 and growth[1] > 1


def test_flutter_grows_unless_it_is_held():
    """Without action two strips are lost within 2 s; linear feedback of tip and mid span, within
    the bounds of the force, keeps two others. The gains come from a random search.
    """
    gains = np.array([5.9, -5.8, -137.0, -6.7, -0.4])
    held = np.array([0.0, 1.0, 0.0, 1.0])
    env = vector(
        "torchbeam/FlutterHoldPlanar-v1", 4, elements=6, substeps=2, autoreset_mode="Disabled"
    )
    observation, _ = env.reset(options={"goal": [[0.2], [0.2], [-0.1], [-0.1]]})
    for _ in range(100):
        action = held * np.clip(observation[:, [1, 3, 5, 7, 8]] @ gains, -1, 1)
        observation, _, lost, late, info = env.step(action[:, None])
    np.testing.assert_array_equal(lost, held == 0)
    np.testing.assert_array_equal(late, held == 1)
    assert info["distance"][held == 1].max() < 1e-3 and info["lost"].tolist() == lost.tolist()


def test_a_kicked_strip_remembers_how_it_starts_to_move():
    """What generalized alpha remembers of the start is that of the kicked strip, which damping
    brakes, not of one at rest.
    """
    env = torchbeam_envs.FlutterHoldVectorEnv(2, method="generalized_alpha", **SMALL)
    env.reset(seed=0)
    beam, plant = env.state.beam, env.state.plant
    idle = {
        name: torch.zeros(2, size, dtype=beam.velocity.dtype)
        for name, size in plant.scene.inputs.items()
    }
    wanted = plant.stepper.begin(beam.plain(), **idle)
    assert wanted.straining.abs().max() > 0.01
    for name in ("acceleration", "straining"):
        torch.testing.assert_close(getattr(beam, name), getattr(wanted, name), rtol=1e-5, atol=1e-6)


# Slew


@pytest.mark.parametrize("up", [None, (0.0, 1.0, 0.0)])
def test_hub_and_arm_are_turned_by_the_torque(up):
    """A stiff arm (10,000 times) under full torque for five intervals: angle = torque
    t^2 / 2 / (hub + arm). On N = 2 elements, mass half lumped and half consistent, the arm's
    inertia is m L^2 / 3 (1 + 1 / (4 N^2)). What is left is its bending. The hub turns about z,
    whichever way the section's axes are.
    """
    env = torchbeam_envs.SlewVectorEnv(2, delay=0, up=up, **SMALL)
    env.reset(seed=0, options={"params": {"stiffness": 1e4, "inertia": [0.05, 0.1]}, "goal": [0.0]})
    for _ in range(5):
        *_, info = env.step(np.array([[1.0, 0.0, 0.0]] * 2))
    arm = env.task.usual.mass[0, 0, 0].item() * 1.5**3 / 3 * (1 + 1 / 16)
    np.testing.assert_allclose(
        -info["angle"], 0.1**2 / 2 / (np.array([0.05, 0.1]) + arm), rtol=2e-3
    )
    assert (env.state.beam.position[..., 2].abs() < 1e-9).all()


def test_slew_can_be_done():
    """Feedback of the hub and of the tip's lag behind it brings two arms to rest at their angles,
    to 2 mm of 1.5 m. The gains come from a random search.
    """
    env = vector("torchbeam/SlewPlanar-v1", 2, elements=6, substeps=1, autoreset_mode="Disabled")
    observation, _ = env.reset(options={"goal": [[1.2], [-0.6]]})
    for _ in range(100):
        to_go, rate, *tip = observation[:, 2:8].T
        hub = env.state.goal[:, 0].numpy() - to_go
        lag, speed = (
            np.cos(hub) * y - np.sin(hub) * x for x, y in ((1 + tip[0], tip[1]), (tip[2], tip[3]))
        )
        torque = 1.9 * to_go - 2.7 * rate - 3.75 * lag - 1.85 * speed
        action = np.clip(np.stack((torque, -9.6 * (speed - rate)), 1), -1, 1)
        observation, *_, info = env.step(action)
    assert info["distance"].max() < 2e-3 and abs(info["angle"]).max() < 2e-3


# Payload


def test_payload_hangs_and_swings():
    """All start where a dead weight of the usual mass has the tip; a heavier mass sinks, and falls
    behind under the same force; targets do not depend on it.
    """
    options = dict(autoreset_mode="Disabled", params_in_info=True)
    env = torchbeam_envs.PayloadVectorEnv(3, **options, **SMALL)
    _, info = env.reset(seed=0, options={"params": {"payload": [0.0, 0.05, 0.2]}})
    np.testing.assert_allclose(info["params"]["payload"], [0, 0.05, 0.2])
    weight = torch.tensor([0, 0, -9.81 * 0.1])
    strip = tb.Scene(env.scene.beam, [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=weight)])
    hangs = tb.equilibrium(strip).tip.position.expand(3, -1)
    torch.testing.assert_close(env.state.beam.tip.position, hangs, rtol=0, atol=1e-7)
    goal = env.state.goal
    for _ in range(6):
        env.step(np.array([[1.0, 0.0]] * 3))
    moved = env.state.beam.tip.position[:, 1]
    assert moved[0] > 1.2 * moved[1] > 1.2**2 * moved[2] > 0
    sunk = (hangs - env.state.beam.tip.position)[:, 2]
    assert sunk[2] > 0 > sunk[1] > sunk[0]
    env.reset(seed=0)
    torch.testing.assert_close(env.state.goal, goal, rtol=0, atol=0)
    assert env.state.plant.params["payload"].unique().numel() == 3


@pytest.mark.parametrize("id", ["torchbeam/Payload-v2", "torchbeam/PayloadPlanar-v2"])
def test_the_first_observation_does_not_tell_the_payload(id):
    """A regression on half of 400 first observations, their squares and products, says no more of
    the others' masses than their mean does (as it told them to 2 g of 29 g); those after half a
    period of free motion tell to a tenth of the deviation.
    """
    env = vector(id, 400, autoreset_mode="Disabled", params_in_info=True)
    seen, info = env.reset(seed=0)
    kg = info["params"]["payload"]

    def unexplained(seen):
        seen = seen[:, seen.std(0) > 1e-6]
        seen = (seen - seen.mean(0)) / seen.std(0)
        i, j = np.triu_indices(seen.shape[1])
        seen = np.concatenate((np.ones((400, 1)), seen, seen[:, i] * seen[:, j]), 1)
        fit = np.linalg.lstsq(seen[:200], kg[:200], rcond=1e-6)[0]
        return np.std(kg[200:] - seen[200:] @ fit) / kg[200:].std()

    assert unexplained(seen) > 0.95
    for _ in range(10):
        seen = env.step(np.zeros(env.action_space.shape))[0]
    assert unexplained(seen) < 0.1


# TwoLink


@pytest.mark.parametrize("planar", [True, False])
def test_two_stiff_links_are_turned_by_their_motors(planar):
    """Links and payload of 10,000 times the stiffness under full torques for four intervals of
    5 ms: the angles are those of M q'' = (torques), rigid, where it starts (in space the elbow's
    motor turns the forearm alone, about the upper arm). On N = 2 elements, mass half lumped and
    half consistent, a link's inertia about its end is m L^2 / 3 (1 + 1 / (4 N^2)). What is left is
    the blow with which the torques set in: the rotors turn before the links, by 1 % of the angles.
    """
    env = torchbeam_envs.TwoLinkVectorEnv(
        1, planar=planar, delay=0, control_interval=5e-3, payload=0.1, **SMALL
    )
    env.reset(seed=0, options={"params": {"stiffness": 1e4}})
    for _ in range(4):
        env.step(np.ones((1, 2)))
    angle, _ = env.task.hinge_motion(env.state)
    mass, half, kg, rotor = env.task.usual.mass[0, 0, 0].item() * 0.5, 0.5, 0.1, 0.02
    link = mass * half**2 / 3 * (1 + 1 / 16)
    fore = link + kg * half**2
    whole = 2 * rotor + link + (mass + kg + 0.05) * half**2 + fore
    M = torch.tensor([[whole, fore], [fore, fore]] if planar else [[whole, 0.0], [0.0, fore]])
    rigid = torch.linalg.solve(M.double(), torch.tensor([1.5, 0.5], dtype=torch.float64))
    torch.testing.assert_close(angle[0], 0.02**2 / 2 * rigid, rtol=2e-2, atol=0)


@pytest.mark.parametrize("default", [torch.float64, torch.float32])
@pytest.mark.parametrize("planar", [True, False])
def test_the_resting_arm_is_where_the_target_is(planar, default):
    """At any angles of the hinges, whatever torch's default dtype is; its rates are those of its
    places, by a difference over an interval, whose error is its square's.
    """
    torch.set_default_dtype(default)
    env = torchbeam_envs.TwoLinkVectorEnv(3, planar=planar, control_interval=1e-3, **SMALL)
    env.reset(seed=0)
    now = replace(env.state, steps=torch.full((3,), 700))
    here, after = (env.task.resting(replace(now, steps=now.steps + k)) for k in (0, 1))
    torch.testing.assert_close(here.position[:, -1], env.task.target(now)[:, 0], rtol=0, atol=1e-12)
    moved = (after.position - here.position) / 1e-3
    torch.testing.assert_close(here.velocity, moved, rtol=0, atol=1e-2 * moved.abs().max().item())
    n = here.position.shape[1] // 2
    torch.testing.assert_close(here.position[:, n - 1], here.position[:, n], rtol=0, atol=1e-12)
    turned = quat.multiply(quat.conjugate(here.rotation), after.rotation)
    torch.testing.assert_close(here.spin, quat.logarithm(turned) / 1e-3, rtol=0, atol=2e-2)


@refusals(
    ("TwoLink", dict(torque=(1.0, -1.0)), "torque = "),
    ("TwoLink", dict(angle=2.0), "angle = 2.0"),
    ("TwoLink", dict(direction=(0, 1, 0)), "direction was given"),
    ("TwoLink", dict(gravity=(0, 0, -9.81)), "gravity or another form was given"),
    ("TipTrack", dict(path="square"), "path = 'square'"),
    ("TipTrack", dict(reach=1.5), "reach = 1.5"),
    ("TipTrack", dict(period=0.0), "period = 0.0"),
    ("TipTrack", dict(preview=0), "preview = 0"),
    ("Slew", dict(angle=4.0), "angle = 4.0"),
    ("Slew", dict(gravity=(0, 0, -9.81)), "gravity or another form was given"),
    ("Payload", dict(payload=-0.1), "payload = -0.1"),
    ("FlutterHold", dict(thrust=-1.0), "thrust = -1.0"),
    ("FlutterHold", dict(kick=np.inf), "kick = inf"),
)
def test_bad_arguments_are_refused(task, arguments):
    getattr(torchbeam_envs, f"{task}VectorEnv")(**arguments)


@pytest.mark.parametrize("id", once_long(sorted(EPISODES)))
def test_a_version_keeps_its_numbers(id):
    """Four intervals of three sub-envs under actions drawn with seed 7, as v0 has always had them:
    a change of these is a new version of the environment. Rewards to 1e-5 of their size, float32
    observations to 1e-5: solver's tolerance and rounding.
    """
    env = gymnasium.make_vec(id, num_envs=3)
    actions = np.random.default_rng(7)
    env.reset(seed=3)
    for expected in EPISODES[id]["rewards"]:
        observation, reward, *_ = env.step(actions.uniform(-1, 1, env.action_space.shape))
        np.testing.assert_allclose(reward, expected, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(observation, EPISODES[id]["observation"], rtol=0, atol=1e-5)


def test_every_environment_has_its_numbers():
    assert set(EPISODES) == {id for id in gymnasium.registry if id.startswith("torchbeam/")}


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
def test_gauges_and_turns_of_a_plane_are_about_its_normal(up):
    """However the section lies in it: the tip's turn that "full" reads last but one is that of its
    tangent in the plane, up to the sign of the section's own axis, and the gauges' curvatures of
    the two elements (over 1/L) add up to it. To rounding.
    """
    env = torchbeam_envs.TipReachVectorEnv(
        1,
        planar=True,
        up=up,
        sensors=("gauges", "full"),
        gravity=None,
        delay=0,
        output="torch",
        force=(0.3,),
        reach=0.3,
        engine="eager",
        **SMALL,
    )
    env.reset(seed=0)
    for _ in range(3):
        observation = env.step(np.ones((1, 1)))[0][0]
    along = env.state.beam.tip.rotation[0, :, 0]
    angle = torch.atan2(along[1], along[0]).abs()
    assert angle > 1e-3
    # behind where the target is
    read = torch.stack((observation[-2], (observation[2] + observation[3]) / 2)).abs()
    torch.testing.assert_close(read, angle.expand(2), rtol=0, atol=1e-9)
