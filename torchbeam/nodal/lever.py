"""Levers: how a node's motion moves the centre of mass that is fixed to it, and what a force there asks of the node.

With x the lever and A spin = spin x x:

    x_c = r + x      v_c = v + A spin      moment = A^T force      mass matrix [I; A^T] M [I, A]

What only a centre off its node asks for is given as a function. Matrices of the chain are told as in `mass`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from .coordinates.spatial import Space
from .mass import Blocks


@dataclass(frozen=True)
class NoLever(Tree):
    """Centres of mass that lie in their nodes. Positions and velocities are (..., N+1, p), spins (..., N+1, s), frame a."""

    present = False

    def of_nodes(self, space: Space, nodes: slice) -> NoLever:
        """Of some nodes, in their space."""
        return self

    def turned(self, rotation: Tensor) -> NoLever:
        """In frame a, of levers in section axes."""
        return self

    def mean(self, other: NoLever) -> NoLever:
        """Of the levers here and there."""
        return self

    def velocity(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        """v_c."""
        return node

    def acceleration(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        """That of the centre of a node that does not change its spin."""
        return node

    def acceleration_by(self, by_move: Tensor, by_spin: Callable[[], Tensor]) -> Tensor:
        """A node's acceleration by its move (..., p, p) and, where its spin matters (..., p, s), by both."""
        return by_move

    def wrench(self, force: Tensor, moment: Tensor) -> Tensor:
        """[force; moment] (..., N+1, w) on nodes: a force on their centres, and a moment."""
        return torch.cat((force, moment), -1)

    def prepared(self, masses: Blocks, s: int) -> Blocks:
        """What `blocks` and `tangent` take of p by p blocks: what can be done before the levers are known."""
        return tuple(pad(M, (0, s, 0, s)) for M in masses)

    def blocks(self, masses: Blocks, moved: Callable[[], Tensor]) -> Blocks:
        """[I; A^T] M [I, moved], w by w; moved (..., N+1, p, s): the move of the centres by the nodes' spins."""
        return masses

    def tangent(self, masses: Blocks, moved: Callable[[], Tensor], wrench: Callable[[], Tensor]) -> Blocks:
        """The same, and that the levers turn under the force of the wrench."""
        return masses


@dataclass(frozen=True)
class Lever(NoLever):
    """Centres of mass off their nodes: x (..., N+1, p) m, frame a, or as they are fixed to sections in their axes."""

    space: Space
    x: Tensor = leaf(2)

    present = True

    def of_nodes(self, space: Space, nodes: slice) -> Lever:
        return Lever(space, self.x[..., nodes, :])

    @cached
    def A(self) -> Tensor:
        """(..., N+1, p, s)"""
        return self.space.lever_matrix(self.x)

    def turned(self, rotation: Tensor) -> Lever:
        return Lever(self.space, (self.space.matrix(rotation) @ self.x[..., None])[..., 0])

    def mean(self, other: Lever) -> Lever:
        return Lever(self.space, (self.x + other.x) / 2)

    def velocity(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        return node + (self.A @ spin()[..., None])[..., 0]

    def acceleration(self, node: Tensor, spin: Callable[[], Tensor]) -> Tensor:
        if not self.space.turns:
            return node
        turning = self.space.skew(spin())
        return node + (turning @ (turning @ self.x[..., None]))[..., 0]

    def acceleration_by(self, by_move: Tensor, by_spin: Callable[[], Tensor]) -> Tensor:
        by = by_spin()
        return torch.cat((by_move.expand(*by.shape[:-1], self.space.position), by), -1)

    def wrench(self, force: Tensor, moment: Tensor) -> Tensor:
        return torch.cat((force, moment + (self.A.mT @ force[..., None])[..., 0]), -1)

    def prepared(self, masses: Blocks, s: int) -> Blocks:
        return masses

    def blocks(self, masses: Blocks, moved: Callable[[], Tensor]) -> Blocks:
        (M, *between), moved = masses, moved()
        coupled = self.space.chain.coupled
        pairs = zip(between, coupled(self.A, 2)[0], coupled(moved, 2)[1], strict=True) if between else ()
        return with_levers(M, self.A, moved), *(with_levers(*pair) for pair in pairs)

    def tangent(self, masses: Blocks, moved: Callable[[], Tensor], wrench: Callable[[], Tensor]) -> Blocks:
        p, moved = self.space.position, moved()
        D, *between = self.blocks(masses, lambda: moved)
        if not self.space.turns:
            return D, *between
        return D - pad(self.space.lever_matrix(wrench()[..., :p]).mT @ moved, (p, 0, p, 0)), *between


def with_levers(block: Tensor, A: Tensor, moved: Tensor) -> Tensor:
    """[I; A^T] block [I, moved] (..., w, w): a force by a displacement (..., p, p), both of centres off their nodes."""
    turned = block @ moved
    row = torch.cat((block.expand(*turned.shape[:-2], *block.shape[-2:]), turned), -1)
    pushed = A.mT @ row
    return torch.cat((row.expand(*pushed.shape[:-2], *row.shape[-2:]), pushed), -2)
