"""Bars among which the arm is to reach: their law as published, where they lie, and that the arm
does not enter them.
"""

import numpy as np
import pytest
import torch
from torchbeam_envs import FollowTargetVectorEnv, ReachObstaclesVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import ResolvedRate, ViaPoint, Waypoints
from torchbeam_envs.reach_obstacles import APART, BAND, CENTRES, Bars, axes_apart, bars

from torchbeam import extend

K = 15 / BAND


def test_bars_press_by_the_gradient_of_the_published_energy():
    """Of one bar, at points beside its side, beyond its end, in it, and out of reach: minus the
    central difference of stiffness s^2 / spacing, with h = 1e-7 m, at where points will be `ahead`;
    nothing of what is far off.
    """
    ends, k, spacing = torch.tensor([0.1, -0.4, 0.2, 0.5, 0.6, 0.1]).double(), 1e5, 0.05
    ahead, v = torch.tensor(0.01).double(), torch.tensor([0.1, -0.2, 0.3]).double()
    law = Bars(ends, torch.tensor(0.08).double(), torch.tensor(k), torch.tensor(spacing), ahead)
    a, b = ends[:3], ends[3:]
    across = torch.linalg.cross(b - a, torch.tensor([0.0, 0, 1]).double())
    across, axis = across / across.norm(), (b - a) / (b - a).norm()
    at = [(a + b) / 2 + r * across for r in (0.079, 0.0805, 0.04, 0.09)]
    x = torch.stack([*at, b + 0.079 * axis, b + 0.5 * axis])[None]

    def energy(x):
        share = (((x - a) @ (b - a)) / (b - a).square().sum()).clamp(0, 1)
        g = 0.08 - (x - a - share[..., None] * (b - a)).norm(dim=-1)
        return k * (torch.nn.functional.softplus(K * g, threshold=1e9) / K) ** 2 / spacing

    point = extend.LoadPoint(torch.eye(3), position=x - ahead * v, velocity=v.expand_as(x))
    force, moment = law.wrench(point, 0.0, {})
    assert moment is None
    for i in range(3):
        step = torch.zeros(3).double()
        step[i] = 1e-7
        slope = (energy(x + step) - energy(x - step)) / 2e-7
        torch.testing.assert_close(force[..., i], -slope, rtol=1e-5, atol=1e-3)
    assert force[0, :3].norm(dim=-1).min() > 1 and force[0, -1].norm() < 1e-12


def test_bars_lie_as_published():
    """Of 50 draws: eight of length 1, whose ends are in the box, whose axes keep apart, by a grid
    of 41 x 41 of their points; and each draw lies otherwise.
    """
    stream = np.random.default_rng(0)
    drawn = np.stack([bars(stream) for _ in range(50)]).reshape(50, 8, 2, 3)
    low, high = np.transpose(CENTRES)
    assert ((drawn >= low) & (drawn <= high)).all()
    np.testing.assert_allclose(np.linalg.norm(drawn[:, :, 1] - drawn[:, :, 0], axis=-1), 1)
    share = np.linspace(0, 1, 41)[:, None]
    for ends in drawn:
        points = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])  # (8, 41, 3)
        for i in range(8):
            grid = np.linalg.norm(points[i][:, None] - points[:, None], axis=-1).min((1, 2))
            exact = axes_apart(ends[i], ends)
            others = np.arange(8) != i
            assert (exact[others] >= APART).all()
            assert (exact <= grid + 1e-12).all() and (grid[others] - exact[others] < 0.02).all()
    assert np.ptp(drawn[:, 0, 0], axis=0).min() > 0.1


def test_the_arm_does_not_enter_bars():
    """Pressed towards those of the plane for 20 intervals by up to all that it has, no node is
    deeper in a bar than by 1 mm, and some are pressed by one.
    """
    env = ReachObstaclesVectorEnv(4, planar=True, output="torch", autoreset_mode="Disabled")
    env.reset(seed=0)
    push, deepest = (
        torch.rand(env.action_space.shape, generator=torch.Generator().manual_seed(0)),
        -1.0,
    )
    push = push * torch.tensor([1.0, 1, -1, -1])[:, None]  # bars are on one side
    for _ in range(20):
        env.step(push)
        now = env.state
        ends = env.task.ends(now).unflatten(-1, (-1, 2, 3))[:, None]
        a, way = ends[..., 0, :], ends[..., 1, :] - ends[..., 0, :]
        x = now.beam.position[:, :, None]
        share = (((x - a) * way).sum(-1) / way.square().sum(-1)).clamp(0, 1)[..., None]
        gap = (x - a - share * way).norm(dim=-1) - 0.05 - env.task.bar_radius
        deepest = max(deepest, -gap.min().item())
    assert 0 < deepest < 1e-3 and not now.beam.status.any()


def test_observations_are_as_published():
    """121 numbers in space and 47 in the plane; bars in the goal, which options give."""
    space, plane = (ReachObstaclesVectorEnv(2, planar=planar) for planar in (False, True))
    assert space.single_observation_space.shape == (121,)
    assert plane.single_observation_space.shape == (47,)
    goal = bars(np.random.default_rng(1))
    observation, _ = space.reset(seed=0, options={"goal": goal})
    np.testing.assert_allclose(observation[:, 13:61], np.stack((goal, goal)), rtol=1e-6)
    np.testing.assert_allclose(observation[:, 10:13], [(0.8, 0, 0.35)] * 2, rtol=1e-6)
    with pytest.raises(ValueError, match="contact = 0"):
        ReachObstaclesVectorEnv(1, contact=0.0)


def test_waypoints_are_gone_through_as_fast_as_they_may():
    """A way of three corners: after k intervals the command is where a walk of k 0.05 rad has come
    to, in the component that goes furthest, and in the end at the last corner; at half the pace
    after twice as many; and it comes back where something else has led it away.
    """
    places = [[0.12, 0.0, -0.06, 0.0, 0.0], [0.12, 0.08, 0.0, 0.0, 0.0], [0.0, 0.08, 0.0, 0.0, 0.1]]
    walk = np.array([[0.0] * 5, *places])
    ends = np.append(0, np.abs(np.diff(walk, axis=0)).max(1).cumsum())
    env = FollowTargetVectorEnv(2, planar=True, elements=5, autoreset_mode="Disabled")
    for pace in (1.0, 0.5):
        observation, _ = env.reset(seed=0)
        controller = Waypoints(env, places, pace)
        controller.begin(env)
        for k in range(1, 14 if pace == 0.5 else 8):
            observation, *_ = env.step(controller(observation))
            wanted = [np.interp(0.05 * pace * k, ends, walk[:, i]) for i in range(5)]
            np.testing.assert_allclose(env.task.command(env.state), [wanted] * 2, atol=1e-12)
    np.testing.assert_allclose(wanted, places[-1], atol=1e-12)
    env.step(np.full((2, 5), 0.4, np.float32))
    env.step(controller(observation))
    np.testing.assert_allclose(env.task.command(env.state), [places[-1]] * 2, atol=1e-8)


def test_legs_take_their_intervals():
    """Two legs of 2 and 4 intervals, whatever their length."""
    env = FollowTargetVectorEnv(1, planar=True, elements=5, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    places = np.array([[0.08, 0, 0, 0, 0], [0.04, 0.02, 0, 0, 0]])
    controller = Waypoints(env, places, legs=(2, 4))
    controller.begin(env)
    walk = np.concatenate((np.zeros((1, 5)), places))
    for k in range(1, 8):
        observation, *_ = env.step(controller(observation))
        wanted = [np.interp(k, (0, 2, 6), walk[:, i]) for i in range(5)]
        np.testing.assert_allclose(env.task.command(env.state)[0], wanted, atol=1e-12)
    for bad in ((2,), (2, 0), (2, np.nan)):
        with pytest.raises(ValueError, match="legs = "):
            Waypoints(env, places, legs=bad)


def test_a_via_point_is_the_best_of_the_ways():
    """Of the direct way, a detour and a way that is far off, each episode takes the one of the
    highest return by itself: as much as the best of three runs.
    """

    def returns(controller):
        env = ReachObstaclesVectorEnv(2, elements=10, max_episode_steps=8, output="torch")
        observation, _ = env.reset(seed=6)
        controller = controller(env)
        controller.begin(env)
        total = 0.0
        for _ in range(8):
            observation, reward, *_ = env.step(controller(observation))
            total = total + reward
        return total

    settings, points = dict(damping=0.02, latest=4), [[0.45, 0.3, 0.6], [-0.5, 0.0, 0.3]]
    each = [returns(lambda env: ResolvedRate(env, damping=0.02))]
    each += [returns(lambda env, p=p: Led(env, [p], **settings)) for p in points]
    each = torch.stack(each)
    assert each[0].min() > each[2].max()
    best = returns(lambda env: ViaPoint(env, points, **settings))
    torch.testing.assert_close(best, each.amax(0), rtol=0, atol=1e-6)


class Led(ViaPoint):
    """By way of its one place, whatever comes of it."""

    def restart(self, fresh):
        self.via = self.points.expand(len(fresh), 3)


def test_via_points_of_another_kind_are_refused():
    env = ReachObstaclesVectorEnv(1, max_episode_steps=None)
    with pytest.raises(ValueError, match="a soft arm"):
        ViaPoint(TipReachVectorEnv(1, elements=2), [[0.1, 0, 0]])
    for bad in ([[0.1, 0.2]], [0.1, 0, 0], [[np.nan, 0, 0]]):
        with pytest.raises(ValueError, match=r"points of shape|points = "):
            ViaPoint(env, bad)
    with pytest.raises(ValueError, match="latest = 0"):
        ViaPoint(env, [[0.1, 0, 0]], latest=0)
    controller = ViaPoint(env, [[0.1, 0, 0]])
    with pytest.raises(ValueError, match="an env without end"):
        controller.begin(env)


def test_waypoints_for_another_task_are_refused():
    arm = ReachObstaclesVectorEnv(1, planar=True)
    with pytest.raises(ValueError, match="a soft arm"):
        Waypoints(TipReachVectorEnv(1, elements=2), [[0.1]])
    for bad in ([[0.1, 0.2]], [0.1] * 5, []):
        with pytest.raises(ValueError, match="waypoints of shape"):
            Waypoints(arm, bad)
    with pytest.raises(ValueError, match="waypoints"):
        Waypoints(arm, [[np.nan] * 5])
    for bad in ([[0.1] * 5, [0.1]], "a", None):
        with pytest.raises(ValueError, match=r"waypoints = .* was given"):
            Waypoints(arm, bad)
    for bad in (0, -1.0, np.nan, "fast", True):
        with pytest.raises(ValueError, match="pace = "):
            Waypoints(arm, [[0.1] * 5], bad)


def test_a_way_that_ends_where_it_begins_stays_there():
    env = ReachObstaclesVectorEnv(2, planar=True)
    observation, _ = env.reset(seed=0)
    controller = Waypoints(env, [[0.0] * 5])
    controller.begin(env)
    assert not controller(observation).any()


def test_the_stored_way_leads_the_tip_among_the_bars():
    """To 0.8, 0.15 m behind six bars in 14 intervals, and there it stays: within 0.05 m."""
    from training.tuned import WAYS

    env = ReachObstaclesVectorEnv(1, planar=True, output="torch", autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    controller = Waypoints(env, **WAYS["obstacles"])
    controller.begin(env)
    for _ in range(14):
        observation, reward, *_, info = env.step(controller(observation))
    assert info["distance"].item() < 0.05 and reward.item() > 1.99
