"""torchbeam_envs.baselines: the gain against closed forms, the model against the simulation, each
controller on TipReach.
"""

import math

import gymnasium
import numpy as np
import pytest
import torch
from torchbeam_envs import (
    Actuator,
    FlutterHoldVectorEnv,
    FollowTargetVectorEnv,
    SlewVectorEnv,
    TipForce,
    TipReachVectorEnv,
    TipTrackVectorEnv,
    TwoLinkVectorEnv,
    baselines,
    holding_action,
)
from torchbeam_envs.baselines import LQG, LQR, MPC, PD, JointLQR, Optimum, Static, Zero
from torchbeam_envs.baselines.holding import Holding, search
from torchbeam_envs.baselines.riccati import gain
from torchbeam_envs.baselines.trajectory import TipWay, within_bounds
from torchbeam_envs.reach import share_in_ball

import torchbeam as tb
from tests.cases.episodes import play

torch.set_num_threads(1)
SMALL = dict(elements=2, substeps=1, output="torch", autoreset_mode="Disabled")


def make(n=8, **arguments):
    return TipReachVectorEnv(n, **{**SMALL, **arguments})


def test_gain_of_a_scalar_is_the_closed_form():
    """x+ = a x + u, cost x^2 + r u^2: P^2 + (r - r a^2 - 1) P - r = 0, K = a P / (r + P); also for
    an unstable a.
    """
    for a, r in ((0.9, 2.0), (1.0, 0.1), (1.7, 5.0)):
        b = r - r * a * a - 1
        P = (-b + math.sqrt(b * b + 4 * r)) / 2
        K = gain(*(torch.tensor([[v]], dtype=torch.float64) for v in (a, 1.0, 1.0, r)))
        assert K.item() == pytest.approx(a * P / (r + P), rel=1e-12)


def test_gain_refuses_what_cannot_be_stabilised():
    one, none = torch.eye(1, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64)
    with pytest.raises(ValueError, match="the actions can stabilise is wanted"):
        gain(1.5 * one, none, one, one)


def test_gain_is_optimal():
    """No nearby gain costs less on a random system: the cost of 400 steps from random starts is
    least at K, to second order.
    """
    g = torch.Generator().manual_seed(0)
    A, B = (torch.randn(4, k, generator=g, dtype=torch.float64) / 2 for k in (4, 2))
    Q, R = torch.eye(4, dtype=torch.float64), 0.5 * torch.eye(2, dtype=torch.float64)
    K = gain(A, B, Q, R).requires_grad_()
    x, cost = torch.randn(4, 6, generator=g, dtype=torch.float64), 0.0
    for _ in range(400):
        u = -K @ x
        cost = cost + (x * (Q @ x)).sum() + (u * (R @ u)).sum()
        x = A @ x + B @ u
    assert torch.autograd.grad(cost, K)[0].abs().max() < 1e-9 * cost.item()


@pytest.mark.parametrize("planar", [False, True])
def test_holding_agrees_with_the_equilibria(planar):
    """The way back on the polynomial against Gauss-Newton on equilibria: 1e-4 of an action moves
    the tip by 1e-4 L.
    """
    env = make(16, planar=planar)
    env.reset(seed=0)
    target = env.state.goal
    holding = Holding.of(env, lambda state: state.nodes[..., 1, :])
    action = holding.action(target)
    exact = holding_action(env.scene, target, env.task.actions, env.task.inputs)
    torch.testing.assert_close(action, exact, atol=1e-4, rtol=0)
    torch.testing.assert_close(holding.action(target, action + 0.05), exact, atol=2e-4, rtol=0)
    middle = tb.equilibrium(env.scene, inputs=env.task.inputs(exact)).nodes[..., 1, :]
    torch.testing.assert_close(holding.at(action), middle, atol=1e-4 * env.task.length, rtol=0)


def test_model_is_the_simulation_for_small_actions():
    """Ten control intervals under actions of 1e-4: the linear model's readings are the env's to a
    hundredth of the largest. The step of 2 ms keeps the integrator's own phase error out of it.
    """
    env = make(1, substeps=10, gravity=None)
    model = LQR(env)
    env.reset(seed=0)
    z = torch.zeros(model.A.shape[-1], 1, dtype=torch.float64)
    pending = torch.zeros(2, 1, dtype=torch.float64)
    generator, largest, off = torch.Generator().manual_seed(0), 0.0, 0.0
    for _ in range(10):
        action = 1e-4 * torch.randn(1, 2, generator=generator, dtype=torch.float64)
        env.step(action)
        z, pending = model.A[0] @ z + model.B[0] @ pending, action.mT
        seen, expected = model.readings(env, env.state.beam)[0], (model.C[0] @ z)[:, 0]
        largest = max(largest, seen.abs().max().item())
        off = max(off, (seen - expected).abs().max().item())
    assert 0 < off < 0.01 * largest


def test_feedback_beats_feedforward_beats_nothing():
    env = make(4, planar=True, max_episode_steps=40)
    found = [
        play(env, one)
        for one in (Zero(env), Static(env), PD(env, [1.0, 3.0]), LQR(env, effort=0.1))
    ]
    returns = [one[0] for one in found]
    assert returns == sorted(returns)
    assert all(distance < 0.02 * env.task.length for _, distance in found[2:])


def test_in_space():
    """Both directions of the force; the filter knows the true start, gravity included."""
    env = make(4)
    assert play(env, LQG(env, effort=1.0))[1] < 0.02 * env.task.length


def test_reference_moves_with_the_target():
    """A path sampled along its way: the target's own equilibria with their rates leave the tip
    within 1 % of the length.
    """
    env = TipTrackVectorEnv(2, **{**SMALL, "planar": True, "max_episode_steps": 50})
    assert play(env, LQG(env, effort=0.1))[1] < 0.01 * env.task.length
    assert play(env, Static(env))[1] > 0.05 * env.task.length


def test_filter_holds_what_is_unstable():
    """Beyond Beck's load, from velocities that the filter does not know: from 0.1 m/s at the tip to
    less than 1 mm off.
    """
    env = FlutterHoldVectorEnv(
        3, **{**SMALL, "planar": True, "elements": 6, "substeps": 2, "max_episode_steps": 50}
    )
    assert torch.linalg.eigvals(LQG(env).A).abs().max() > 1.05
    assert play(env, LQG(env, effort=0.1))[1] < 1e-3


@pytest.mark.parametrize("delay", [pytest.param(0, marks=pytest.mark.long), 2])
def test_delay_is_in_the_model(delay):
    assert (
        play(make(4, planar=True, delay=delay), LQR(make(1, planar=True, delay=delay), effort=0.3))[
            1
        ]
        < 0.02 * 1.5
    )


def test_optimum_beats_its_guess():
    """Six steps from the holding actions and from others; the plan is replayed exactly, so its
    return is what the optimiser saw; at the end the model promises less than a hundredth of it, and
    no plan near by is better. A plan is of the episodes that it was made for.
    """
    env = make(2, planar=True, max_episode_steps=15, output="numpy")
    optimum = Optimum(env, iterations=6, starts=2)
    best = play(env, optimum)[0]
    assert best > play(env, Static(env))[0] + 0.5
    assert best == pytest.approx(-optimum.cost.mean().item(), rel=1e-9)
    assert (optimum.gap < 0.01 * optimum.cost).all() and (optimum.spread >= 0).all()
    env.reset(seed=0)
    optimum.begin(env)
    for seed in range(4):
        noise = torch.randn(optimum.plan.shape, generator=torch.Generator().manual_seed(seed))
        near = (optimum.plan + 0.01 * noise.to(optimum.plan)).clamp(-1, 1)
        assert (optimum._cost(env.state, near) > optimum.cost - 1e-3).all()
    optimum(env.state.observation)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="that began after begin"):
        optimum(env.state.observation)
    with pytest.raises(ValueError, match="without end"):
        Optimum(env).begin(make(2, max_episode_steps=None))


def test_the_way_of_the_tip_and_its_slopes():
    """With a stiffness of each episode's own, two substeps and actions still to act: the way is the
    env's to 1e-9 (the solver's tolerance), its derivatives those of differences of 1e-4.
    """
    env = make(2, planar=True, substeps=2, randomize={"stiffness": (0.7, 1.3)})
    env.reset(seed=0)
    start, way = env.state, TipWay(env.task, env.state.plant)
    generator = torch.Generator().manual_seed(0)
    acting = 0.3 * torch.randn(2, 4, 1, generator=generator, dtype=torch.float64)
    slopes = way.linearised(start.beam, acting).by_acting
    for k in range(4):
        env.step(acting[:, k])
        if k:  # an action acts an interval later
            at = env.state.beam.position[:, -1, :2]
            late = way(start, torch.cat((0 * acting[:, :1], acting), 1))[:, k]
            torch.testing.assert_close(late, at, rtol=0, atol=1e-9)
    step = 1e-4 * torch.randn(2, 4, 1, generator=generator, dtype=torch.float64)
    moved = (way(start, acting + step) - way(start, acting - step)) / 2
    expected = torch.einsum("ntdsa,nsa->ntd", slopes, step)
    torch.testing.assert_close(expected, moved, rtol=1e-4, atol=1e-11)
    with pytest.raises(ValueError, match="actions alone do not tell"):
        TipWay(FollowTargetVectorEnv(1, elements=5).task, env.plant)


@pytest.mark.parametrize("smooth", [0, 3])
def test_least_within_bounds(smooth):
    """Random problems of 40 numbers, and as ill-conditioned ones as those of a beam (1e6: of sums
    of sums of sums), whose least values lie at bounds: no slope leads down from there within them,
    to what rounding leaves. From starts at bounds and between. (Of ill-conditioned ones values far
    above the least were taken for it.)
    """
    generator = torch.Generator().manual_seed(0)
    A, g, plan = (
        torch.randn(50, 40, k, generator=generator, dtype=torch.float64) for k in (40, 1, 1)
    )
    for _ in range(smooth):
        A = A.cumsum(-1) / 6
    H, g = A.mT @ A + 1e-3 * torch.eye(40, dtype=torch.float64), 20 * (A.mT @ g)[..., 0]
    if smooth:
        assert torch.linalg.cond(H).median() > 1e6
    for start in (plan[..., 0].clamp(-1, 1), plan[..., 0].sign(), 0 * plan[..., 0]):
        best = within_bounds(g, H, start)
        slope = g + (H @ (best - start)[..., None])[..., 0]
        down = (slope * (best < 1)).clamp(max=0) + (slope * (best > -1)).clamp(min=0)
        assert best.abs().max() == 1 and (best.abs() == 1).double().mean() > 0.1
        assert (down.abs().amax(-1) < 1e-9 * g.abs().amax(-1)).all()
        one = within_bounds(g[:1], H[:1], start[:1])
        torch.testing.assert_close(one, best[:1], rtol=0, atol=0)


@pytest.mark.parametrize("falls", [False, True])
def test_least_within_bounds_of_matrices_without_inverse(falls):
    """Of 12 numbers of which some do not count, or count by their sum alone (to the bit: columns
    of whole numbers that are 0, or alike), the others held at a bound or not; with a gradient that
    is such a matrix's, or one that falls along what is flat. No slope leads down within the bounds,
    and the others of the batch, one of which is not finite, do not notice.
    """
    generator = torch.Generator().manual_seed(1)
    A = torch.randint(-3, 4, (30, 8, 12), generator=generator).double()
    A[:, :, 10:] = 0.0
    A[10:, :, 1] = A[10:, :, 0]
    A[20:] = 0.0
    H = A.mT @ A
    g = (A.mT @ torch.randn(30, 8, 1, generator=generator, dtype=torch.float64))[..., 0]
    g = g + falls * torch.randn(30, 12, generator=generator, dtype=torch.float64)
    own = torch.randn(3, 12, 12, generator=generator, dtype=torch.float64)
    H = torch.cat((H, own.mT @ own))  # three that have one
    g = torch.cat((g, torch.randn(3, 12, generator=generator, dtype=torch.float64)))
    assert (torch.linalg.matrix_rank(H[:30]) <= 8).all()
    plan = torch.rand(33, 12, generator=generator, dtype=torch.float64) * 2 - 1
    for start in (plan, plan.sign(), 0 * plan):
        best = within_bounds(g, H, start)
        slope = g + (H @ (best - start)[..., None])[..., 0]
        down = (slope * (best < 1)).clamp(max=0) + (slope * (best > -1)).clamp(min=0)
        assert best.abs().max() <= 1
        assert (down.abs().amax(-1) <= 1e-9 * g.abs().amax(-1)).all()
        torch.testing.assert_close(
            best[30:], within_bounds(g[30:], H[30:], start[30:]), rtol=0, atol=1e-9
        )
        lost = torch.where(torch.arange(33)[:, None] == 4, torch.nan, g)
        torch.testing.assert_close(
            within_bounds(lost, H, start), torch.where(lost.isnan(), start, best)
        )


def test_predictive_control_follows():
    """Of a strip of its own stiffness and of a moving target: ten times nearer than LQR."""
    env = TipTrackVectorEnv(2, **{**SMALL, "planar": True, "max_episode_steps": 25})
    scores = [play(env, one) for one in (LQR(env, effort=0.1), MPC(env, horizon=10))]
    assert scores[1][1] < 0.1 * scores[0][1] and scores[1][0] > 0.1 * scores[0][0]
    with pytest.raises(ValueError, match="horizon = 1 was given"):
        MPC(env, horizon=1)


def test_predictive_control_that_is_informed():
    """Of plants that no controller knows, with latency, lag and gain: its model is exact, so that
    what it plans for is what then happens (without its knowledge the tip is elsewhere by more than
    a hundred times as much), and it follows at a third of the cost.
    """
    drawn = {
        "stiffness": (0.7, 1.3), "clamp": (0.001, 0.05), "latency": (0.0, 2.0), "lag": (0.0, 0.02),
        "gain": (0.9, 1.1),
    }  # fmt: skip
    arguments = {**SMALL, "planar": True, "max_episode_steps": 25, "randomize": drawn}
    env = TipTrackVectorEnv(4, **arguments)
    off, costs = [], []
    for informed in (True, False):
        controller = MPC(env, horizon=10, informed=informed)
        observation, _ = env.reset(seed=0)
        controller.begin(env)
        away = total = 0.0
        for _ in range(20):
            action = controller(observation)
            kept = controller.plan
            controller.plan = torch.cat((action[:, None], kept[:, :-1]), 1)
            way = TipWay(env.task, env.state.plant) if informed else controller.way
            promised = way(env.state, controller.acting(env.state))[:, 0]
            controller.plan = kept
            observation, reward, *_ = env.step(action)
            tip = env.state.beam.position[:, -1, env.task.vector]
            away, total = max(away, (tip - promised).abs().max().item()), total - reward.sum()
        off.append(away)
        costs.append(total.item())
    assert off[0] < 1e-9 and off[1] > 100 * off[0] and costs[0] < costs[1] / 3


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        (LQR, dict(effort=0.0), "effort = 0.0 was given; a positive"),
        (LQR, dict(effort=math.nan), "effort = nan"),
        (LQG, dict(speed_weight=-1.0), "speed_weight = -1.0 was given; a finite number of at"),
        (JointLQR, dict(effort=-1.0), "effort = -1.0"),
        (LQG, dict(action=0.0), "action = 0.0"),
        (MPC, dict(iterations=0), "iterations = 0"),
        (MPC, dict(terminal=math.inf), "terminal = inf"),
        (Optimum, dict(starts=0), "starts = 0"),
    ],
)
def test_numbers_of_controllers(kind, options, said):
    env = SlewVectorEnv(1) if kind is JointLQR else TipTrackVectorEnv(1, **SMALL)
    with pytest.raises(ValueError, match=said):
        kind(env, **options)


def test_a_weight_of_zero():
    """LQR that does not mind how fast the tip is: the limit of small weights."""
    env = TipTrackVectorEnv(1, **SMALL)
    none, little = (LQR(env, speed_weight=w).K for w in (0.0, 1e-12))
    torch.testing.assert_close(none, little, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", [Static, LQR, LQG, MPC])
def test_episodes_that_begin_later_are_begun_anew(kind):
    """Episode 1 is reset by hand after four intervals: from there on its actions are those of a
    controller that begins with it, and the others' are those of one that went on. (The filter went
    on from where the old episode had ended.) To 1e-9: the way back to a holding action is iterated.
    """
    arguments = dict(horizon=4) if kind is MPC else {}
    env, other = (
        TipTrackVectorEnv(2, **{**SMALL, "planar": True, "noise": 0.01}) for _ in range(2)
    )
    controller, alone = kind(env, **arguments), kind(env, **arguments)
    observation, _ = env.reset(seed=0)
    controller.begin(env)
    for k in range(7):
        if k == 4:
            mask = torch.tensor([False, True])
            observation, _ = env.reset(seed=[0, 5], options={"reset_mask": mask})
            seen, _ = other.reset(seed=[4, 5])
            alone.begin(other)
        action = controller(observation)
        if k >= 4:
            torch.testing.assert_close(action[1], alone(seen)[1], rtol=0, atol=1e-9)
            seen, *_ = other.step(action)
        observation, *_ = env.step(action)


def test_controllers_take_single_envs_and_say_what_is_missing():
    single = gymnasium.make("torchbeam/TipReachPlanar-v1", elements=2, substeps=1)
    controller = LQG(single)
    observation, _ = single.reset(seed=0)
    with pytest.raises(ValueError, match=r"LQG was called before begin\(env\)"):
        controller(observation)
    controller.begin(single)
    action = controller(observation)
    assert action.shape == single.action_space.shape and isinstance(action, np.ndarray)
    single.step(action)
    with pytest.raises(ValueError, match="CartPoleEnv was given"):
        LQR(gymnasium.make("CartPole-v1").unwrapped)


def test_numpy_in_numpy_out():
    env = make(3, output="numpy")
    observation, _ = env.reset(seed=0)
    controller = LQG(env)
    controller.begin(env)
    action = controller(observation)
    assert isinstance(action, np.ndarray) and action.shape == (3, 2)
    env.step(action)


def test_search_finds_the_bowl():
    best, least = search(
        lambda x: (x.log() - torch.tensor([1.0, -1.0])).square().sum(-1),
        [1.0, 1.0],
        sets=200,
        seed=0,
    )
    assert least < 0.05 and best.log().tolist() == pytest.approx([1, -1], abs=0.25)


def test_pd_turns_a_hub():
    """By its angle alone, with the gains that the search finds for the whole task; the linear model
    has no hub.
    """
    env = SlewVectorEnv(8, planar=True, **SMALL)
    (rest, far), (turned, near) = play(env, Zero()), play(env, PD(env, [7.0, 22.5]))
    assert near < 0.1 * far and turned > 0.4 * rest
    with pytest.raises(ValueError, match="no constant action holds was given"):
        LQR(env)
    assert play(env, JointLQR(env, effort=1.0))[0] > 0.8 * turned
    assert play(env, JointLQR(env))[0] > 0.3 * rest  # (it was beyond what no action costs)


def driven_by(actions):
    """A strip with a tip force along y and z, and curvatures that do much of the same."""
    bend = Actuator(
        tb.Actuation(curvature=tb.Input("bend", 3)), [[0, 0.6, 0], [0, 0, 0.6]][: actions - 2]
    )
    return dict(actuators=[TipForce(gain=[[0, 1.2, 0], [0, 0, 2.0]]), bend], max_episode_steps=10)


@pytest.mark.parametrize(
    "actions, error", [pytest.param(3, 2e-3, marks=pytest.mark.long), (4, 3e-2)]
)
def test_baselines_take_more_actions_than_the_tip_has_directions(actions, error):
    """The polynomial of three and four actions against equilibria (largest found: 5e-4, 1.5e-2 of
    the length, where all act fully), its slopes against differences, and the action that holds a
    target, of many that do. (Three were refused; plain Gauss-Newton ended up to a length away where
    actions do the same.)
    """
    env = make(8, **driven_by(actions))
    reach = env.task.reach
    share = (
        2 * torch.rand(100, actions, generator=torch.Generator().manual_seed(0), dtype=env.dtype)
        - 1
    )
    exact = tb.equilibrium(env.plant.scene, inputs=env.task.inputs(0.8 * share)).tip.position
    assert (reach.tip(share) - exact).norm(dim=-1).max() < error * env.task.length
    way = torch.eye(actions, dtype=env.dtype)[-1] * 1e-6
    slope = (reach.tip(0.9 * share + way) - reach.tip(0.9 * share - way)) / 2e-6
    torch.testing.assert_close(reach.slopes(0.9 * share)[..., -1], slope, atol=1e-7, rtol=0)
    env.reset(seed=0)
    target = env.state.goal
    for action in (
        Holding.of(env).action(target),
        holding_action(env.scene, target, actions, env.task.inputs),
    ):
        tip = tb.equilibrium(env.scene, inputs=env.task.inputs(action)).tip.position
        assert (tip - target).norm(dim=-1).max() < error * env.task.length


@pytest.mark.parametrize(
    ("controller", "share"),
    [
        (LQR, 0.5),
        pytest.param(LQG, 0.9, marks=pytest.mark.long),  # two actions: test_in_space
    ],
)
def test_controllers_of_three_actions(controller, share):
    """Feedback brings the tip nearer to targets close by than no action does; so many actions are
    taken by the others too.
    """
    env = make(4, **driven_by(3), reach=0.1)
    far = [play(env, one)[1] for one in (Zero(env), controller(env))]
    assert far[1] < share * far[0]
    observation, _ = env.reset(seed=0)
    for other in (Static(env), PD(env, [0.3, 0.1] * 2)):
        other.begin(env)
        assert other(observation).shape == (4, 3) and other(observation).isfinite().all()


def test_two_links_follow_by_lqr():
    """At well under half of what it costs to do nothing, in less than a period; and PD acts against
    the hinges' errors. Tasks without hinges are refused.
    """
    env = TwoLinkVectorEnv(2, planar=True, period=1.5, max_episode_steps=25, **SMALL)
    far = [play(env, controller)[0] for controller in (Zero(env), JointLQR(env))]
    assert far[1] > 0.4 * far[0]
    pd = PD(env, [0.1, 0.0, 0.3, 0.0])
    pd.begin(env)
    error = env.task.tracking_error(env.state)[0]
    expected = torch.tensor([0.1, 0.3], dtype=torch.float64) * error
    torch.testing.assert_close(pd(env.state.observation), expected, rtol=0, atol=1e-12)
    assert error.abs().min() > 0
    with pytest.raises(ValueError, match="a task without hinges"):
        JointLQR(make(1))


def test_targets_of_three_actions_fill_the_ball():
    """Uniform in the ball: radius^3 and the cosine to an axis are uniform (means 1/2 and 0; 4
    deviations of 20,000 draws).
    """
    points = torch.from_numpy(share_in_ball(np.random.default_rng(0).random((20_000, 4)), 3))
    radius = points.norm(dim=-1)
    assert radius.max() <= 1 and abs((radius**3).mean() - 0.5) < 4 * (1 / 12 / 20_000) ** 0.5
    assert ((points / radius[:, None]).mean(0).abs() < 4 * (1 / 3 / 20_000) ** 0.5).all()


@pytest.mark.parametrize(
    "kind",
    [
        kind
        for kind in map(vars(baselines).get, baselines.__all__)
        if isinstance(kind, type) and kind is not baselines.Controller
    ],
    ids=lambda kind: kind.__name__,
)
def test_act_before_begin_is_a_sentence(kind):
    """Of every baseline, however it was constructed."""
    with pytest.raises(ValueError, match=rf"{kind.__name__} was called before begin\(env\)"):
        object.__new__(kind).act(torch.zeros(1, 17))


def test_holding_action_of_several_targets_a_sample():
    """Two rounds of targets in one batch, near a guess, are those of each round by itself from
    nothing; another number of targets is refused.
    """
    env = TipReachVectorEnv(2, elements=2, planar=True)
    rounds = []
    for seed in (0, 2):
        env.reset(seed=seed)
        rounds.append(env.state.goal)
    alone = torch.cat([holding_action(env.scene, g, 1, env.task.inputs) for g in rounds])
    goal = torch.cat(rounds)
    both = holding_action(env.scene, goal, 1, env.task.inputs, 2, guess=alone + 1e-4)
    torch.testing.assert_close(both, alone, rtol=0, atol=1e-8)
    varied = TipReachVectorEnv(2, elements=2, planar=True, randomize={"stiffness": (0.8, 1.2)})
    varied.reset(seed=0)
    with pytest.raises(ValueError, match="3 targets were given for a scene of 2 samples"):
        holding_action(varied.scene, goal[:3], 1, varied.task.inputs)
