"""What statics and the implicit step share: a balance of nodal forces with the stress as an unknown of its own.

Unknowns are a move of the free nodes (dr, spin) and the stress [F; M] of each element. With B the strain operator,

    g       = inertia + to_nodes(h B^T [F; M]) - external = 0        (..., N+1, 6), row 0 is the reaction
    g_eps   = strain - S [F; M]                        = 0        (..., N, 6)

Linearised, with E the derivative of the strain in g_eps and C = S^-1 (regularised where S is singular; the residual keeps
S exactly), the stress is condensed element by element (Magisano, Leonetti and Garcea 2017: Newton on this mixed form needs
few iterations whatever the stiffness):

    (K_rest + h B^T C E) move = -(g + h B^T C g_eps)        d[F; M] = C (g_eps + E move)
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..solve import ChainSolve
from .element import to_blocks, to_nodes
from .model import times


class Residual(NamedTuple):
    """nodes (..., N+1, 6), strain (..., N, 6) as above; force, moment, size_strain (...): the largest terms in them."""

    nodes: Tensor
    strain: Tensor
    force: Tensor
    moment: Tensor
    size_strain: Tensor

    def measure(self) -> Tensor:
        """(...) the scaled residual: each equation over the largest term in it; not finite where anything is not."""
        number = torch.finfo(self.nodes.dtype)
        free = self.nodes.detach()[..., 1:, :].abs()
        force = free[..., :3].amax((-1, -2)) / (self.force + number.tiny)
        moment = free[..., 3:].amax((-1, -2)) / (self.moment + number.tiny)
        # strains below ROUNDING eps are differences of positions that floating point does not hold
        gap = (self.strain.detach().abs().amax((-1, -2)) - ROUNDING * number.eps).clamp(min=0)
        return torch.maximum(torch.maximum(force, moment), gap / (self.size_strain + number.eps))


ROUNDING = 1000.0


class Linearisation(NamedTuple):
    """The condensed tangent; constants (detached) of one Newton step or of the implicit function theorem."""

    D: Tensor  # (..., N, 6, 6) of the free nodes
    L: Tensor
    U: Tensor
    root: Tensor  # (..., 6, 6) of node 0's balance by a move of node 1
    hB: Tensor  # (..., N, 6, 9) h B
    C: Tensor
    E: Tensor  # (..., N, 6, 9)

    @classmethod
    def condense(cls, rest: Tensor, diagonal: Tensor | float, hB: Tensor, C: Tensor, E: Tensor,
                 coupling: Tensor | None = None) -> Linearisation:
        """rest (..., N, 9, 9) of elements at fixed stress; diagonal (..., N+1, 6, 6) of nodes; coupling (..., N, 6, 6)
        between neighbours: what is left of the mass matrix.
        """
        D, U, L = to_blocks(rest + hB.mT @ times(C, E))
        D = D + diagonal
        if coupling is not None:
            U, L = U + coupling, L + coupling
        return cls(D[..., 1:, :, :], L[..., 1:, :, :], U[..., 1:, :, :], U[..., 0, :, :], hB, C, E)

    def solve(self, g: Tensor, g_strain: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What a residual asks for: move (..., N+1, 6) with a row of zeros for the root, d[F; M] (..., N, 6); and the root's
        balance after it, the reaction (..., 6).
        """
        pushed = to_nodes((self.hB.mT @ times(self.C, g_strain[..., None]))[..., 0])
        free = ChainSolve.apply(self.D, self.L, self.U, -(g + pushed)[..., 1:, :])
        move = torch.nn.functional.pad(free, (0, 0, 1, 0))
        nine = torch.cat((move[..., :3].diff(dim=-2), move[..., :-1, 3:], move[..., 1:, 3:]), -1)
        dstress = times(self.C, g_strain[..., None] + self.E @ nine[..., None])[..., 0]
        reaction = g[..., 0, :] + pushed[..., 0, :] + (self.root @ free[..., 0, :, None])[..., 0]
        return move, dstress, reaction


def largest(length: Tensor, *terms: Tensor | float) -> tuple[Tensor, Tensor]:
    """Largest force and moment (...) in the terms of a balance, of elements (..., N, 9) or of nodes (..., N+1, 6): what
    its residual is measured against. A force is also a moment, over an element's length; a moment is also a force, over
    the beam's.
    """
    sizes = []
    for term in terms:
        if isinstance(term, Tensor):
            term = term.detach().abs()
            sizes.append((term[..., :3].amax((-1, -2)), term[..., 3:].amax((-1, -2))))
    force, moment = (torch.stack(torch.broadcast_tensors(*part)).amax(0) for part in zip(*sizes, strict=True))
    length = length.detach()
    return torch.maximum(force, moment / length.sum((-1, -2))), moment + force * length.amax((-1, -2))
