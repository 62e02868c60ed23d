"""Reduction of a linear model z' = A z to its slowest modes: bases of them, and A in these."""

from __future__ import annotations

import torch
from torch import Tensor

from ..math.block_matrices import balance, block_diagonal
from ..math.dense import inverse_unchecked, solve_unchecked
from ..math.quadratic_eigen import SURE, covering, lowest, rounding, unresisted
from .relaxing import reduced_arms

SYMMETRIC = 1e-6


def by_mass(
    A: Tensor, mass: Tensor | None, arms: int, count: int
) -> tuple[Tensor, Tensor, Tensor] | None:
    """Basis of the slowest undamped modes: right (..., n, 2 count), left with left @ right = I,
    and A in it, without the stiffness that rounding gives to rigid motions; None where mass,
    damping or stiffness is not symmetric.
    """
    if mass is None:
        return None
    k = mass.shape[-1]
    rows = mass @ A[..., k : 2 * k, :]
    K, D = -rows[..., :k], -rows[..., k : 2 * k]
    if any(
        (X - X.mT).detach().abs().amax() > SYMMETRIC * X.detach().abs().amax() for X in (K, D, mass)
    ):
        return None
    mass, K = (mass + mass.mT) / 2, (K + K.mT) / 2
    shift = covering(mass.detach(), K.detach())
    if shift is None:
        return None
    square, shapes, unknown = lowest(mass, K, shift, k)
    rigid, shapes = unresisted(square, unknown, shift)[0][..., :count], shapes[..., :count]
    root = torch.linalg.cholesky(shapes.mT @ mass @ shapes)
    shapes = torch.linalg.solve_triangular(root, shapes.mT, upper=False).mT
    right, left = (block_diagonal(X, X) for X in (shapes, (mass @ shapes).mT))
    if arms:
        creep = A[..., 2 * k :, :k] @ shapes, A[..., 2 * k :, 2 * k :]
        right, left = map(block_diagonal, (right, left), reduced_arms(*creep))
    small = left @ A @ right
    drag = small[..., count : 2 * count, count : 2 * count].diagonal(dim1=-2, dim2=-1).abs()
    free = rigid & (drag <= SURE * rounding(mass, D, shapes))
    held = torch.zeros_like(small, dtype=torch.bool)  # what is 0, and its derivative need not be
    held[..., :count] = rigid[..., None, :]
    held[..., count : 2 * count, :] |= rigid[..., None]
    held[..., count : 2 * count, count : 2 * count] = free[..., None] | free[..., None, :]
    return right, left, small - torch.where(held, small.detach(), 0.0)


def by_pairs(A: Tensor, arms: int, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Basis by the largest eigenvalues of A^-1, one of each pair: right (..., n, 2 count), left
    with left @ right = I, and A in it.
    """
    if arms:
        raise ValueError(
            "a model of a scene that relaxes, by Viscoelastic, was asked for its reduction; "
            "symmetric stiffness and damping are wanted there: no load that turns with the "
            "beam, no air"
        )
    scale = balance(A)
    inverse = inverse_unchecked(A * scale[..., None, :] / scale[..., :, None])
    singular = not torch.isfinite(inverse.detach()).all()
    if not singular:
        eigenvalues, vectors = torch.linalg.eig(inverse)
        size = eigenvalues.detach().abs()
        # or rounding splits a double zero by its root; a model in single was one in double
        rounded = torch.finfo(torch.float64).eps * A.detach().abs().amax((-2, -1))
        singular = bool((size.amax(-1).square() * rounded > 1).any())
    if singular:
        raise ValueError(
            "a model with rigid motions was given, whose stiffness is not symmetric or whose "
            "sections creep without rotary inertia; supports that hold the beam, or a rotary "
            "inertia, are wanted for its reduction"
        )
    # of 1/eigenvalue: one of each pair
    size = torch.where(eigenvalues.detach().imag > 0, -1.0, size)
    chosen = size.sort(dim=-1, descending=True, stable=True)[1][..., :count]
    if (eigenvalues.detach().imag.gather(-1, chosen) == 0).any():
        raise ValueError(
            f"count = {count} was given; a motion among the slowest does not oscillate and "
            "has no pair"
        )
    at = chosen[..., None, :].expand(*chosen.shape[:-1], A.shape[-1], count)
    right = torch.view_as_real(vectors.gather(-1, at)).flatten(-2)
    left = torch.view_as_real(inverse_unchecked(vectors).mT.gather(-1, at)).flatten(-2).mT
    sign = left.new_tensor([2.0, -2.0]).repeat(count)
    right, left = right * scale[..., :, None], sign[:, None] * left / scale[..., None, :]
    return right, left, left @ A @ right


def static_beside(
    model: tuple[Tensor, Tensor, Tensor], right: Tensor, left: Tensor, small: Tensor
) -> Tensor:
    """(..., p, m) steady response of all motions of A, B, C but those of a basis, in which these
    have A `small`: finite beside rigid motions, which are in the basis.
    """
    A, B, C = model
    eye = torch.eye(small.shape[-1], dtype=A.dtype, device=A.device)
    B, C = B - right @ (left @ B), C - (C @ right) @ left
    scale = balance(A)
    within = (right @ (eye + small) @ left - A) * scale[..., None, :] / scale[..., :, None]
    return C * scale[..., None, :] @ solve_unchecked(within, B / scale[..., :, None])
