"""Bounds of what is estimated: the most likely estimate within them; no parameter runs away."""

import itertools

import pytest
import torch
from torch.distributions import LogNormal

import torchbeam as tb
from torchbeam.analysis.estimation.limits import FARTHEST, within

from .test_kalman_filter import randn
from .test_weighting import linear, stiff


def test_a_parameter_at_its_bound_leaves_the_most_likely_rest():
    """Beside what is known without bounds: the mean of the other numbers where the parameter is at
    its bound, of a normal law.
    """
    prior = LogNormal(0.0, 0.1)
    E = tb.Parameter(1.0, transform="log", prior=prior, bounds=(0.9995, 1.0005))
    free, held = stiff(), stiff(parameters={"E": E})
    y = torch.tensor([[0.004], [-0.004]])
    before = free.start(2, amplitude=0.02)
    for _ in range(2):
        before = free(before, y)  # the stiffness is correlated with the motion
    one, other = free(before, 3 * y), held(before, 3 * y)
    i, ends = free.moves, torch.tensor([0.9995, 1.0005]).log()
    assert ((one.x[:, i] < ends[0]) | (one.x[:, i] > ends[1])).all()
    moved = one.x[:, i].clamp(*ends) - one.x[:, i]
    P = one.covariance
    best = one.x + P[..., i] / P[:, i, i, None] * moved[:, None]
    scale = one.factor.norm(dim=-2)
    assert ((other.x - best) / scale).abs().max() < 1e-9
    assert (
        (free.interval.model.departure(other.state) - best[:, :i]) / scale[:, :i]
    ).abs().max() < 1e-6


@pytest.mark.steps
@pytest.mark.parametrize("estimator", [tb.KalmanFilter, tb.MovingHorizon])
def test_an_absurd_reading_without_a_gate_ruins_its_sample_alone(estimator):
    """Its stiffness, by a logarithm, stays within ten deviations; the other sample is itself."""
    f = stiff(estimator, **{"window": 4} if estimator is tb.MovingHorizon else {})
    start, y = f.start(2, amplitude=0.01), 1e-3 * randn(6, 2, 1)
    best = f.run(start, y)[-1]
    y[2, 0] = 300.0
    z = f.run(start, y)[-1]
    assert z.unknown["E"].log().abs().max() < FARTHEST * 0.1 + 1e-9
    scale = best.factor[1].norm(dim=-2).clamp(min=1e-9)
    assert ((z.x[1] - best.x[1]) / scale).abs().max() < 1e-5


def test_bounds_hold_for_what_is_smoothed():
    """By all readings the most likely stiffness is beyond its bounds, at each instant."""
    prior = LogNormal(0.0, 0.1)
    E = tb.Parameter(1.0, transform="log", prior=prior, bounds=(0.9995, 1.0005))
    f, free = stiff(parameters={"E": E}), stiff()
    y = 0.01 * randn(6, 2, 1)
    ends = []
    for own in (f, free):
        start = own.start(2, amplitude=0.02)
        ends.append(torch.stack([z.unknown["E"] for z in own.smooth(start, own.run(start, y))]))
    within, beyond = ((each.log().abs() - 5e-4) < 1e-6 for each in ends)
    assert within.all() and not beyond.any()


def test_a_sample_that_has_failed_smooths_alone():
    """Its neighbour is smoothed as by itself; its own instants are no numbers."""
    f, y = stiff(), 1e-3 * randn(4, 2, 1)
    y[1, 0] = 1e200
    start = f.start(2, amplitude=0.01)
    both = f.smooth(start, f.run(start, y))
    start = f.start(amplitude=0.01)
    for a, b in zip(both, f.smooth(start, f.run(start, y[:, 1])), strict=True):
        assert a.x[0].isnan().any() and not a.x[1].isnan().any()
        assert ((a.x[1] - b.x) / b.factor.norm(dim=-2).clamp(min=1e-9)).abs().max() < 1e-5


def test_bounds_of_an_offset():
    f = linear(bias=2e-3, bounds={"offset of tip position z": (-1e-3, 1e-3)})
    z = f.start()
    for _ in range(5):
        z = f(z, [0.01])
    assert abs(z.unknown["offset of tip position z"] - 1e-3) < 1e-15


def test_within_bounds():
    """Against all ways in which four numbers may be held."""
    root = randn(20, 6, 4)
    H, best, end = root.mT @ root, 2 * randn(20, 4, seed=1), torch.ones(4)
    x = within(H, best, -end, end)

    def cost(x):
        return ((x - best)[:, None, :] @ H @ (x - best)[..., None])[:, 0, 0]

    least = torch.full((20,), torch.inf)
    for sides in itertools.product((-1.0, 0.0, 1.0), repeat=4):
        side = torch.tensor(sides)
        free = side == 0
        trial = side.expand(20, 4).clone()
        if free.any():
            pull = H[:, free][:, :, ~free] @ (trial - best)[:, ~free, None]
            rest = best[:, free] - torch.linalg.solve(H[:, free][:, :, free], pull)[..., 0]
            trial[:, free] = rest
        allowed = (trial.abs() <= 1).all(-1)
        least = torch.where(allowed, torch.minimum(least, cost(trial)), least)
    assert (x.abs() <= 1).all()
    torch.testing.assert_close(cost(x), least, rtol=1e-10, atol=1e-12)
