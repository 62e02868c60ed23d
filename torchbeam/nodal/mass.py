"""Translational mass of the nodes: lumped, or shared by the nodes of an element.

    p = m v - sum over elements of c b (b^T v),
    b = (-1, 1) of an element of two nodes, (1, -2, 1) of one of three

With c = m/12 of the element's mass m, two nodes have half of the consistent mass and half of the
lumped one; the translational error of the implicit form is then fourth order. A mass m at three
nodes as 1/6, 2/3, 1/6 (Simpson's rule) becomes the consistent one with c = m/30. The frequencies of
bending are too high by either, by twice as much with the consistent one, so that c = -m/30 takes
the error's fourth order out (measured: tests/unit/nodal/test_quadratic.py); axial and torsional
ones stay fourth order. An element that neither stretches, bends nor shears has the consistent mass,
c = m/6 of two nodes: that of a bar, which no mesh changes.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..core.leaves import Tree, leaf
from ..topology.protocols import Matrix, Topology


@dataclass(frozen=True)
class LumpedMass(Tree):
    """mass (..., nodes, 1) kg."""

    topology: Topology
    mass: Tensor = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        """M v (..., nodes, p) kg m/s."""
        return self.mass * velocity

    def matrix(self, Z: Tensor) -> Matrix:
        """M Z, p by p; Z (..., p, p) is the derivative of a force per mass by a displacement."""
        return self.topology.diagonal(self.mass[..., None] * Z)


@dataclass(frozen=True)
class SharedMass(LumpedMass):
    """coupling (..., elements, 1) kg: c of each element; difference: b."""

    coupling: Tensor = leaf(2)
    difference: tuple[float, ...]

    def momentum(self, velocity: Tensor) -> Tensor:
        bent = self.coupling * self.differences(self.topology.gather(velocity))
        return self.mass * velocity - self.topology.scatter(
            tuple(_times(b, bent) for b in self.difference)
        )

    def differences(self, parts: tuple[Tensor, ...]) -> Tensor:
        """b^T v (..., elements, *), what adds first: -v by itself would be an operation more."""
        pairs = sorted(zip(self.difference, parts, strict=True), key=lambda pair: pair[0] < 0)
        total = _times(*pairs[0])
        for b, v in pairs[1:]:
            total = total + _times(b, v) if b > 0 else total - _times(-b, v)
        return total

    def matrix(self, Z: Tensor) -> Matrix:
        bent = self.coupling[..., None] * Z
        products = {
            product: _times(-product, bent)
            for product in {a * b for a in self.difference for b in self.difference}
        }
        shared = self.topology.matrix(
            tuple(tuple(products[a * b] for b in self.difference) for a in self.difference)
        )
        return shared.plus(self.mass[..., None] * Z)


def _times(factor: float, x: Tensor) -> Tensor:
    return x if factor == 1 else -x if factor == -1 else factor * x
