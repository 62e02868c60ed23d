"""Wiener-Milenkovic parameters: against the exponential map, their definitions, and forward-mode
rates.
"""

import math

import pytest
import torch
from torch.testing import assert_close

from torchbeam.math import quaternions as quat
from torchbeam.math import wiener_milenkovic as rot

torch.set_default_dtype(torch.float64)
ROUNDING = dict(rtol=0, atol=1e-14)


@pytest.fixture
def theta():
    torch.manual_seed(0)
    return 3 * torch.randn(40, 3)  # |theta| from 0.5 to 9: rotations of 30 to 260 degrees


def test_rotation_is_four_tan_quarter_angle():
    """theta = 4 tan(phi/4) n against the rotation matrix of the rotation vector phi n, to 350
    degrees.
    """
    n = torch.nn.functional.normalize(torch.tensor([1.0, -2.0, 0.5]), dim=0)
    phi = torch.linspace(0, 6.1, 40)[:, None]
    assert_close(
        rot.turn(4 * torch.tan(phi / 4) * n), quat.matrix(quat.exponential(phi * n)), **ROUNDING
    )


def test_Q_gives_the_angular_velocity_in_turned_axes(theta):
    """~(Q theta_dot) = C C_dot^T, C_dot by forward mode: the definition; and the rate of Q^-1."""
    theta_dot = torch.randn_like(theta)
    _, C_dot = torch.func.jvp(rot.C, (theta,), (theta_dot,))
    assert_close(
        quat.skew((rot.Q(theta) @ theta_dot[..., None])[..., 0]),
        rot.C(theta) @ C_dot.mT,
        **ROUNDING,
    )
    _, expected = torch.func.jvp(rot.Q_inverse, (theta,), (theta_dot,))
    assert_close(rot.Q_inverse_rate(theta, theta_dot), expected, rtol=1e-13, atol=1e-13)


def test_Q_inverse_is_its_inverse(theta):
    assert_close(rot.Q(theta) @ rot.Q_inverse(theta), torch.eye(3).expand(40, 3, 3), **ROUNDING)


def test_shadow_is_the_same_rotation(theta):
    """And theta (1 - 8/|theta|), which one finds in codes and notes, is not, except at
    |theta| = 4.
    """
    assert_close(rot.turn(rot.shadow(theta)), rot.turn(theta), **ROUNDING)
    size = theta.norm(dim=-1, keepdim=True)
    at_four = 4 * theta / size
    assert_close(rot.shadow(at_four), at_four * (1 - 8 / 4), **ROUNDING)
    at_five = 5 * theta / size
    turn_by = rot.turn(at_five * (1 - 8 / 5)) @ rot.turn(at_five).mT
    off = torch.acos((turn_by.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2)
    seven_degrees = 2 * math.pi - 4 * math.atan(3 / 4) - 4 * math.atan(5 / 4)
    assert_close(off, torch.full_like(off, seven_degrees), rtol=0, atol=1e-7)


def test_from_rotation_vector_takes_turns_off():
    phi = torch.tensor([[0.0, 0, 0], [0.3, -0.2, 0.1], [0, 0, 3.0], [0, 4.0, 0], [20.0, 1, 3]])
    theta = rot.from_rotation_vector(phi)
    assert (theta.norm(dim=-1) <= 4).all()
    assert_close(rot.turn(theta), quat.matrix(quat.exponential(phi)), **ROUNDING)


@pytest.mark.parametrize("size", [0.0, 1e-9, 4.0, 30.0])
def test_gradients_at_special_points(size):
    """theta = 0, the limit |theta| = 4 and close to a full turn: backward against differences."""
    theta = (size * torch.tensor([2.0, -1.0, 2.0]) / 3).requires_grad_()
    for function in (rot.C, rot.Q, rot.Q_inverse):
        assert torch.autograd.gradcheck(function, (theta,))
    phi = (size / 4 * torch.tensor([2.0, -1.0, 2.0]) / 3).requires_grad_()
    assert torch.autograd.gradcheck(rot.from_rotation_vector, (phi,))
