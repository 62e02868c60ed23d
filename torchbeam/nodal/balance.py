"""What statics and the implicit step share: a balance of nodal forces with the stress as an unknown
of its own.

Unknowns are a move of the free nodes (dr, spin) and the stress [F; M] of each element. With B the
strain operator,

    g       = inertia + to_nodes(h B^T [F; M]) - external = 0
    (..., N+1, w), at a support the reaction
    g_eps   = strain - S [F; M]                        = 0        (..., N, k)

Linearised, with E the derivative of the strain in g_eps and C = S^-1 (regularised where S is
singular; the residual keeps S exactly), the stress is condensed element by element (Magisano,
Leonetti and Garcea 2017: Newton on this mixed form needs few iterations whatever the stiffness):

    (K_rest + h B^T C E) move = -(g + h B^T C g_eps)        d[F; M] = C (g_eps + E move)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.shapes import broadcast_shapes
from ..topology.protocols import Matrix, MatrixRows, System, total
from .assembly import Assembly
from .constitutive_law import times
from .constraints import Constraints
from .multipliers import Multipliers
from .rows import Rows


class Residual(NamedTuple):
    """nodes (..., N+1, w), strain (..., N, k) as above, with the gaps of constraints behind; force,
    moment, size_strain (...): the largest terms in them, of strain as of `strains` with the length
    span (...) m; rounding (..., N+1, w) and strain_rounding (..., N), 0.0 = nothing: what floating
    point may leave of them.
    """

    constraints: Constraints
    nodes: Tensor
    strain: Tensor
    force: Tensor
    moment: Tensor
    size_strain: Tensor
    span: Tensor
    multipliers: Multipliers
    rounding: Tensor | float
    strain_rounding: Tensor | float

    def measure(self) -> Tensor:
        """(...) the scaled residual: what is left of each equation beyond rounding, over the
        largest term in it; not finite where anything is not.
        """
        forces, moments = self._left()
        constitutive_residual, gap = self.multipliers.split(self.strain.detach())
        size = scaled(
            forces.amax((-1, -2)),
            moments.amax((-1, -2)),
            strains(*most_strains(constitutive_residual, self.strain_rounding), self.span),
            *self[3:6],
        )
        return self.multipliers.measure(size, gap)

    def square(self, length: Tensor) -> Tensor:
        """(...) N^2 m^2: the sum of squares of what is left of the nodes' balances beyond rounding,
        of forces at a lever (...) m.
        """
        forces, moments = (x.square().sum((-1, -2)) for x in self._left())
        return length.square() * forces + moments

    def _left(self) -> tuple[Tensor, Tensor]:
        """(..., n, *) what is left of forces and moments of free nodes, beyond rounding."""
        left = self.nodes.detach().abs() - self.rounding
        free = self.constraints.unknowns.select(left).clamp(min=0)
        p = (free.shape[-1] + 1) // 2  # of 6: 3, of 3: 2
        return free[..., :p], free[..., p:]


def scaled(
    force: Tensor,
    moment: Tensor,
    constitutive_residual: Tensor,
    largest_force: Tensor,
    largest_moment: Tensor,
    size_strain: Tensor,
) -> Tensor:
    """(...) the largest that is left of forces, moments and strains, each over the largest term in
    its equation.
    """
    number = torch.finfo(force.dtype)
    # loads so small that motions under them are denormal, where products round as they like, count
    # as none
    none = number.tiny**0.5
    over = torch.maximum(force / (largest_force + none), moment / (largest_moment + none))
    return torch.maximum(over, constitutive_residual / (size_strain + number.eps))


class CondensedTangent(NamedTuple):
    """Derivative of a balance whose stress is condensed, whatever supports hold. matrix: of the
    nodes; force_operator and strain_by_move (..., N, k, p + 2 s): h B, the strain operator by the
    length, and E, the derivative of the constitutive residual by the moves; stiffness
    (..., N or 1, k, k or 1): C, the inverse of the compliance.
    """

    matrix: Matrix
    force_operator: Tensor
    stiffness: Tensor
    strain_by_move: Tensor

    @classmethod
    def of(
        cls,
        assembly: Assembly,
        rest: Tensor,
        nodes: Matrix | None,
        force_operator: Tensor,
        stiffness: Tensor,
        strain_by_move: Tensor,
    ) -> CondensedTangent:
        """rest (..., N, p + 2 s, p + 2 s) of elements at fixed stress; nodes: what these, and the
        mass they share, add.
        """
        return cls(
            total(
                assembly.to_matrix(rest + force_operator.mT @ times(stiffness, strain_by_move)),
                nodes,
            ),
            force_operator,
            stiffness,
            strain_by_move,
        )


class Linearisation(NamedTuple):
    """The condensed tangent; constants of one Newton step or of the implicit function theorem."""

    assembly: Assembly
    constraints: Constraints
    system: System  # of the unknowns
    rows: MatrixRows  # of the supports' balances
    force_operator: Tensor  # (..., N, k, p + 2 s) h B
    stiffness: Tensor
    strain_by_move: Tensor  # (..., N, k, p + 2 s)
    law: Tensor  # S^-1 as the law has it, which C may differ from
    multipliers: Multipliers

    @classmethod
    def of(cls, model: Rows, tangent: CondensedTangent) -> Linearisation:
        """With the supports of a model."""
        matrix, constraints = tangent.matrix, model.constraints
        return cls(
            model.assembly,
            constraints,
            matrix.restricted(constraints.unknowns),
            matrix.rows(constraints.nodes),
            *tangent[1:],
            model.law.C,
            model.multipliers,
        )

    def solve(self, g: Tensor, g_strain: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What a residual asks for: move (..., N+1, w), zero where the beam is held, d[F; M]
        (..., N, k); and the supports' balances after it, the reactions (..., K, w).
        """
        g_strain, gap = self.multipliers.split(g_strain)
        pushed = g + self.assembly.to_nodes(
            pushed_by(self.force_operator, self.stiffness, g_strain)
        )
        solution = self.system.solve(self.multipliers.asked(-pushed, gap))
        move, change = self.multipliers.answered(
            solution,
            lambda move: dstress(
                self.stiffness, self.strain_by_move, g_strain, self.assembly.to_elements(move)
            ),
        )
        return move, change, self.constraints.reaction(self.rows, pushed, solution)

    @property
    def exact(self) -> Tensor:
        """(...) bool: whether C is the law's, and no impossible strain was given more flexibility
        than the law gives it.
        """
        return same_law(self.stiffness, self.law)

    def detach(self) -> Linearisation:
        return Linearisation(
            self.assembly, self.constraints, *(x.detach() for x in self[2:-1]), self.multipliers
        )


def same_law(C: Tensor, law: Tensor) -> Tensor:
    """(...) bool: whether C of a tangent is the law's in all elements (..., N or 1, k, k or 1)."""
    return (C == law.detach()).flatten(-3).all(-1)


def pushed_by(force_operator: Tensor, stiffness: Tensor, g_strain: Tensor) -> Tensor:
    """h B^T C g_eps (..., N, p + 2 s): what an element's constitutive residual asks of nodes."""
    return (force_operator.mT @ times(stiffness, g_strain[..., None]))[..., 0]


def dstress(stiffness: Tensor, strain_by_move: Tensor, g_strain: Tensor, move: Tensor) -> Tensor:
    """d[F; M] = C (g_eps + E move), (..., N, k), of elements after a move (..., N, p + 2 s)."""
    return times(stiffness, g_strain[..., None] + strain_by_move @ move[..., None])[..., 0]


def restrained_forces(
    model: Rows, kinematics: Any, eigenstrain: Tensor | float, h: Tensor
) -> Tensor | float:
    """Element forces that the beam's eigenstrain would take to hold back: what it is measured
    against where nothing else acts; 0.0 where there is none.
    """
    if isinstance(eigenstrain, float):
        return eigenstrain
    stress = model.law.stress(eigenstrain)
    return model.space.forces(
        kinematics, stress.expand(*broadcast_shapes(stress.shape, (model.station_count, 1))), h
    )


def size_of_strain(followed: Tensor, eigenstrain: Tensor | float, span: Tensor) -> Tensor:
    """(...) the largest term in the strain law, see `strains`."""
    size = strains(*most_strains(followed.detach()), span)
    if isinstance(eigenstrain, float):
        return size
    return torch.maximum(size, strains(*most_strains(eigenstrain.detach()), span))


def most_strains(x: Tensor, rounding: Tensor | float = 0.0) -> tuple[Tensor, Tensor]:
    """(...) and (...) 1/m: by how much the largest strain and curvature of rows (..., n, k) are
    above their `rounding` (..., n).
    """
    p = (x.shape[-1] + 1) // 2  # of 6: 3, of 3: 2
    return most_beyond(x[..., :p], rounding), most_beyond(x[..., p:], rounding)


def strains(strain: Tensor, curvature: Tensor, span: Tensor) -> Tensor:
    """(...) the larger of a strain and of a curvature 1/m over a beam's length m."""
    return torch.maximum(strain, span * curvature)


def most(x: Tensor) -> Tensor:
    """(...) the largest of the rows (..., n, k), 0 where there are none."""
    return x.abs().amax((-1, -2)) if x.shape[-2] else x.new_zeros(x.shape[:-2])


def most_beyond(x: Tensor, rounding: Tensor | float) -> Tensor:
    """(...) by how much the largest of the rows (..., n, k) is above their `rounding` (..., n)."""
    if not x.shape[-2]:
        return x.new_zeros(x.shape[:-2])
    return (x.abs().amax(-1) - rounding).amax(-1).clamp(min=0)


def largest(p: int, length: Tensor, *terms: Tensor | float) -> tuple[Tensor, Tensor]:
    """Largest force and moment (...) in the terms of a balance, of elements or of nodes, of which p
    are forces: what its residual is measured against. A force is also a moment, over an element's
    length; a moment is also a force, over the beam's.
    """
    sizes = []
    for term in terms:
        if isinstance(term, Tensor):
            term = term.detach()
            sizes.append((most(term[..., :p]), most(term[..., p:])))
    force, moment = (
        torch.stack(torch.broadcast_tensors(*part)).amax(0) for part in zip(*sizes, strict=True)
    )
    length = length.detach()
    return mixed(force, moment, length.sum((-1, -2)), length.amax((-1, -2)))


def mixed(force: Tensor, moment: Tensor, total: Tensor, longest: Tensor) -> tuple[Tensor, Tensor]:
    """What `largest` makes of the largest force and the largest moment, for a beam's length and its
    longest element.
    """
    return torch.maximum(force, moment / total), moment + force * longest
