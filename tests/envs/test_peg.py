"""Peg: the plate's distance, the way through the hole, and what its balancer bears."""

import numpy as np
import pytest
import torch
from torchbeam_envs import PegVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import Insert
from torchbeam_envs.peg import PiercedPlate

from tests.cases.refusals import refusals


def test_the_plate_is_where_it_is():
    """Distances in closed form: above, under and in the hole, at the round of its edge, and inside;
    and the gradient is that of the distance, of length 1, at random points.
    """
    plate = PiercedPlate(
        *(torch.tensor(x).double() for x in ((0.1, 0.0, -0.01), 0.006, 0.02, 0.004))
    )
    diagonal = 2e-3 / 2**0.5
    points = [
        (0.2, 0, 0.03),
        (0.2, 0.1, -0.05),
        (0.1, 2e-3, -0.01),
        (0.11 - diagonal, 0, diagonal - 4e-3),
    ]
    wanted = [0.03, 0.03, 0.004, 2e-3 - 4e-3]
    at = torch.tensor(points, dtype=torch.float64)
    apart = plate.distance(at)[:, 0] - torch.tensor(wanted, dtype=torch.float64)
    assert apart.abs().max() < 1e-9  # the axis is rounded by a millionth of the hole
    around = torch.randn(200, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    x = (0.012 * around + torch.tensor([0.1, 0, -0.01])).requires_grad_()
    slope = torch.autograd.grad(plate.distance(x).sum(), x)[0]
    torch.testing.assert_close(plate.gradient(x), slope, rtol=0, atol=1e-9)
    torch.testing.assert_close(slope.norm(dim=-1), torch.ones(200).double(), rtol=0, atol=1e-6)


def test_rods_are_led_through_the_hole():
    """`Insert` brings eight rods to their targets within 1.4 s, whatever the friction; pushed
    straight at them, none gets there: the plate holds it up. None fails.
    """
    env = PegVectorEnv(8, planar=True, autoreset_mode="Disabled")
    controller = Insert(env)
    observation, _ = env.reset(seed=0)
    controller.begin(env)
    for _ in range(70):
        observation, *_, info = env.step(controller(observation))
    assert info["inserted"].all() and not info["solver_failed"].any()
    observation, _ = env.reset(seed=0)
    for _ in range(40):
        away = observation[:, :2]
        *_, info = out = env.step(away / np.abs(away).max(1, keepdims=True))
        observation = out[0]
    tip = env.state.beam.position[:, -1, 2]
    assert not info["inserted"].any() and (tip > -0.01).all()


def test_the_balancer_bears_rod_and_carriage():
    """Without action and with the usual mass nothing moves but by the stretch of the rod."""
    env = PegVectorEnv(1, planar=True)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros((1, 2)))
    assert (env.state.beam.position - env.start.position)[..., 2].abs().max() < 1e-5


@refusals(
    (dict(hole=0.004), "hole = 0.004"),
    (dict(motor=-1.0), "motor = -1.0"),
    (dict(friction=-0.1), "friction = -0.1"),
    (dict(direction=(0.0, 1, 0)), "direction was given"),
)
def test_bad_arguments_are_refused(arguments):
    PegVectorEnv(1, **arguments)


def test_insert_is_for_pegs():
    with pytest.raises(ValueError, match="Peg is wanted"):
        Insert(TipReachVectorEnv(1, elements=2))
