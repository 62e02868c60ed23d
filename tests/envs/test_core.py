"""torchbeam_envs: Gymnasium's contract, independence of sub-envs, failures, and gradients through
the environment.
"""

import json
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from torchbeam_envs import TipReachEnv, TipReachVectorEnv, holding_action

import torchbeam as tb

ID = "torchbeam/TipReach-v1"
SMALL = dict(elements=2, substeps=1)
torch.set_num_threads(1)


def actions(steps, n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, n, 2)).astype(np.float32)


def poisoned(env, member, velocity):
    """The env's state with one member's velocity replaced; nothing is written in place."""
    beam = env.state.beam
    mask = (torch.arange(env.num_envs) == member)[:, None, None]
    velocity = torch.where(mask, torch.tensor(velocity, dtype=beam.velocity.dtype), beam.velocity)
    return replace(env.state, beam=replace(beam, velocity=velocity))


def test_single_env_follows_the_contract():
    env = gymnasium.make(ID, **SMALL)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space.dtype == np.float32 and env.action_space.dtype == np.float32
    assert np.isfinite(env.observation_space.high).all() and (env.action_space.high == 1).all()
    env.reset(seed=0)
    for k in range(50):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        assert not terminated and truncated == (k == 49)
    assert info["distance"] >= 0 and info["solver_failed"] is False
    bare = env.unwrapped
    assert bare.config is bare.one.config and bare.state is bare.one.state
    assert bare.state.beam.tip.position.shape == (1, 3) and bare.config.elements == 2


def test_registration():
    spec = gymnasium.spec(ID)
    assert json.loads(spec.to_json())["max_episode_steps"] == 50
    env = gymnasium.make_vec(ID, num_envs=256, **SMALL)
    assert isinstance(env, TipReachVectorEnv) and env.max_episode_steps == 50
    assert json.loads(env.spec.to_json())["kwargs"]["num_envs"] == 256
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert "autoreset_mode" not in TipReachVectorEnv.metadata  # of the instance, not of the class
    observation, _ = env.reset(seed=0)
    assert observation.shape == (256, 17) and observation.dtype == np.float32
    observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
    assert observation.dtype == np.float32 and reward.dtype == np.float64
    assert terminated.dtype == truncated.dtype == np.bool_


def test_vector_env_is_n_single_envs():
    """Step by step, over the end of an episode; batched matrix products may round differently, so
    not bit for bit.
    """
    n, limit = 3, 6
    many = TipReachVectorEnv(n, max_episode_steps=limit, autoreset_mode="Disabled", **SMALL)
    each = [gymnasium.make(ID, max_episode_steps=limit, **SMALL) for _ in range(n)]
    observation, _ = many.reset(seed=11)
    for i, one in enumerate(each):
        np.testing.assert_allclose(one.reset(seed=11 + i)[0], observation[i], atol=1e-7)
    for action in actions(limit, n):
        observation, reward, terminated, truncated, info = many.step(action)
        for i, one in enumerate(each):
            o, r, te, tr, f = one.step(action[i])
            np.testing.assert_allclose(o, observation[i], atol=1e-6)
            assert r == pytest.approx(reward[i], rel=1e-6) and (te, tr) == (
                terminated[i],
                truncated[i],
            )
            assert f["distance"] == pytest.approx(info["distance"][i], rel=1e-5)
    assert truncated.all()


def test_seeds_do_not_depend_on_the_number_of_envs():
    few, many = TipReachVectorEnv(2, **SMALL), TipReachVectorEnv(7, **SMALL)
    single = dict(rtol=2e-7, atol=2e-7)  # float32 observations of batches of another size
    a, b = few.reset(seed=5)[0], many.reset(seed=5)[0]
    np.testing.assert_allclose(a, b[:2], **single)
    assert len(np.unique(b[:, 1])) == 7
    a, b = few.reset()[0], many.reset()[0]  # the streams go on
    np.testing.assert_allclose(a, b[:2], **single)
    np.testing.assert_allclose(few.reset(seed=[6, 5])[0], many.reset(seed=5)[0][[1, 0]], **single)
    assert few.np_random_seed == (6, 5)


def test_targets_can_be_held():
    """The polynomial agrees with the equilibrium to 1e-5 of the length, and the way back finds
    actions within the share.
    """
    env = TipReachVectorEnv(32, output="torch", **SMALL)
    env.reset(seed=0)
    target = env.state.goal
    action = holding_action(env.scene, target, env.task.actions, env.task.inputs)
    tip = tb.equilibrium(env.scene, inputs=env.task.inputs(action)).tip.position
    assert torch.linalg.vector_norm(tip - target, dim=-1).max() < 1e-5 * env.task.length
    assert torch.linalg.vector_norm(action, dim=-1).max() < 0.8 + 1e-3


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_autoreset(mode):
    """Two episodes of three steps; the first of the second comes from the same stream in every
    mode, and what is said of it goes with it: in SameStep that of the step is in `final_info`.
    """
    varied = {"randomize": {"mass": (0.8, 1.2)}, **SMALL}
    env = TipReachVectorEnv(2, max_episode_steps=3, autoreset_mode=mode, **varied)
    streams = TipReachVectorEnv(2, **varied)
    (first, old), (second, new) = streams.reset(seed=0), streams.reset()
    np.testing.assert_array_equal(env.reset(seed=0)[0], first)
    push = np.full((2, 2), 0.5)
    for _ in range(3):
        observation, reward, terminated, truncated, info = env.step(push)
    assert truncated.all() and not terminated.any() and (reward < 0).all()
    if mode == "SameStep":
        np.testing.assert_array_equal(observation, second)
        assert (
            info["final_obs"].shape == (2, 17)
            and info["final_obs"].dtype == np.float32
            and info["_final_obs"].all()
        )
        assert (np.abs(info["final_obs"][:, 3:15]).max(1) > 0).all() and info["final_info"][
            "_distance"
        ].all()
        np.testing.assert_array_equal(info["params"]["mass"], new["params"]["mass"])
        np.testing.assert_array_equal(info["final_info"]["params"]["mass"], old["params"]["mass"])
        np.testing.assert_array_equal(info["distance"], new["distance"])
        assert (
            info["_params"].all()
            and not info["_distance"].any()
            and not info["_action_invalid"].any()
        )
    if mode == "NextStep":
        observation, reward, terminated, truncated, info = env.step(push)
        np.testing.assert_array_equal(observation, second)
        assert (
            (reward == 0).all()
            and not (terminated | truncated).any()
            and not info["_distance"].any()
        )
    if mode == "Disabled":
        stood = env.step(push)
        np.testing.assert_array_equal(stood[0], observation)
        assert (stood[1] == 0).all() and stood[3].all()
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": np.array([True])})
        observation, _ = env.reset(options={"reset_mask": np.array([False, True])})
        np.testing.assert_array_equal(observation[0], stood[0][0])
        np.testing.assert_array_equal(observation[1], second[1])
        truncated = env.step(push)[3]
        np.testing.assert_array_equal(truncated, [True, False])


@pytest.mark.parametrize("velocity", [float("nan"), 1e20])
def test_failed_solve_ends_its_own_episode_only(velocity):
    """One of eight starts a step with an impossible velocity: its neighbours do not change by a
    bit.
    """
    push, bad = actions(3, 8), 3
    well, ill = (TipReachVectorEnv(8, autoreset_mode="NextStep", **SMALL) for _ in range(2))
    others = np.arange(8) != bad
    for env in (well, ill):
        env.reset(seed=0)
        before = env.step(push[0])[0]
    ill.set_state(poisoned(ill, bad, velocity))
    a, b = well.step(push[1]), ill.step(push[1])
    for one, other in zip(a[:4], b[:4], strict=True):
        np.testing.assert_array_equal(one[others], other[others])
    assert (
        b[2][bad]
        and not b[3][bad]
        and b[1][bad] == -49 * ill.simulation.worst
        and b[4]["solver_failed"].tolist() == (~others).tolist()
    )
    np.testing.assert_array_equal(b[0][bad], before[bad])
    a, b = well.step(push[2]), ill.step(push[2])
    np.testing.assert_array_equal(a[0][others], b[0][others])
    assert np.isfinite(b[0]).all() and not b[2].any() and b[1][bad] == 0  # reset meanwhile


def test_actions_that_are_not_finite_count_as_zero():
    env, calm = (TipReachVectorEnv(2, **SMALL) for _ in range(2))
    for e in (env, calm):
        e.reset(seed=0)
    observation, *_, info = env.step(np.array([[0.5, 0.5], [np.nan, 1.0]]))
    np.testing.assert_array_equal(observation, calm.step(np.array([[0.5, 0.5], [0.0, 0.0]]))[0])
    assert info["action_invalid"].tolist() == [False, True]
    # clipped
    np.testing.assert_array_equal(env.step(np.full((2, 2), 9.0))[0], calm.step(np.ones((2, 2)))[0])


def test_gradient_of_a_return():
    """16 steps by a constant action of each member; central differences of the same return,
    float64.
    """
    env = TipReachVectorEnv(2, output="torch", **SMALL)

    def total(action):
        env.reset(seed=1)
        return sum(env.step(action)[1] for _ in range(16))

    action = torch.tensor([[0.4, -0.3], [-0.2, 0.6]], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(total(action).sum(), action)
    for i in range(2):
        step = 1e-5 * torch.eye(2, dtype=torch.float64)[i]
        with torch.no_grad():
            difference = (total(action + step) - total(action - step)) / 2e-5
        torch.testing.assert_close(gradient[:, i], difference, rtol=1e-5, atol=1e-7)


def test_windows_and_states():
    """detach() cuts the graph and nothing else; set_state goes back exactly."""
    env = TipReachVectorEnv(2, output="torch", **SMALL)
    first, _ = env.reset(seed=0)
    action = torch.full((2, 2), 0.3, dtype=torch.float64, requires_grad=True)
    kept = env.state
    one = env.step(action)[0]
    assert one.requires_grad and not env.initialize_trajectory().requires_grad
    assert not env.step(action.detach())[0].requires_grad
    torch.testing.assert_close(env.set_state(kept), first, rtol=0, atol=0)
    torch.testing.assert_close(env.step(action)[0], one, rtol=0, atol=0)
    with torch.no_grad():
        assert not env.step(action)[0].requires_grad
        env.reset(options={"params": {"mass": 1.1}})
        env.set_state(kept)  # of a time at which no parameter varied
        assert env.step(action)[4]["params"]["mass"].tolist() == [1.0, 1.0]


def test_sections_by_sub_env():
    """A section with batch axes gives every sub-env its own strip; each is as if it were alone."""
    sections = [
        tb.Section.rectangle(
            *(torch.tensor(v, dtype=torch.float64) for v in (w, 10e-3, 68.9e9, 0.33, 2700.0))
        )
        for w in (3e-3, 4e-3)
    ]
    both = tb.Section(
        *(torch.stack([getattr(s, name) for s in sections]) for name in ("compliance", "mass"))
    )
    many = TipReachVectorEnv(2, section=both, **SMALL)
    observation = many.reset(seed=0)[0], many.step(np.full((2, 2), 0.7))[0]
    for i, section in enumerate(sections):
        one = TipReachEnv(section=section, **SMALL)
        np.testing.assert_allclose(one.reset(seed=i)[0], observation[0][i], atol=1e-7)
        np.testing.assert_allclose(one.step(np.full(2, 0.7))[0], observation[1][i], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(num_envs=0), "num_envs = 0"),
        (dict(elements=1), "elements = 1"),
        (dict(reach=0), "reach = 0"),
        (dict(force=(1.0, -1.0)), "force"),
        (dict(output="jax"), "output = 'jax'"),
        (dict(substeps=0), "substeps = 0"),
        (dict(delay=-1), "delay = -1"),
        (dict(frames=0), "frames = 0"),
        (dict(control_interval=0.0), "control_interval = 0.0"),
        (dict(max_episode_steps=0), "max_episode_steps"),
        (dict(failure_reward=-np.inf), "failure_reward"),
        (dict(section=3), "section = 3 was given; a Section is wanted"),
        (dict(section="steel"), "section = .steel. was given"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        TipReachVectorEnv(**arguments)


def test_a_generator_that_was_given_is_used_and_gives_way_to_a_seed():
    """Gymnasium's `np_random` may be set before the first reset; the seed that is told is that of
    the generator.
    """
    env = TipReachEnv(**SMALL)
    assert (
        env.np_random.random() == gymnasium.utils.seeding.np_random(env.np_random_seed)[0].random()
    )
    env = TipReachEnv(**SMALL)
    env.np_random = np.random.default_rng(5)
    given = env.reset()[0]
    assert env.np_random_seed == -1
    env.np_random = np.random.default_rng(5)
    np.testing.assert_array_equal(env.reset()[0], given)
    seeded = env.reset(seed=3)[0]
    assert env.np_random_seed == 3
    np.testing.assert_array_equal(seeded, TipReachEnv(**SMALL).reset(seed=3)[0])


def test_bad_calls_are_refused():
    env = TipReachVectorEnv(2, **SMALL)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((2, 2)))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions of shape"):
        env.step(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="reset option"):
        env.reset(options={"targets": 1})
    for actions in (None, "push", [[1, 2], [3]]):
        with pytest.raises(ValueError, match="actions = "):
            env.step(actions)
    push = torch.zeros(2, 2, requires_grad=True)
    with pytest.raises(ValueError, match="output='torch', or actions"):
        env.step(push)
    with torch.no_grad():
        env.step(push)
    with pytest.raises(ValueError, match="seed = "):
        env.reset(seed=np.array(3))
    with pytest.raises(ValueError, match="seeds"):
        env.reset(seed=[1, 2, 3])


@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha"])
def test_a_reset_does_not_touch_the_others(method):
    """Member 0 starts afresh after two steps, member 1 goes on: bit for bit as without that. And
    member 0 then does what it did at first, whatever its last action before the reset was.
    """
    push = np.array([[1.0, 0.5], [0.3, -0.4]])
    alone, mixed = (
        TipReachVectorEnv(2, method=method, autoreset_mode="Disabled", **SMALL) for _ in range(2)
    )
    for env in (alone, mixed):
        env.reset(seed=0)
    first = [alone.step(push)[0] for _ in range(4)]
    for _ in range(2):
        mixed.step(push)
    mixed.reset(options={"reset_mask": np.array([True, False])})
    second = [mixed.step(push)[0] for _ in range(2)]
    np.testing.assert_array_equal(second[-1][1], first[-1][1])
    # 0-2 hold the target, which is another
    np.testing.assert_array_equal(second[-1][0, 3:], first[1][0, 3:])


@pytest.mark.parametrize("output", ["numpy", "torch"])
def test_frames_are_the_observations_before(output):
    """Of noisy sensors and late actions, across resets by the env itself: the last three
    observations of the env without frames, the first of an episode in place of those before it; so
    is the last one of an episode. Gradients reach the actions through all of them.
    """
    given = dict(
        elements=2, substeps=1, max_episode_steps=4, noise=0.1, randomize={"latency": (0, 2)}
    )
    given |= dict(autoreset_mode="SameStep", output=output)
    one, three = TipReachVectorEnv(2, **given), TipReachVectorEnv(2, frames=3, **given)
    past = [one.reset(seed=5)[0]] * 3
    now = three.reset(seed=5)[0]
    stacked = np.concatenate if output == "numpy" else torch.cat
    assert three.observation_space.shape[1] == 3 * one.observation_space.shape[1]
    one.action_space.seed(0)
    for k in range(6):
        assert np.array_equal(now, stacked(past, -1))
        action = one.action_space.sample()
        last, _, _, over, info = one.step(action)
        now, _, _, _, more = three.step(action)
        past = [*past[1:], last]
        if k == 3:
            assert over.all()
            final = [*past[:2], info["final_obs"]]
            assert np.array_equal(more["final_obs"], stacked(final, -1))
            past = [last] * 3


def test_gradients_run_through_frames():
    env = TipReachVectorEnv(2, elements=2, substeps=1, delay=0, frames=2, output="torch")
    env.reset(seed=0)
    action = torch.zeros(2, env.task.actions, dtype=torch.float64, requires_grad=True)
    env.step(action)
    before, now = env.step(torch.zeros_like(action))[0].chunk(2, -1)
    for frame in (before, now):
        (slope,) = torch.autograd.grad(frame.sum(), action, retain_graph=True)
        assert (slope != 0).any(-1).all()


@pytest.mark.parametrize("dtype, taken", [(None, torch.Tensor.float), (torch.float32, lambda x: x)])
def test_a_network_in_the_users_default_dtype(dtype, taken):
    """Its weights are float32, tensors of an environment float64 unless asked: what the page says
    to do, with gradients.
    """
    torch.set_default_dtype(torch.float32)
    dtype = {} if dtype is None else {"dtype": dtype}
    env = TipReachVectorEnv(2, output="torch", planar=True, **SMALL, **dtype)
    observation, _ = env.reset(seed=0)
    network = torch.nn.Linear(observation.shape[-1], 1)
    observation, reward, *_ = env.step(network(taken(observation)).tanh())
    reward.sum().backward()
    assert 0 < network.weight.grad.abs().sum() < torch.inf
