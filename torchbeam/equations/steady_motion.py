"""Inertia of nodes that stand in a frame: none, or that of steady rotation, and its small motions.

Steady motion with v and omega of frame a: with x = r + R e the centres of mass, A spin = spin x R e
and J, H = J omega in frame a, momenta are M (v + omega x x) and H, and ask for

    force = ~omega M (v + omega x x)      moment = omega x H + R e x force

With T = [I, A] the derivatives by the moves q and by their rates are

    T^T M ~omega ~omega T + ~omega (J ~omega - ~H) - (force turning with the lever)
    T^T 2 M ~omega T + J ~omega + ~omega J - ~H
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..nodal.frame import FixedFrame, TurningFrame
from ..nodal.inertia import Inertia
from ..topology.protocols import Matrix


@dataclass(frozen=True)
class AtRest:
    """Nodes at rest, or moved alike: no inertia. position (..., N+1, p), rotation (..., N+1, *)."""

    inertia: Inertia
    frame: FixedFrame

    def less(self, load: Tensor | float, position: Tensor, rotation: Tensor) -> Tensor | float:
        """load - [force; moment] (..., N+1, w) of inertia."""
        return load

    def tangent(self, position: Tensor, rotation: Tensor) -> Matrix | None:
        """Derivative of force and moment by the nodes' moves; None = none."""
        return None

    def gyroscopic(self, position: Tensor, rotation: Tensor) -> Matrix | None:
        """The same by the rates of the moves."""
        return None


@dataclass(frozen=True)
class SteadyRotation(AtRest):
    """Nodes that turn with the frame."""

    frame: TurningFrame

    def less(self, load: Tensor | float, position: Tensor, rotation: Tensor) -> Tensor:
        return load - self._wrench(position, rotation)

    def _wrench(self, position: Tensor, rotation: Tensor) -> Tensor:
        inertia, frame, still = self.inertia, self.frame, torch.zeros_like
        lever = inertia.offset.turned(rotation)
        spin = frame.spin(still(position[..., : inertia.space.dims.spin]))
        velocity = lever.velocity(frame.velocity(still(position), position), lambda: spin)
        momentum, H = inertia.momenta(rotation, velocity, inertia.space.to_section(rotation, spin))
        moment = inertia.rotary.present_or(H, lambda: frame.spin_rate(still(H), lambda: H))
        return lever.wrench(frame.rate(still(momentum), lambda: momentum), moment)

    def _spin(self, position: Tensor, rotation: Tensor) -> Tensor:
        """Section axes."""
        space = self.inertia.space
        return space.to_section(
            rotation, self.frame.spin(torch.zeros_like(position[..., : space.dims.spin]))
        )

    def tangent(self, position: Tensor, rotation: Tensor) -> Matrix:
        inertia, space, turning = self.inertia, self.inertia.space, self.frame.spin_skew
        lever, rotary = inertia.offset.turned(rotation), self.inertia.rotary

        def angular() -> Tensor:
            R = space.spin_matrix(rotation)
            H = rotary.momentum(rotation, self._spin(position, rotation))
            return turning @ rotary.momentum_by(
                R, R.mT @ turning, H, torch.eye(space.dims.spin, dtype=R.dtype, device=R.device)
            )

        masses = inertia.masses(self.frame.skew @ self.frame.skew)
        moved = lever.tangent(masses, lambda: lever.A, lambda: self._wrench(position, rotation))
        return rotary.matrix(moved, angular)

    def gyroscopic(self, position: Tensor, rotation: Tensor) -> Matrix:
        inertia, space, turning = self.inertia, self.inertia.space, self.frame.spin_skew
        lever, rotary = inertia.offset.turned(rotation), self.inertia.rotary

        def angular() -> Tensor:
            J = rotary.in_frame(rotation)
            H = rotary.momentum(rotation, self._spin(position, rotation))
            return J @ turning + turning @ J - space.spin_skew(H)

        return rotary.matrix(
            lever.matrix(inertia.masses(2 * self.frame.skew), lambda: lever.A), angular
        )
