"""pose_from_points: where a body is whose markers were measured."""

import math

import pytest
import torch

import torchbeam as tb

TRIANGLE = torch.tensor([[1.0, 0, 0], [-0.5, 3**0.5 / 2, 0], [-0.5, -(3**0.5) / 2, 0]])


def turned(angle, axis):
    axis = torch.tensor(axis) / torch.tensor(axis).norm()
    K = torch.linalg.cross(axis.expand(3, 3), torch.eye(3)).mT
    return torch.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, 3.0, math.pi])
def test_an_exact_pose_is_found(angle):
    R, x = turned(angle, (1.0, -2, 0.5)), torch.tensor([0.3, -1.0, 2.0])
    pose = tb.pose_from_points(TRIANGLE, TRIANGLE @ R.mT + x)
    torch.testing.assert_close(pose.rotation, R, rtol=0, atol=1e-12)
    torch.testing.assert_close(pose.position, x, rtol=0, atol=1e-12)
    assert pose.residual.abs().max() < 1e-12


def test_it_is_the_least_of_the_squares_and_proper():
    random = torch.Generator().manual_seed(0)
    measured = TRIANGLE @ turned(2.0, (0.0, 1, 1)).mT + 0.2 * torch.randn(5, 3, 3, generator=random)
    pose = tb.pose_from_points(TRIANGLE, measured)
    best = pose.residual.square().sum((-2, -1))
    torch.testing.assert_close(torch.linalg.det(pose.rotation), torch.ones(5))
    for _ in range(20):
        small = torch.linalg.matrix_exp(_skew(1e-2 * torch.randn(3, generator=random)))
        off = 1e-2 * torch.randn(3, generator=random)
        other = measured - (TRIANGLE @ (pose.rotation @ small).mT + pose.position[:, None] + off)
        assert (other.square().sum((-2, -1)) > best).all()


def _skew(v):
    return torch.linalg.cross(v.expand(3, 3), torch.eye(3)).mT


def test_gradients_are_those_of_differences_also_of_an_equilateral_triangle():
    random = torch.Generator().manual_seed(1)
    measured = TRIANGLE @ turned(2.0, (0.0, 1, 1)).mT + 0.1 * torch.randn(3, 3, generator=random)

    def pose(points, measured):
        rotation, position, _ = tb.pose_from_points(points, measured)
        return torch.cat((rotation.flatten(), position))

    assert torch.autograd.gradcheck(
        pose, (TRIANGLE.clone().requires_grad_(), measured.requires_grad_())
    )


def test_a_point_that_was_not_seen_does_not_count():
    square = torch.cat((TRIANGLE, torch.tensor([[0.0, 0, 1]])))
    R = turned(1.0, (1.0, 0, 0))
    measured = square @ R.mT
    measured[1] = torch.nan
    pose = tb.pose_from_points(square, measured)
    torch.testing.assert_close(pose.rotation, R)
    assert pose.residual[1].isnan().all() and not pose.residual[[0, 2, 3]].isnan().any()


def test_points_on_a_line_tell_no_pose():
    line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    with pytest.raises(ValueError, match="on no line"):
        tb.pose_from_points(line, line)
    with pytest.raises(ValueError, match="on no line"):
        tb.pose_from_points(TRIANGLE[:2], TRIANGLE[:2])
