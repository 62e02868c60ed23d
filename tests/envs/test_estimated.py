"""Controllers that estimate: what they read, and what they reach."""

import math
from dataclasses import replace

import pytest
import torch
from torchbeam_envs import FlutterHoldVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import LQR, MPC, AdaptiveMPC, Estimated
from torchbeam_envs.baselines.estimated import LASTING
from torchbeam_envs.baselines.trajectory import TipWay
from torchbeam_envs.uncertain import UNCERTAIN

import torchbeam as tb
from tests.cases.episodes import play

torch.set_num_threads(1)
SMALL = dict(elements=2, substeps=1, output="torch", autoreset_mode="Disabled", planar=True)


def make(n, **arguments):
    return TipReachVectorEnv(n, **{**SMALL, **UNCERTAIN["TipReach"], **arguments})


def test_what_is_estimated_brings_the_tip_nearer():
    """Uncertain plants, read with noise and bias: nearer than by the usual plant, which sees the
    true state; and what knows the plant is nearer still, or as near.
    """
    env = make(4, max_episode_steps=40)
    usual, adaptive, bound = (
        play(env, controller)[0]
        for controller in (
            MPC(env, horizon=10),
            AdaptiveMPC(env, horizon=10),
            AdaptiveMPC(env, horizon=10, known=True),
        )
    )
    assert adaptive > usual and bound > adaptive - 0.1 * abs(adaptive)


@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
def test_nothing_but_readings_is_read(estimator):
    """The true beam and plant may be anything: what is done after a step is the same."""
    env = make(2)
    actions = []
    for lie in (False, True):
        observation, _ = env.reset(seed=0)
        controller = Estimated(LQR(env, effort=0.1), estimator=estimator)
        controller.begin(env)
        controller(observation)
        observation, *_ = env.step(torch.full((2, 1), 0.3))
        if lie:
            now = env.state
            beam = replace(now.beam, position=now.beam.position + 0.1)
            plant = replace(now.plant, params={k: 3 * v for k, v in now.plant.params.items()})
            env.set_state(replace(now, beam=beam, plant=plant))
        actions.append(controller(observation))
        assert env.state.beam is not controller.believed().beam
    assert torch.equal(*actions) and actions[0].abs().max() > 0


def test_episodes_that_begin_later():
    """Reset by hand, one of two: it starts anew, the other goes on; a window cannot."""
    env = make(2)
    for estimator in (tb.KalmanFilter, tb.MovingHorizon):
        observation, _ = env.reset(seed=0)
        controller = Estimated(LQR(env, effort=0.1), estimator=estimator)
        controller.begin(env)
        for _ in range(2):
            observation, *_ = env.step(controller(observation))
        observation, _ = env.reset(options={"reset_mask": torch.tensor([True, False])})
        if estimator is tb.MovingHorizon:
            with pytest.raises(ValueError, match="begin one by one"):
                controller(observation)
        else:
            assert controller(observation).isfinite().all()
            latest = controller.z.log_likelihood
            assert (latest[:, 0] == 0).all() and (latest[:, 1] != 0).all()


def test_what_acts_is_what_the_env_has_act():
    """Of arms of a delay, each with a latency, a lag and a gain of its own, which are told: to what
    a lag leaves of an action that is no more remembered.
    """
    env = make(3, delay=1, max_episode_steps=20)
    observation, _ = env.reset(seed=4)
    controller = Estimated(LQR(env, effort=0.1), known=True)
    controller.begin(env)
    assert env.state.plant.params["latency"].min() > 0.1
    for _ in range(8):
        observation, *_ = env.step(controller(observation))
        acts = controller.acting(controller.told, controller.asked)
        assert (acts - env.state.acting).abs().max() < math.exp(-LASTING)
    assert acts.abs().max() > 0.1


@pytest.mark.steps
def test_readings_of_a_motion_that_is_not_estimated_are_left_out():
    """Thrust at an elastic clamp starts a quick vibration along the arm: its velocities alone, and
    none where noise is larger, or the arm rests.
    """
    arguments = {**SMALL, **UNCERTAIN["FlutterHold"]}
    del arguments["planar"]
    left = []
    loud = {**arguments, "noise": 1.0}
    flutter = (FlutterHoldVectorEnv(2, **given) for given in (arguments, loud))
    for env in (*flutter, make(2)):
        observation, _ = env.reset(seed=0)
        controller = Estimated(LQR(env, effort=0.1))
        controller.begin(env)
        controller(observation)
        labels = controller.filter.interval.instruments.labels
        left.append([name for name, on in zip(labels, controller.heard, strict=True) if not on])
    assert left == [["sensors tip velocity x", "sensors node 1 velocity x"], [], []]


def test_what_is_prepared_changes_no_action(monkeypatch):
    """To the bit; and a decision that was prepared neither predicts nor simulates any more."""
    calls, both = [], []

    def counted(owner, name):
        whole = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *a, **k: calls.append(name) or whole(*a, **k))

    counted(tb.KalmanFilter, "predict")
    counted(tb, "rollout_jacobian")
    env = make(2, params_in_info=False)
    for prepares in (False, True):
        observation, _ = env.reset(seed=1)
        controller, actions = AdaptiveMPC(env, horizon=6), []
        controller.begin(env)
        for k in range(8):
            calls.clear()
            actions.append(controller(observation))
            assert not (prepares and k and calls)
            if prepares:
                calls.clear()
                controller.prepare()
                assert calls == ["predict", "rollout_jacobian"]
            observation, *_ = env.step(actions[-1])
        both.append(torch.stack(actions))
    assert torch.equal(*both) and both[0].abs().max() > 0.1


@pytest.mark.parametrize("known", [False, True])
def test_an_episode_that_is_over_changes_nothing_for_others(known, monkeypatch):
    """Decisions for the second episode, while the first is over or not: to rounding. No decision
    simulates, nor makes a filter, because of what is over.
    """
    env, both, calls = make(2, params_in_info=False), [], []

    def counted(owner, name):
        whole = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *a, **k: calls.append(name) or whole(*a, **k))

    counted(tb, "rollout_jacobian")
    counted(AdaptiveMPC, "_make")
    for over in (False, True):
        observation, _ = env.reset(seed=1)
        controller, actions = AdaptiveMPC(env, horizon=6, known=known), []
        controller.begin(env)
        calls.clear()
        for k in range(6):
            actions.append(controller(observation)[1])
            observation, *_ = env.step(controller.asked[:, 0])
            if over and k == 1:
                ended = torch.tensor([True, False])
                env.set_state(replace(env.state, terminated=ended))
        assert calls.count("_make") == 1 and calls.count("rollout_jacobian") == 6
        both.append(torch.stack(actions))
    assert (both[0] - both[1]).abs().max() < 1e-12 and both[0].abs().max() > 0.1


@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
def test_an_absurd_reading_is_as_none(estimator):
    """Of one sensor of the first episode, once: what is done is, to rounding, what is done where
    that reading is missing, there and in the second episode.
    """
    env, every = make(2, params_in_info=False), []
    for absurd in (math.nan, 10.0, math.inf):
        observation, _ = env.reset(seed=1)
        controller, actions = AdaptiveMPC(env, horizon=6, estimator=estimator), []
        controller.begin(env)
        for k in range(5):
            if k == 3:
                observation[0, 0] = absurd
            actions.append(controller(observation))
            observation, *_ = env.step(actions[-1])
        assert (controller.z.state.status == 0).all()
        every.append(torch.stack(actions))
    assert all((actions - every[0]).abs().max() < 1e-9 for actions in every)
    assert every[0].abs().max() > 0.1


def test_what_was_expected_is_corrected_to_first_order():
    """The way of a tip about an expected beam and actions, corrected by what came, against the way
    of that: errors fall with the square of the change. A plan about what was expected is, where
    that came, what it is without, to 1e-10.
    """
    env = make(2, params_in_info=False)
    observation, _ = env.reset(seed=0)
    controller = MPC(env, horizon=8, informed=True)
    controller.begin(env)
    for _ in range(3):
        observation, *_ = env.step(controller(observation))
    now, plan = env.state, controller.plan
    model, way = (
        tb.linearize(env.plant.scene, inputs={"force": torch.zeros(3)}),
        TipWay(env.task, now.plant),
    )
    z, acting = model.departure(now.beam), controller.acting(now)
    expected = way.linearised(lambda d: model.state_at(z + d), acting, z.shape[-1])
    errors = []
    for size in (0.1, 0.01):
        there = way.linearised(model.state_at((1 + size) * z), (1 + size) * acting).tips
        error = expected.after(size * z).at((1 + size) * acting) - there
        errors.append((error.norm() / (expected.tips - there).norm()).item())
    assert errors[1] < errors[0] / 8 < 0.1 / 8
    env.set_state(replace(now, beam=model.state_at(z)))
    plans = []
    for foreseen in (False, True):
        controller.plan = plan
        if foreseen:
            controller.expect(now, lambda d: model.state_at(z + d), z.shape[-1])
            controller.arrive(torch.zeros_like(z))
        controller.act(observation)
        plans.append(controller.plan)
    assert (plans[1] - plans[0]).abs().max() < 1e-10 and (plans[0] - plan).abs().max() > 1e-3


def test_ranges_are_what_is_known_beforehand():
    """Of an env that draws from others, too."""
    env = make(2, params_in_info=False)
    env.reset(seed=0)
    narrow = {**UNCERTAIN["TipReach"]["randomize"], "tip_mass": (0.001, 0.002)}
    for ranges, most in ((None, 0.024), (narrow, 0.002)):
        controller = AdaptiveMPC(env, horizon=5, ranges=ranges)
        controller.begin(env)
        controller(env.state.observation)
        mass = controller.z.unknown["tip_mass"].max()
        assert most / 5 < mass < most


@pytest.mark.parametrize("low, high", [(0.7, 1.3), (1e-3 / 3, 3e-3), (0.001, 0.05), (0.0, 0.02)])
def test_priors_have_the_moments_of_even_draws(low, high):
    """In the coordinate that a filter estimates: a logarithm, but near zero the number itself; by
    a sum over 100,000 places, exact to 1e-8. What a filter may come to is above zero.
    """
    env = make(2, params_in_info=False)
    env.reset(seed=0)
    controller = Estimated(LQR(env, effort=0.1), ranges={"tip_mass": (low, high)})
    controller.begin(env)
    controller._begin()
    x = torch.linspace(0, 1, 200_001, dtype=torch.float64)[1::2] * (high - low) + low
    x = x.log() if low > high / 10 else x
    unknowns = controller.filter.unknowns
    assert abs(unknowns.start[0] - x.mean()) < 1e-6 * x.std()
    assert abs(unknowns.deviation[0] / x.std(correction=0) - 1) < 1e-6
    named = unknowns.given(unknowns.start[0] + torch.tensor([[-9.0], [0.0]]) * x.std())
    least, mean = controller.values(named)["tip_mass"].flatten().tolist()
    assert 0 < least < low + 1e-9 + high / 100 and low < mean < high
