"""Equilibrium of the nodal form: the balance without inertia."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..effects import Inputs
from .balance import Linearisation, Residual, largest
from .element import Kinematics, forces, geometric_stiffness, kinematics, strain, strain_operator, to_nodes
from .model import Model, times


class Shape(NamedTuple):
    """position (..., N+1, 3) m, rotation (..., N+1, 4), stress (..., N, 6) N and N m."""

    position: Tensor
    rotation: Tensor
    stress: Tensor


@dataclass(frozen=True)
class Still:
    """to_nodes(h B^T [F; M]) = share * loads and S [F; M] = strain; `share` (...) in [0, 1] steps the loads."""

    model: Model
    t: Tensor
    inputs: Inputs
    share: Tensor

    def moved(self, x: Shape, move: Tensor, dstress: Tensor) -> Shape:
        turn = pad(move[..., 3:] / 2, (1, 0), value=1.0)
        return Shape(x.position + move[..., :3], quat.normalize(quat.multiply(turn, x.rotation)), x.stress + dstress)

    def residual(self, x: Shape) -> tuple[Residual, Kinematics]:
        model, h = self.model, self.model.length
        kin = kinematics(x.position, x.rotation, h)
        element = forces(kin, x.stress, h)
        external = model.external(x.rotation, self.t, self.inputs, model.scene.loads)
        external = external if isinstance(external, float) else self.share[..., None, None] * external
        bent = strain(kin, h, model.reference)
        gap = bent - times(model.S, x.stress[..., None])[..., 0]
        return Residual(to_nodes(element) - external, gap, *largest(h, element, external),
                        bent.detach().abs().amax((-1, -2))), kin

    def linearise(self, x: Shape, kin: Kinematics) -> Linearisation:
        model = self.model
        moving = tuple(load for load in model.scene.loads if load.moves(model.scene.beam))
        load = self.share[..., None, None, None] * model.external_tangent(x.rotation, self.t, self.inputs, moving)
        B = strain_operator(kin, model.length)
        diagonal = -pad(load, (3, 0)) if moving else torch.zeros_like(B[..., :1, :6, :6])
        return Linearisation.condense(geometric_stiffness(kin, x.stress, model.length), diagonal,
                                      model.length[..., None] * B, model.stiffness(), B)
