"""Quaternions: the algebra, the exponential and its inverse, derivatives at the special points."""

import math

import pytest
import torch
from torch.testing import assert_close

from torchbeam.math import quaternions as quat

# products of a few numbers of size one: a handful of roundings
EXACT = dict(rtol=0, atol=2e-15)


@pytest.fixture
def q():
    torch.manual_seed(0)
    return quat.normalize(torch.randn(20, 4))


def test_hat_is_the_cross_product():
    """~v x = v x x."""
    v, x = torch.randn(2, 7, 3)
    assert_close((quat.skew(v) @ x[..., None])[..., 0], torch.linalg.cross(v, x), **EXACT)


def test_matrix_is_a_rotation_and_respects_products(q):
    """R R^T = I, det R = 1, R(p q) = R(p) R(q), R(conj q) = R^T, R(q) v = rotate(q, v)."""
    p, v = q.flip(0), torch.randn(20, 3)
    R = quat.matrix(q)
    assert_close(R @ R.mT, torch.eye(3).expand(20, 3, 3), **EXACT)
    assert_close(torch.linalg.det(R), torch.ones(20), **EXACT)
    assert_close(quat.matrix(quat.multiply(p, q)), quat.matrix(p) @ R, **EXACT)
    assert_close(quat.matrix(quat.conjugate(q)), R.mT, **EXACT)
    assert_close(quat.rotate(q, v), (R @ v[..., None])[..., 0], rtol=0, atol=1e-14)
    assert_close(
        quat.matrix(quat.identity((2,), torch.float64)), torch.eye(3).expand(2, 3, 3), **EXACT
    )


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-5, 0.99e-4, 1.01e-4, 1e-3, 1.9e-3, 2.1e-3, 1.0, 3.0, math.pi]
)
def test_exponential_is_the_matrix_exponential_and_logarithm_its_inverse(angle):
    """R(exp phi) = expm(~phi); log exp phi = phi up to half a turn: on both sides of each series'
    threshold.
    """
    n = torch.nn.functional.normalize(torch.tensor([1.0, -2, 3]), dim=0)
    phi = angle * n
    q = quat.exponential(phi)
    assert_close(quat.matrix(q), torch.linalg.matrix_exp(quat.skew(phi)), **EXACT)
    assert_close(quat.logarithm(q), phi, rtol=1e-14, atol=1e-15)
    assert_close(quat.logarithm(-q), phi, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 2e-3, 1.0, 3.0])
def test_derivatives_of_exponential_and_logarithm(angle):
    """Central differences, reverse and forward mode, at zero too: no NaN from the branch that is
    not taken.
    """
    phi = (angle * torch.tensor([0.6, 0.0, 0.8])).requires_grad_()
    assert torch.autograd.gradcheck(quat.exponential, phi, check_forward_ad=True)
    assert torch.autograd.gradcheck(
        lambda p: quat.logarithm(quat.exponential(p)), phi, check_forward_ad=True
    )


def test_half_way_takes_the_shorter_arc(q):
    """Half way from 1 to exp(phi) is exp(phi/2), whatever the signs of the quaternions."""
    phi = torch.randn(20, 3)
    end = quat.multiply(q, quat.exponential(phi))
    middle = quat.matrix(quat.multiply(q, quat.exponential(phi / 2)))
    assert_close(quat.matrix(quat.half_way(q, end)), middle, rtol=0, atol=1e-14)
    assert_close(quat.matrix(quat.half_way(q, -end)), middle, rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", [(1.0, 0, 0), (0.0, 1, 0), (0.0, 0, 1), (1.0, 1, 1)])
@pytest.mark.parametrize("angle", [0.0, 1.0, math.pi - 1e-9, math.pi, 5.0])
def test_from_matrix_inverts_matrix(axis, angle):
    """Every pivot of Shepperd's method, half turns included; the same rotation comes back, up to
    the sign.
    """
    R = torch.linalg.matrix_exp(
        angle * quat.skew(torch.nn.functional.normalize(torch.tensor(axis), dim=0))
    )
    assert_close(quat.matrix(quat.from_matrix(R)), R, rtol=0, atol=1e-14)
