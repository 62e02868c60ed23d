"""Levers: how a node's motion moves the centre of mass that is fixed to it, and what a force there
asks of the node.

With x the lever and A spin = spin x x:

    x_c = r + x      v_c = v + A spin      moment = A^T force      mass matrix [I; A^T] M [I, A]

What only a centre off its node asks for is given as a function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..topology.protocols import Matrix
from .coordinates.spatial import Spatial


@dataclass(frozen=True)
class NoMassOffset(Tree):
    """Centres of mass that lie in their nodes. Positions and velocities are (..., N+1, p), spins
    (..., N+1, s), frame a.
    """

    present = False

    def of_nodes(self, space: Spatial, nodes: slice) -> NoMassOffset:
        """Of some nodes, in their space."""
        return self

    def turned(self, rotation: Tensor) -> NoMassOffset:
        """In frame a, of levers in section axes."""
        return self

    def mean(self, other: NoMassOffset) -> NoMassOffset:
        """Of the levers here and there."""
        return self

    def velocity(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        """v_c."""
        return node

    def acceleration(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        """That of the centre of a node that does not change its spin."""
        return node

    def acceleration_by(self, by_move: Tensor, by_spin: Callable[[], Tensor]) -> Tensor:
        """A node's acceleration by its move (..., p, p) and, where its spin matters, by both."""
        return by_move

    def wrench(self, force: Tensor, moment: Tensor) -> Tensor:
        """[force; moment] (..., N+1, w) on nodes: a force on their centres, and a moment."""
        return torch.cat((force, moment), -1)

    def prepared(self, masses: Matrix, s: int) -> Matrix:
        """What `matrix` and `tangent` take of p by p blocks, before the levers are known."""
        return masses.each(lambda M: pad(M, (0, s, 0, s)))

    def matrix(self, masses: Matrix, moved: Callable[[], Tensor]) -> Matrix:
        """[I; A^T] M [I, moved], w by w; moved (..., N+1, p, s): centres' moves by nodes' spins."""
        return masses

    def tangent(
        self, masses: Matrix, moved: Callable[[], Tensor], wrench: Callable[[], Tensor]
    ) -> Matrix:
        """The same, and that the levers turn under the force of the wrench."""
        return masses


@dataclass(frozen=True)
class MassOffset(NoMassOffset):
    """Centres of mass off their nodes: x (..., N+1, p) m, frame a, or as they are fixed to sections
    in their axes.
    """

    space: Spatial
    offset: Tensor = leaf(2)

    present = True

    def of_nodes(self, space: Spatial, nodes: slice) -> MassOffset:
        return MassOffset(space, self.offset[..., nodes, :])

    @cached
    def A(self) -> Tensor:
        """(..., N+1, p, s)"""
        return self.space.lever_matrix(self.offset)

    def turned(self, rotation: Tensor) -> MassOffset:
        return MassOffset(
            self.space, (self.space.matrix(rotation) @ self.offset[..., None])[..., 0]
        )

    def mean(self, other: MassOffset) -> MassOffset:
        return MassOffset(self.space, (self.offset + other.offset) / 2)

    def by_arm(self, x: Tensor) -> Tensor:
        """x (..., N+1, 1) times the size of the lever: a force's moment, a spin's velocity."""
        return x * self.offset.detach().abs().sum(-1, keepdim=True)

    def velocity(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        return node + (self.A @ spin()[..., None])[..., 0]

    def acceleration(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        if not self.space.turns:
            return node
        turning = self.space.skew(spin())
        return node + (turning @ (turning @ self.offset[..., None]))[..., 0]

    def acceleration_by(self, by_move: Tensor, by_spin: Callable[[], Tensor]) -> Tensor:
        by = by_spin()
        return torch.cat((by_move.expand(*by.shape[:-1], self.space.dims.position), by), -1)

    def wrench(self, force: Tensor, moment: Tensor) -> Tensor:
        return torch.cat((force, moment + (self.A.mT @ force[..., None])[..., 0]), -1)

    def prepared(self, masses: Matrix, s: int) -> Matrix:
        return masses

    def matrix(self, masses: Matrix, moved: Callable[[], Tensor]) -> Matrix:
        return masses.between(with_levers, self.A, moved())

    def tangent(
        self, masses: Matrix, moved: Callable[[], Tensor], wrench: Callable[[], Tensor]
    ) -> Matrix:
        p, moved = self.space.dims.position, moved()
        matrix = self.matrix(masses, lambda: moved)
        if not self.space.turns:
            return matrix
        return matrix.minus(
            pad(self.space.lever_matrix(wrench()[..., :p]).mT @ moved, (p, 0, p, 0))
        )


def with_levers(block: Tensor, A: Tensor, moved: Tensor) -> Tensor:
    """[I; A^T] block [I, moved] (..., w, w): a force by a displacement (..., p, p), both of centres
    off their nodes.
    """
    turned = block @ moved
    row = torch.cat((block.expand(*turned.shape[:-2], *block.shape[-2:]), turned), -1)
    pushed = A.mT @ row
    return torch.cat((row.expand(*pushed.shape[:-2], *row.shape[-2:]), pushed), -2)
