"""Controllers that estimate: what they read, and what they reach."""

import math
from dataclasses import replace

import pytest
import torch
from torchbeam_envs import FlutterHoldVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import LQR, MPC, AdaptiveMPC, Estimated
from torchbeam_envs.baselines.estimated import LASTING
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
    """While structures are still made anew, to the bit; and a decision that was prepared predicts
    nothing any more.
    """
    predict, calls, both = tb.KalmanFilter.predict, [], []

    def counted(self, *given):
        calls.append(given)
        return predict(self, *given)

    monkeypatch.setattr(tb.KalmanFilter, "predict", counted)
    env = make(2, params_in_info=False)
    for prepares in (False, True):
        observation, _ = env.reset(seed=1)
        controller, actions = AdaptiveMPC(env, horizon=6), []
        controller.begin(env)
        for _ in range(8):
            before = len(calls)
            actions.append(controller(observation))
            assert not prepares or len(calls) == before
            if prepares:
                controller.prepare()
                assert len(calls) == before + 1
            observation, *_ = env.step(actions[-1])
        both.append(torch.stack(actions))
    assert torch.equal(*both) and both[0].abs().max() > 0.1


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
