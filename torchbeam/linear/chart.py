"""Chart: coordinates of a configuration about another one, as moves of the nodes."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..math.dense import inverse_unchecked
from ..math.shapes import broadcast_shapes
from ..nodal.coordinates.spatial import Space
from ..nodal.model import Model
from ..state.state import State


@dataclass(frozen=True)
class Chart:
    """Coordinates of a configuration as moves of the nodes about `own`: with B the operator of the elements' strains there,

        B q = strain - strain of own,    q of the base node = its displacement and turn, frame a

    length (..., N, 1) m, of the elements
    base   the node that holds the beam
    strain (..., N, k) of `own`;  solve (..., w (N+1), w (N+1)): from displacement and turn of the base and strains to q
    """

    space: Space
    own: State
    length: Tensor
    base: int
    strain: Tensor
    solve: Tensor

    @classmethod
    def of(cls, model: Model, state: State) -> Chart:
        space, own = model.space, model.space.to_reduced(state)
        base = model.constraints.nodes[0] if model.constraints.nodes else 0

        w, nodes = space.unknowns, model.count + 1
        eye = torch.eye(w * nodes, dtype=own.position.dtype, device=own.position.device)
        kinematics = model.kinematics(own.position, own.rotation)
        B, moves = space.strain_operator(kinematics, model.length), space.to_elements(eye.unflatten(-1, (-1, w)))
        rows = torch.einsum("...eij,mej->...eim", B, moves).flatten(-3, -2)
        root = eye[base % nodes * w:][:w].expand(*rows.shape[:-2], w, -1)
        strain = space.strains(kinematics, model.length)
        return cls(space, own, model.length, base, strain, inverse_unchecked(torch.cat((root, rows), -2)))

    def __call__(self, position: Tensor, rotation: Tensor) -> Tensor:
        """q (..., w (N+1)) of a configuration in the space's coordinates."""
        space, own, base = self.space, self.own, self.base
        turn = space.logarithm(space.multiply(rotation, space.inverse(own.rotation)))
        turn = turn if space.turns else space.to_frame(own.rotation, turn)
        kinematics = space.kinematics(*space.chain.poses(position, rotation), self.length)
        strain = space.strains(kinematics, self.length) - self.strain
        parts = (position[..., base, :] - own.position[..., base, :], turn[..., base, :], strain.flatten(-2))
        lead = broadcast_shapes(*(x.shape[:-1] for x in parts))
        return (self.solve @ torch.cat([x.expand(*lead, -1) for x in parts], -1)[..., None])[..., 0]
