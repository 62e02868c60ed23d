"""Derivatives of the eigenvalues of M a'' + D a' + K a = 0, and of their shapes.

With Q(lambda) = K + lambda D + lambda^2 M and the right and left null vectors v and w,

    d lambda = -w^T dQ v / (w^T (D + 2 lambda M) v)
    Q dv = -dQ v - (D + 2 lambda M) v d lambda

(Murthy and Haftka 1988), dv being made unique by one entry of v that stays.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .concrete import concrete
from .dense import solve
from .first_derivative import first_only
from .quadratic_eigen import Pairs


def attach(M: Tensor, D: Tensor | None, K: Tensor, pairs: Pairs) -> tuple[Tensor, Tensor]:
    """Eigenvalues and right vectors with their derivatives by M, D, K; those of repeated ones are
    refused when asked for.

    Vectors have 1 as their largest entry.
    """
    value, v, w, repeated = pairs[:4]
    v, largest = upright(v)
    w = v if w is None else w
    by = value[..., None]
    Qv = _times(K, v) + by**2 * _times(M, v) + (0 if D is None else by * _times(D, v))
    with torch.no_grad():
        slope = 2 * by * _times(M, v) + (0 if D is None else _times(D, v))
        pivot = (w * slope).sum(-1)
    change = -(w * Qv).sum(-1) / torch.where(pivot == 0, 1, pivot)
    change = _Distinct.apply(torch.where(pivot == 0, change.detach(), change), repeated)
    missing = _Distinct.apply(Qv, repeated[..., None].expand_as(Qv))
    matrices = (M.detach(), torch.zeros_like(M) if D is None else D.detach(), K.detach())
    return value + (change - change.detach()), _Shape.apply(
        missing, *matrices, value, v, slope, largest
    )


def upright(v: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors (..., n) with 1 as their largest entry, and where that is."""
    largest = v.abs().argmax(-1, keepdim=True)
    return v / v.gather(-1, largest), largest


def _times(A: Tensor, v: Tensor) -> Tensor:
    """A v for v (..., count, n), complex, A real."""
    both = A @ torch.cat((v.real, v.imag), -2).mT
    return torch.complex(*both.mT.chunk(2, -2))


class _Distinct(torch.autograd.Function):
    """The same, once differentiable; an error for the derivative of a repeated eigenvalue."""

    generate_vmap_rule = True

    @staticmethod
    def forward(x: Tensor, repeated: Tensor) -> Tensor:
        return x.clone()

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx, grad: Tensor):
        x, repeated = ctx.saved_tensors
        return first_only(_refuse(grad, repeated), grad, x), None

    @staticmethod
    def jvp(ctx, tangent: Tensor, _):
        x, repeated = ctx.saved_tensors
        return first_only(_refuse(tangent, repeated), tangent, x)


def _refuse(x: Tensor, repeated: Tensor) -> Tensor:
    if concrete(repeated & (x != 0)).any():
        raise RuntimeError(
            "the derivative of a repeated eigenvalue, or of its shape, was asked for; it has none "
            "of its own: distinct ones are wanted (two bending stiffnesses that differ)"
        )
    return x


class _Shape(torch.autograd.Function):
    """v, whose derivative solves the bordered system [Q, slope; e_k^T, 0]
    [dv; d lambda] = -[missing; 0], mode by mode.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(missing, M, D, K, value, v, slope, largest) -> Tensor:
        return v.clone()

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    def _solve(saved: tuple[Tensor, ...], right: Tensor, adjoint: bool) -> Tensor:
        M, D, K, value, v, slope, largest = saved
        rows = []
        for k in range(value.shape[-1]):
            by = value[..., k, None, None]
            Q = K + by * D + by**2 * M
            pick = torch.zeros_like(v[..., k, :]).scatter(-1, largest[..., k, :], 1)
            whole = torch.cat((
                torch.cat((Q, slope[..., k, :, None]), -1),
                torch.nn.functional.pad(pick, (0, 1))[..., None, :],
            ), -2)  # fmt: skip
            whole = whole.mH if adjoint else whole
            rows.append(
                -solve(whole, torch.nn.functional.pad(right[..., k, :], (0, 1))[..., None])[
                    ..., :-1, 0
                ]
            )
        return torch.stack(rows, -2)

    @staticmethod
    def backward(ctx, grad: Tensor):
        # it may be on where backward is called
        with torch.autocast(grad.device.type, enabled=False):
            return _Shape._solve(ctx.saved_tensors, grad, True), *[None] * 7

    @staticmethod
    def jvp(ctx, tangent: Tensor, *_):
        return _Shape._solve(ctx.saved_tensors, tangent, False)
