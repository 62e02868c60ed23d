"""Mass of the nodes. Translational, it is lumped, or shared by the nodes of an element.

    p = m v - sum over elements of c b (b^T v),
    b = (-1, 1) of an element of two nodes, (1, -2, 1) of one of three

With c = m/12 of the element's mass m, two nodes have half of the consistent mass and half of the
lumped one; the translational error of the implicit form is then fourth order. A mass m at three
nodes as 1/6, 2/3, 1/6 (Simpson's rule) becomes the consistent one with c = m/30. The frequencies of
bending are too high by either, by twice as much with the consistent one, so that c = -m/30 takes
the error's fourth order out (measured: tests/unit/nodal/test_quadratic.py); axial and torsional
ones stay fourth order. An element that neither stretches, bends nor shears has the consistent mass,
c = m/6 of two nodes: that of a bar, which no mesh changes.

Rotary inertia about their centres of mass has the angular momentum R J Omega; what it alone asks
for is given as a function.

How much of the beam's length, or mass, belongs to each node is a quadrature by values at the nodes.
The trapezoidal rule gives each node half of its elements. With rho a density along the beam,
constant in each element, its error is that of the slopes at the ends of the elements
(Euler and Maclaurin):

    integral of rho f = sum over elements of rho (h/2 (f_i + f_j) - h^2/12 (f'_j - f'_i)) + O(h^4)

Gregory's rule takes these slopes from the parabola through a node and its neighbours (at an end
through the last three nodes). Equal elements have the weights 3/8, 7/6, 23/24, 1, ..., times h;
three nodes those of Simpson's rule.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf
from ..topology.protocols import Matrix, Topology
from .coordinates.spatial import Spatial


@dataclass(frozen=True)
class LumpedMass(Tree):
    """mass (..., nodes, 1) kg."""

    topology: Topology
    mass: Tensor = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        """M v (..., nodes, p) kg m/s."""
        return self.mass * velocity

    def matrix(self, Z: Tensor) -> Matrix:
        """M Z, p by p; Z (..., nodes or 1, p, p) is the derivative of a force per mass by a
        displacement.
        """
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
        of_elements = Z
        if Z.ndim > 2 and Z.shape[-3] > 1:  # alike within an element
            of_elements = self.topology.gather(Z, 2)[0]
        bent = self.coupling[..., None] * of_elements
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


LEAST = 0.5  # of a trapezoidal weight


def trapezoidal(length: Tensor, density: Tensor | float = 1.0) -> Tensor:
    """Weights (..., N+1) of elements of length (..., N) m and density (..., N or 1) per metre."""
    half = density * length / 2
    return pad(half, (0, 1)) + pad(half, (1, 0))


def gregory(
    length: Tensor, density: Tensor | float = 1.0, smooth: Tensor | float | None = None
) -> Tensor:
    """The same by Gregory's rule: linear functions exactly, as by the trapezoidal one, which stays
    where there is one element, and where `too_uneven`; smooth: the density with 0 in elements that
    are to stay trapezoidal.
    """
    plain = trapezoidal(length, density)
    if length.shape[-1] == 1:
        return plain
    weights = _corrected(length, density if smooth is None else smooth, plain)
    return torch.where(_positive(weights, plain), weights, plain)


def too_uneven(length: Tensor, density: Tensor | float = 1.0) -> Tensor:
    """(..., 1) bool: whether lengths or densities jump by so much that one of Gregory's weights
    would fall below half of the trapezoidal one: from twice the length at an end, or back and
    forth, on, and from about 2.5 times at one place between.
    """
    plain = trapezoidal(length, density)
    return ~_positive(plain if length.shape[-1] == 1 else _corrected(length, density, plain), plain)


def _positive(weights: Tensor, plain: Tensor) -> Tensor:
    return (weights >= LEAST * plain).all(-1, keepdim=True)


def _corrected(length: Tensor, density: Tensor | float, plain: Tensor) -> Tensor:
    slope = density * length**2 / 12
    return corrected(length, pad(slope, (0, 1)) - pad(slope, (1, 0)), plain)


def corrected(length: Tensor, slope: Tensor, plain: Tensor) -> Tensor:
    """Weights (..., N+1), from what the values of nodes count for, and what their slopes do: of
    parabolas through three nodes.
    """
    N = length.shape[-1]
    # three nodes at -a, 0, b: slopes are wanted at 0, and at the ends of the beam
    a, b = length[..., :-1], length[..., 1:]
    first, last = pad(slope[..., :1], (0, N - 2)), pad(slope[..., -1:], (N - 2, 0))
    S, X = slope[..., 1:-1] + first + last, 2 * (b * last - a * first)
    before, here = (X - b * S) / (a * (a + b)), ((b - a) * S - X) / (a * b)
    after = (X + a * S) / (b * (a + b))
    return plain + pad(before, (0, 2)) + pad(here, (1, 1)) + pad(after, (2, 0))
