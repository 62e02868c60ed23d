"""Rotary inertia of the nodes about their centres of mass: angular momentum R J Omega, and what
changing it asks for.

What only rotary inertia asks for is given as a function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf
from ..topology.protocols import Matrix
from .coordinates.spatial import Spatial


@dataclass(frozen=True)
class NoRotaryInertia(Tree):
    """Nodes that turn without inertia. Spins and moments are (..., N+1, s)."""

    space: Spatial

    present = False

    def of_nodes(self, space: Spatial, nodes: slice) -> NoRotaryInertia:
        """Of some nodes, in their space."""
        return NoRotaryInertia(space)

    def section_momentum(self, spin: Tensor) -> Tensor:
        """J Omega kg m^2/s, section axes as the spin."""
        return torch.zeros_like(spin)

    def momentum(self, rotation: Tensor, spin: Tensor) -> Tensor:
        """R J Omega, frame a; spin in section axes."""
        return torch.zeros_like(spin)

    def present_or(self, none: Tensor, value: Callable[[], Tensor]) -> Tensor:
        """What it is with rotary inertia, or `none` without."""
        return none

    def matrix(self, masses: Matrix, by_spin: Callable[[], Tensor]) -> Matrix:
        """`masses` with a moment's derivative by the spin (..., N+1, s, s)."""
        return masses


@dataclass(frozen=True)
class RotaryInertia(NoRotaryInertia):
    """J (..., N+1, s, s) kg m^2 about the centre of mass, section axes."""

    J: Tensor = leaf(3)

    present = True

    def of_nodes(self, space: Spatial, nodes: slice) -> RotaryInertia:
        return RotaryInertia(space, self.J[..., nodes, :, :])

    def section_momentum(self, spin: Tensor) -> Tensor:
        return (self.J @ spin[..., None])[..., 0]

    def momentum(self, rotation: Tensor, spin: Tensor) -> Tensor:
        return self.space.to_frame(rotation, self.section_momentum(spin))

    def present_or(self, none: Tensor, value: Callable[[], Tensor]) -> Tensor:
        return value()

    def matrix(self, masses: Matrix, by_spin: Callable[[], Tensor]) -> Matrix:
        p = self.space.dims.position
        return masses.plus(pad(by_spin(), (p, 0, p, 0)))

    def in_frame(self, rotation: Tensor) -> Tensor:
        """R J R^T (..., N+1, s, s), frame a."""
        R = self.space.spin_matrix(rotation)
        return R @ self.J @ R.mT

    def gyroscopic(self, spin: Tensor) -> Tensor:
        """Omega x J Omega, section axes."""
        return (self.space.spin_skew(spin) @ self.section_momentum(spin)[..., None])[..., 0]

    def momentum_by(self, R: Tensor, by_spin: Tensor, H: Tensor, turn: Tensor) -> Tensor:
        """d(R J Omega) = R J d(Omega) - H x d(turn), (..., N+1, s, s), of d(Omega) in section axes
        and d(turn) in frame a.
        """
        return R @ (self.J @ by_spin) - self.space.spin_skew(H) @ turn
