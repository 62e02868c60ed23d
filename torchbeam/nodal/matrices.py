"""Mass, damping and tangent stiffness of small motions about an equilibrium, of the free nodes' moves."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..state import State
from .element import geometric_stiffness, kinematics, strain_operator, to_blocks
from .model import Model, times


def matrices(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor | None, Tensor]:
    """M, D (None without damping) and K (..., 6 N, 6 N) of the free nodes' moves at an equilibrium."""
    kin = kinematics(state.position, state.rotation, model.length)
    B = strain_operator(kin, model.length)
    hB = (model.length[..., None] * B).mT
    K = _dense(*to_blocks(geometric_stiffness(kin, state.stress, model.length) + hB @ times(model.C, B)))
    loads = tuple(x for x in model.scene.loads if x.moves(model.scene.beam))
    if loads:
        K = K - _dense(pad(model.external_tangent(state.rotation, t, inputs, loads), (3, 0)))
    D = None if model.rate is None else _dense(*to_blocks(hB @ times(model.C, times(model.rate, B))))
    M = _mass(model, state.rotation)
    M, K = torch.broadcast_tensors(M, K)
    return (M, None, K) if D is None else torch.broadcast_tensors(M, D, K)


def _mass(model: Model, rotation: Tensor) -> Tensor:
    eye = torch.eye(3, dtype=rotation.dtype, device=rotation.device)
    diagonal = pad(model.mass[..., None] * eye, (0, 3, 0, 3))
    if model.inertia is not None:
        R = quat.matrix(rotation)
        diagonal = diagonal + pad(R @ model.inertia @ R.mT, (3, 0, 3, 0))
    if model.coupling is None:
        return _dense(diagonal)
    k = pad(model.coupling[..., None] * eye, (0, 3, 0, 3))
    return _dense(diagonal - pad(k, (0, 0, 0, 0, 0, 1)) - pad(k, (0, 0, 0, 0, 1, 0)), k, k)


def _dense(diagonal: Tensor, upper: Tensor | None = None, lower: Tensor | None = None) -> Tensor:
    """(..., 6 N, 6 N) of the free nodes, from blocks (..., N+1, 6, 6) of all and (..., N, 6, 6) between them."""
    N = diagonal.shape[-3] - 1
    if upper is not None:
        shape = torch.broadcast_shapes(*(x.shape[:-3] for x in (diagonal, upper, lower)))
        diagonal, upper, lower = (x.expand(*shape, *x.shape[-3:]) for x in (diagonal, upper, lower))
    A = diagonal.new_zeros(*diagonal.shape[:-3], N, 6, N, 6)
    at = torch.arange(N, device=diagonal.device)
    A[..., at, :, at, :] = diagonal[..., 1:, :, :].movedim(-3, 0)
    if upper is not None and N > 1:
        A[..., at[:-1], :, at[1:], :] = upper[..., 1:, :, :].movedim(-3, 0)
        A[..., at[1:], :, at[:-1], :] = lower[..., 1:, :, :].movedim(-3, 0)
    return A.flatten(-4, -3).flatten(-2)
