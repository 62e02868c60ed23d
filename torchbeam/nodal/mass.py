"""Translational mass of the nodes: lumped, or half consistent, which couples neighbours.

    p_i = m_i v_i + sum over its elements of c (v_neighbour - v_i)

A matrix of the chain is told as its blocks: (diagonal,) (..., N+1, w, w), or, with what neighbours share, (diagonal, upper,
lower), the latter (..., N, w, w) from a node to the next and back; with elements of three nodes five parts, see
`quadratic_assembly`.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass

from torch import Tensor

from ..core.leaves import Tree, leaf
from ..math.quadratic import threes
from .assembly import at_i, at_j, ends
from .quadratic_assembly import interleaved, spread

Blocks = tuple[Tensor, ...]
QUADRATIC_COUPLING = -1 / 30  # twice Simpson's mass less the consistent one: the error of bending is then sixth order
COUPLING = 1 / 12  # half consistent, half lumped: the translational error of the implicit form is then fourth order


@dataclass(frozen=True)
class LumpedMass(Tree):
    """mass (..., N+1, 1) kg."""

    mass: Tensor = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        """M v (..., N+1, p) kg m/s."""
        return self.mass * velocity

    def blocks(self, Z: Tensor) -> Blocks:
        """M Z, p by p; Z (..., p, p) is the derivative of a force per mass by a displacement."""
        return (self.mass[..., None] * Z,)


@dataclass(frozen=True)
class HalfConsistentMass(LumpedMass):
    """coupling (..., N, 1) kg: c of each element."""

    coupling: Tensor = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        shared = exchange(self.coupling, *ends(velocity))
        return self.mass * velocity + at_i(shared) - at_j(shared)

    def blocks(self, Z: Tensor) -> Blocks:
        between = self.coupling[..., None] * Z
        return self.mass[..., None] * Z - at_i(between, 2) - at_j(between, 2), between, between


@dataclass(frozen=True)
class QuadraticMass(LumpedMass):
    """Of elements of three nodes: coupling (..., N, 1) kg, c of each element, gives its nodes the momentum -c b (1, -2, 1),
    b = v_1 - 2 v_2 + v_3. A mass m at them as 1/6, 2/3, 1/6 (Simpson's rule) becomes the consistent one with c = m/30. The
    frequencies of bending are too high by either, by twice as much with the consistent one, so that c = -m/30 takes the error's
    fourth order out (measured: tests/unit/nodal/test_quadratic.py); axial and torsional ones stay fourth order.
    """

    coupling: Tensor = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        v_1, v_2, v_3 = threes(velocity)
        bent = self.coupling * (v_1 - 2 * v_2 + v_3)
        return self.mass * velocity - spread(bent, -2 * bent, bent)

    def blocks(self, Z: Tensor) -> Blocks:
        bent = self.coupling[..., None] * Z
        between = interleaved(2 * bent, 2 * bent, 2)
        return self.mass[..., None] * Z - spread(bent, 4 * bent, bent, 2), between, between, -bent, -bent


def exchange(coupling: Tensor, v_i: Tensor, v_j: Tensor) -> Tensor:
    """Momentum c (v_j - v_i) (..., p) that an element's half-consistent mass gives its node i, and takes from its node j."""
    return coupling * (v_j - v_i)


def add(a: Blocks, b: Blocks) -> Blocks:
    """a + b, of which either may hold fewer blocks, or none."""
    return (*map(operator.add, a, b), *a[len(b):], *b[len(a):])
