"""What changes with the episode (parameters, goals), what is seen of the beam (sensors, noise), and
motion in a plane.
"""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from torchbeam_envs import (
    GripperVectorEnv,
    PayloadVectorEnv,
    PegVectorEnv,
    TipReachEnv,
    TipReachVectorEnv,
    aluminium_strip,
)
from torchbeam_envs.noise import normal

import torchbeam as tb
from tests.cases.refusals import refusals

SMALL = dict(elements=2, substeps=1)
VARIED = dict(randomize=True, noise=0.01, **SMALL)


def rollout(env, steps, seed=3):
    """Observations of `steps` steps under actions that depend on the sub-env's number alone."""
    push = np.stack(
        [np.random.default_rng(i).uniform(-1, 1, (steps, 2)) for i in range(env.num_envs)], 1
    )
    seen = [env.reset(seed=seed)[0]]
    return np.stack(seen + [env.step(action)[0] for action in push])


def test_numbers_do_not_depend_on_the_number_of_envs_or_on_autoreset():
    """Parameters, targets and noise of two episodes of three steps; NextStep resets in a step of
    its own. To 1e-6, for batched products may round differently.
    """
    few, many, same = (
        TipReachVectorEnv(n, max_episode_steps=3, autoreset_mode=mode, **VARIED)
        for n, mode in ((2, "NextStep"), (5, "NextStep"), (2, "SameStep"))
    )
    a, b, c = rollout(few, 6), rollout(many, 6), rollout(same, 5)
    np.testing.assert_allclose(a, b[:, :2], atol=1e-6)
    np.testing.assert_allclose(a[:3], c[:3], atol=1e-6)
    # the first observation of the second episode
    np.testing.assert_allclose(a[4, :, :-2], c[3, :, :-2], atol=1e-6)
    for name, values in few.state.plant.params.items():
        if values.ndim:
            torch.testing.assert_close(values, many.state.plant.params[name][:2])
            torch.testing.assert_close(values, same.state.plant.params[name])


def test_parameters_given_at_reset_are_those_of_the_beam():
    """As if the env had been made with that section and that damping; its neighbour does not change
    by a bit.
    """
    strip = aluminium_strip()
    made = TipReachEnv(
        section=tb.Section(strip.compliance / 1.3, strip.mass * 0.8), damping=2e-3, **SMALL
    )
    given, plain = (TipReachVectorEnv(2, **SMALL) for _ in range(2))
    params = {"stiffness": [1.3, 1.0], "mass": [0.8, 1.0], "damping": [2e-3, 1e-3]}
    goal = [1.4, 0.2, -0.1]
    _, info = given.reset(seed=0, options={"params": params, "goal": goal})
    np.testing.assert_allclose(info["params"]["stiffness"], [1.3, 1.0])
    made.reset(options={"goal": goal})
    plain.reset(seed=0, options={"goal": goal})
    push = np.array([0.7, -0.4])
    for _ in range(4):
        a, b = made.step(push), given.step(np.stack([push, push]))
        c = plain.step(np.stack([push, push]))
        assert a[4]["distance"] == pytest.approx(b[4]["distance"][0], rel=1e-6)
        assert b[4]["distance"][1] == pytest.approx(c[4]["distance"][1], rel=1e-6)
    assert a[4]["distance"] != pytest.approx(c[4]["distance"][0], rel=1e-2)


def test_reset_of_one_member_with_other_parameters():
    """Member 1 gets another beam in the middle of the others' episodes, and set_state brings the
    old one back.
    """
    made = dict(autoreset_mode="Disabled", randomize={"stiffness": (0.8, 1.2)}, **SMALL)
    env, calm = (TipReachVectorEnv(3, **made) for _ in range(2))
    push = np.full((3, 2), 0.6)
    for e in (env, calm):
        e.reset(seed=0)
        e.step(push)
    kept, beam = env.state, env.state.beam
    env.reset(
        options={
            "reset_mask": np.array([False, True, False]),
            "params": {"stiffness": 2.0, "offset": 0.05},
        }
    )
    assert env.state.plant.params["stiffness"].tolist()[1] == 2.0 and env.state.plant.params[
        "offset"
    ].tolist() == [0, 0.05, 0]
    assert (
        env.state.beam.position[[0, 2]] == beam.position[[0, 2]]
    ).all() and env.state.steps.tolist() == [1, 0, 1]
    a, b = env.step(push)[0], calm.step(push)[0]
    np.testing.assert_allclose(a[[0, 2]], b[[0, 2]], atol=1e-6)
    env.set_state(kept)
    np.testing.assert_allclose(env.step(push)[0], b, atol=1e-6)


def test_gradient_by_a_parameter():
    """Of the distance after eight steps, by the stiffness of each beam; central differences in
    float64.
    """
    env = TipReachVectorEnv(2, output="torch", **SMALL)

    def far(stiffness):
        env.reset(seed=0, options={"params": {"stiffness": stiffness}})
        for _ in range(8):
            info = env.step(torch.full((2, 2), 0.5, dtype=torch.float64))[4]
        return info["distance"]

    stiffness = torch.tensor([1.0, 1.2], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(far(stiffness).sum(), stiffness)
    with torch.no_grad():
        difference = (far(stiffness + 1e-5) - far(stiffness - 1e-5)) / 2e-5
    torch.testing.assert_close(slope, difference, rtol=1e-5, atol=1e-8)


def test_parameters_that_cannot_be_solved_end_their_own_episode():
    """One of 256 beams is far too soft for its weight: its observation is finite, it fails at once,
    and nobody else notices.
    """
    stiffness = np.ones(256)
    stiffness[17] = 1e-30
    well, ill = (TipReachVectorEnv(256, autoreset_mode="Disabled", **SMALL) for _ in range(2))
    well.reset(seed=0, options={"params": {"stiffness": 1.0}})
    observation, info = ill.reset(seed=0, options={"params": {"stiffness": stiffness}})
    assert np.isfinite(observation).all() and info["solver_failed"].nonzero()[0].tolist() == [17]
    push = np.full((256, 2), 0.3)
    a, b = well.step(push), ill.step(push)
    others = np.arange(256) != 17
    np.testing.assert_allclose(a[0][others], b[0][others], atol=1e-6)
    assert (
        b[2].nonzero()[0].tolist() == [17]
        and b[1][17] == -ill.config.intervals * ill.simulation.worst
        and np.isfinite(b[0]).all()
        and np.isfinite(b[1]).all()
    )
    ill.reset(options={"reset_mask": ~others, "params": {"stiffness": 1.0}})
    assert not ill.step(push)[2].any()


@pytest.mark.parametrize("count, engine", [(300, "auto"), (64, "eager"), (64, "auto")])
def test_equilibria_of_those_that_begin(monkeypatch, count, engine):
    """The equilibrium that 2 of many start from is found for a batch of 2; of few, by native code,
    for all, which takes less time. Their starts are the same to the bit as where all of these begin
    at once, and the others' stay.
    """
    options = dict(autoreset_mode="Disabled", randomize=True, engine=engine)
    env = TipReachVectorEnv(count, **{**SMALL, **options})
    env.reset(seed=0)
    before, solved, equilibrium = env.state, [], tb.equilibrium

    def watched(scene, **given):
        solved.append(scene.batch_shape)
        return equilibrium(scene, **given)

    monkeypatch.setattr(tb, "equilibrium", watched)
    begin = np.arange(count) < 2
    env.reset(seed=1, options={"reset_mask": begin})
    assert solved == [(count,) if (count, engine) == (64, "auto") else (2,)]
    assert env.scene.batch_shape == (count,)
    after, _ = env.state, env.reset(seed=1)
    for name in ("start", "beam"):
        own, others, fresh = (getattr(x, name).position for x in (after, before, env.state))
        assert torch.equal(own[2:], others[2:]) and not torch.equal(own[:2], others[:2])
        if engine == "auto":
            assert torch.equal(own[:2], fresh[:2])
        else:
            torch.testing.assert_close(own[:2], fresh[:2], rtol=0, atol=1e-12)


def test_a_target_out_of_reach():
    """It is taken as it is: the distance is what it is, the observation stays within its bounds."""
    env = TipReachEnv(**SMALL)
    observation, _ = env.reset(options={"goal": [0.0, 100.0, 0.0]})
    assert observation in env.observation_space
    observation, reward, *_, info = env.step([0.0, 0.0])
    assert (
        observation in env.observation_space
        and info["distance"] == pytest.approx(100, rel=0.02)
        and reward < -600
    )


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize(
    "sensors, sizes",
    [("tip", (6, 4)), ("gauges", (4, 2)), ("full", (24, 12)), (("gauges", "tip"), (10, 6))],
)
def test_sensors(planar, sensors, sizes):
    """Sizes; within bounds; what the tip is seen to do, it does; a gauge reads the curvature of
    bending to a circle.
    """
    env = TipReachVectorEnv(2, sensors=sensors, planar=planar, delay=0, gravity=None, **SMALL)
    env.reset(seed=0)
    for _ in range(5):
        observation = env.step(np.full(env.action_space.shape, 0.5))[0]
    d = 2 if planar else 3
    assert observation.shape[1] == d + sizes[planar] and (observation in env.observation_space)
    moved = ((env.state.beam.position - env.start.position)[:, -1] / env.task.length).numpy()
    if (tip := env.simulation.observer.tip) is not None:
        np.testing.assert_allclose(observation[:, d:][:, tip], moved[:, :d], atol=1e-6)
        gap = (env.state.goal - env.state.beam.position[:, -1]) / env.task.length
        np.testing.assert_allclose(observation[:, :d], gap[:, :d], atol=1e-6)
    if sensors == "gauges":
        circle = tb.equilibrium(tb.Scene(env.scene.beam, [tb.TipLoad(moment=(0, 0, 1.0))]))
        bent = env.sensors(circle)[..., [-1]]  # about z, 1/m
        expected = torch.full_like(bent, aluminium_strip().compliance[5, 5].item())
        torch.testing.assert_close(bent, expected, rtol=1e-6, atol=0)


def test_noise():
    """White, of the given size, on the sensors and through them on the gap, not on pending actions;
    zero noise is no noise.
    """
    quiet, loud = (TipReachVectorEnv(400, noise=noise, **SMALL) for noise in (0.0, 0.05))
    a, b = quiet.reset(seed=0)[0], loud.reset(seed=0)[0]
    e = b[:, 3:15] - a[:, 3:15]
    # 4800 numbers: 3 sigma
    assert e.std() == pytest.approx(0.05, rel=0.03) and abs(e.mean()) < 0.05 * 3 / 70
    assert abs(np.corrcoef(e.T) - np.eye(12)).max() < 0.2  # 4 sigma of a correlation of 400 pairs
    np.testing.assert_allclose((b - a)[:, :3] + e[:, :3], 0, atol=1e-6)
    assert (b[:, 15:] == 0).all()


def test_noise_is_normal():
    """Moments of 200,000 numbers of 1000 keys, to 4 sigma; successive steps and neighbouring keys
    have nothing in common.
    """
    key, step = torch.arange(1000), torch.zeros(1000, dtype=torch.long)
    x = torch.cat([normal(key, step + k, 4, torch.float64) for k in range(50)], 1)
    for power, moment, spread in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((x**power).mean() - moment) < 4 * (spread / x.numel()) ** 0.5
    assert abs((x[:, 4:] * x[:, :-4]).mean()) < 0.01 and abs((x[1:] * x[:-1]).mean()) < 0.01


def test_motion_in_a_plane_stays_there():
    env = gymnasium.make_vec("torchbeam/TipReachPlanar-v1", num_envs=2, **SMALL)
    assert env.action_space.shape == (2, 1) and env.observation_space.shape == (2, 11)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.ones((2, 1)))
    assert (env.state.beam.position[..., 2] == 0).all() and (env.state.goal[:, 2] == 0).all()
    space = TipReachVectorEnv(2, gravity=None, **SMALL)
    space.reset(seed=0)
    for _ in range(5):
        space.step(np.array([[1.0, 0.0]] * 2))
    torch.testing.assert_close(
        env.state.beam.position, space.state.beam.position, rtol=0, atol=1e-9
    )


@pytest.mark.parametrize(
    "name, bounds, warns",
    [
        ("stiffness", (80, 120), True),
        ("damping", (0.0, 1e-9), True),
        ("stiffness", (2.0, 8.0), False),
        ("mass", (1e-3, 0.5), False),
        ("offset", (-0.5, 0.5), False),
        ("tip_mass", (5.0, 6.0), False),  # whose range is not documented
    ],
)
def test_numbers_far_beyond_the_documented_range_are_warned_of(name, bounds, warns):
    """Per cent in place of a factor: stiffness is drawn from 0.8 to 1.2."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        TipReachVectorEnv(1, randomize={name: bounds}, **SMALL)
    said = [w for w in seen if "documented range" in str(w.message)]
    assert len(said) == warns and all(w.filename == __file__ for w in said)


@refusals(
    (dict(randomize={"colour": (0, 1)}), "the parameter 'colour'"),
    (dict(randomize={"mass": (0, 1)}), r"mass = \[0.0, 1.0\] was given"),
    (dict(randomize={"mass": (1.2, 1.0)}), "low, high"),
    (dict(randomize={"stiffness": (1, np.nan)}), r"stiffness = \[1.0, nan\] was given"),
    (dict(noise=-1.0), "noise = -1.0"),
    (dict(sensors="eyes"), "sensors = 'eyes' was given"),
    (dict(render_mode="ansi"), "render_mode = 'ansi'"),
    (dict(planar=True, force=()), r"force = \(\) was given"),
)
def test_bad_arguments_are_refused(arguments):
    TipReachVectorEnv(**arguments)


@refusals(
    ({"params": {"payload": 1}}, "the parameter 'payload'"),
    ({"params": {"mass": -1}}, "mass = -1"),
    ({"params": {"mass": [1, 1, 1]}}, r"mass of shape \(3,\)"),
    ({"goal": [0, 0]}, "a goal of shape"),
    ({"goal": [np.nan, 0, 0]}, "a goal of shape"),
    ({"seeds": 1}, "the reset option 'seeds'"),
)
def test_bad_options_are_refused(options):
    TipReachVectorEnv(2, **SMALL).reset(options=options)


def test_closed_env():
    for env in (TipReachVectorEnv(1, **SMALL), TipReachEnv(**SMALL)):
        env.reset()
        env.close()
        env.close()
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            env.step(np.zeros(env.action_space.shape))
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            env.reset()


def test_an_env_that_was_refused_can_be_closed():
    """Gymnasium up to 1.3 closes a vector env when it is deleted, also one whose constructor
    raised.
    """
    env = object.__new__(TipReachVectorEnv)
    env.close()
    assert env.closed


@pytest.mark.parametrize(
    ("dtype", "method"), [(torch.float32, "midpoint"), (torch.float64, "generalized_alpha")]
)
def test_other_precision_and_method(dtype, method):
    """Members that vary, begin at different times and fail nowhere; what float32 does is what
    float64 does to 1e-3.
    """
    made = dict(
        randomize=True,
        noise=0.0,
        autoreset_mode="SameStep",
        max_episode_steps=5,
        method=method,
        **SMALL,
    )
    env, same = (TipReachVectorEnv(3, dtype=d, **made) for d in (dtype, None))
    for e in (env, same):
        e.reset(seed=0)
        e.step(np.full((3, 2), 0.5))
        e.reset(options={"reset_mask": np.array([True, False, False])})
    assert env.state.observation.dtype == env.state.plant.params["mass"].dtype == dtype
    for _ in range(5):
        a, b = (e.step(np.full((3, 2), 0.5)) for e in (env, same))
        np.testing.assert_allclose(a[0], b[0], atol=1e-3)
        assert not a[2].any()
    assert env.state.steps.tolist() == [0, 1, 1]


def test_an_episode_that_failed_is_reset_alone():
    """Where parameters vary: the stepper of all remembers a failure, that of the fresh episode has
    none.
    """
    env = TipReachVectorEnv(
        3, autoreset_mode="Disabled", output="torch", randomize={"mass": (0.8, 1.2)}, **SMALL
    )
    env.reset(seed=0)
    now, masses = env.state, env.state.plant.params["mass"]
    far = now.beam.velocity.index_fill(0, torch.tensor([1]), 1e20)
    env.set_state(replace(now, beam=replace(now.beam, velocity=far)))
    info = env.step(torch.zeros(3, 2))[4]
    assert (
        info["solver_failed"].tolist() == [False, True, False] and env.state.plant.stepper.failures
    )
    env.reset(options={"reset_mask": [False, True, False]})
    fresh = env.state.plant
    assert not fresh.stepper.failures and (fresh.params["mass"] != masses).tolist() == [
        False,
        True,
        False,
    ]
    torch.testing.assert_close(
        fresh.scene.beam.mass[:, 0, 0, 0], env.task.usual.mass[0, 0, 0] * fresh.params["mass"]
    )
    assert not env.step(torch.zeros(3, 2))[4]["solver_failed"].any()


def test_parameters_are_told_to_those_who_ask():
    """By the option; as until now, with one warning, where nothing is said; else not at all."""
    vary = dict(randomize={"stiffness": (0.8, 1.2)}, elements=2, planar=True)
    asked = TipReachVectorEnv(2, params_in_info=True, **vary)
    silent = TipReachVectorEnv(2, params_in_info=False, **vary)
    usual = TipReachVectorEnv(2, **vary)
    single = TipReachEnv(**vary)
    for env in (usual, single):
        with pytest.warns(DeprecationWarning, match="params_in_info=True asks for it") as caught:
            env.reset(seed=0)
        assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        given, none = asked.reset(seed=0)[1], silent.reset(seed=0)[1]
        again = usual.reset(seed=0)[1]
        for kind in (PayloadVectorEnv, GripperVectorEnv, PegVectorEnv):  # which vary by themselves
            assert "params" not in kind(2, planar=True).reset(seed=0)[1]
    np.testing.assert_array_equal(given["params"]["stiffness"], again["params"]["stiffness"])
    assert "params" not in none and "_params" not in none
    with pytest.raises(ValueError, match="params_in_info = 1 was given; True, False or None"):
        TipReachVectorEnv(2, params_in_info=1)


def test_information_is_of_one_precision():
    """float64 of a vector env and of a single one alike; observations in it are float32."""
    vary = dict(randomize={"mass": (0.9, 1.1)}, elements=2, planar=True, params_in_info=True)
    many = TipReachVectorEnv(1, autoreset_mode="SameStep", max_episode_steps=1, **vary)
    one = TipReachEnv(**vary)
    info, alone = many.reset(seed=0)[1], one.reset(seed=0)[1]
    assert info["distance"].dtype == info["params"]["mass"].dtype == np.float64
    assert info["distance"][0] == alone["distance"]
    assert info["params"]["mass"][0] == alone["params"]["mass"]
    info = many.step(many.action_space.sample())[4]
    assert info["final_obs"].dtype == np.float32
    assert info["final_info"]["distance"].dtype == np.float64
