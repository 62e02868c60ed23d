"""Rows: constants of nodes and of the elements between them, which are all that the physics reads
of a beam: of all nodes and elements of a model, or of one node or one element of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..topology.framework import Framework
from ..topology.protocols import Topology
from .assembly import Assembly
from .between_nodes import BetweenNodes, NodeMotion
from .constitutive_law import ElasticLaw
from .constraints import Constraints
from .coordinates.linearised import LinearElement
from .coordinates.spatial import Spatial
from .inertia import Inertia
from .mass import LumpedMass, NoRotaryInertia, RotaryInertia, SharedMass
from .mass_offset import MassOffset, NoMassOffset
from .multipliers import Multipliers


@dataclass(frozen=True)
class NodeRows(Tree):
    """Of nodes, one by one: mass, J, offset: see `LumpedMass`, `RotaryInertia`, `MassOffset`,
    None = absent; slide, turn: see `Constraints`; section_mass, tributary_length, s: see `Rows`;
    frames, R: see `Linearised`, None in other coordinates.
    """

    mass: Tensor = leaf(2)
    J: Tensor | None = leaf(3)
    offset: Tensor | None = leaf(2)
    slide: Tensor = leaf(2)
    turn: Tensor = leaf(2)
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)
    s: Tensor = leaf(1)
    frames: Tensor | None = leaf(2)
    R: Tensor | None = leaf(3)


@dataclass(frozen=True)
class ElementRows(Tree):
    """Of elements, one by one: length, reference, law: see `Rows`; coupling: see `SharedMass`,
    None = absent; linear: None but for small rotations.
    """

    length: Tensor = leaf(2)
    reference: Tensor = leaf(2)
    law: ElasticLaw
    coupling: Tensor | None = leaf(2)
    linear: LinearElement | None


class Held(NamedTuple):
    """What supports hold: of each its node and what is fixed (w) of it; hinges' nodes and axes."""

    nodes: tuple[int, ...]
    fixed: tuple[Tensor, ...]
    hinges: tuple[tuple[int, Tensor], ...]


@dataclass(frozen=True)
class Rows(Tree):
    """Constants of the nodal form; leading axes are batch axes; w, k: a node's unknowns and an
    element's strains in `space`.

    length     (..., N, 1) m; None = there are no elements, as with reference and law
    reference  (..., N, k) strain of the undeformed beam
    law        the constitutive law
    section_mass  (..., N+1, 6, 6) mean mass per length about each node, with what is fixed to it:
                  for line loads
    tributary_length  (..., N+1, 1) m of beam that belong to each node, 1 of a body
    s          (..., N+1) m, arclength of the nodes
    joints, tendons, touching, couplings   what acts between nodes
    """

    space: Spatial
    topology: Topology
    constraints: Constraints
    inertia: Inertia
    length: Tensor | None = leaf(2)
    reference: Tensor | None = leaf(2)
    law: ElasticLaw | None
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)
    s: Tensor = leaf(1)
    joints: BetweenNodes = field(default_factory=BetweenNodes, kw_only=True)
    tendons: BetweenNodes = field(default_factory=BetweenNodes, kw_only=True)
    touching: BetweenNodes = field(default_factory=BetweenNodes, kw_only=True)
    couplings: BetweenNodes = field(default_factory=BetweenNodes, kw_only=True)

    @classmethod
    def of(
        cls,
        space: Spatial,
        nodes: NodeRows,
        elements: ElementRows | None,
        held: Held,
        difference: tuple[float, ...] | None = None,
        topology: Topology | None = None,
    ) -> Rows:
        """Of one node alone (elements None), or of one element and its nodes, or of other nodes
        with a topology; space: as it is elsewhere, but for what rows say of it; difference: see
        `SharedMass`.
        """
        length, reference, law, coupling, linear = (
            (None,) * 5 if elements is None else vars(elements).values()
        )
        if not space.turns:
            space = replace(space, frames=nodes.frames, R=nodes.R, linear_element=linear)
        if topology is None:
            topology = Framework(space.order, (0 if elements is None else 1,))
        free = torch.ones(topology.node_count, space.unknowns, dtype=torch.bool)
        fixed = torch.stack(held.fixed) if held.fixed else nodes.mass.new_zeros(0, space.unknowns)
        constraints = Constraints(
            held.nodes,
            fixed,
            free,
            topology.unknowns(free, nodes.mass),
            nodes.slide,
            nodes.turn,
            held.hinges,
        )
        mass = (
            LumpedMass(topology, nodes.mass)
            if coupling is None
            else SharedMass(topology, nodes.mass, coupling, difference)
        )
        rotary = NoRotaryInertia(space) if nodes.J is None else RotaryInertia(space, nodes.J)
        inertia = Inertia(
            space,
            mass,
            rotary,
            NoMassOffset() if nodes.offset is None else MassOffset(space, nodes.offset),
        )
        return Rows(
            space,
            topology,
            constraints,
            inertia,
            length,
            reference,
            law,
            nodes.section_mass,
            nodes.tributary_length,
            nodes.s,
        )

    @property
    def nodes(self) -> NodeRows:
        """All of them."""
        inertia, held, frames, R = self.inertia, self.constraints, None, None
        if not self.space.turns:
            frames, R = self.space.frames, self.space.R
        return NodeRows(
            inertia.mass,
            getattr(inertia.rotary, "J", None),
            getattr(inertia.offset, "offset", None),
            held.slide,
            held.turn,
            self.section_mass,
            self.tributary_length,
            self.s,
            frames,
            R,
        )

    @property
    def elements(self) -> ElementRows:
        """All of them."""
        linear = None if self.space.turns else self.space.linear_element
        return ElementRows(
            self.length,
            self.reference,
            self.law,
            getattr(self.inertia.translational, "coupling", None),
            linear,
        )

    @property
    def node_count(self) -> int:
        return self.topology.node_count

    @property
    def station_count(self) -> int:
        """Of stress: of elements of order 1 one each, of order 2 two."""
        return 0 if self.length is None else self.length.shape[-2]

    @property
    def spans(self) -> Tensor:
        """(..., N, 1) m, what forces and moments are measured against: lengths of the elements; of
        none, (..., 1, 1) the size of what joints connect.
        """
        return self.length if self.station_count else self.multipliers.span(self.length)

    @cached
    def interactions(self) -> tuple[BetweenNodes, ...]:
        """All that acts between nodes."""
        every = self.joints, self.tendons, self.touching, self.couplings
        return tuple(interaction for interaction in every if interaction.present)

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any = None, moving: Any = None
    ) -> dict[str, Any]:
        """See `BetweenNodes`, of all of these."""
        for interaction in self.interactions:
            fields = interaction.finished(fields, motion, before, moving)
        return fields

    @cached
    def multipliers(self) -> Multipliers:
        """Unknowns of these, one after the other."""
        every = [
            forces for interaction in self.interactions if (forces := interaction.multipliers).count
        ]
        if len(every) < 2:
            return every[0] if every else Multipliers()
        return Multipliers(torch.cat([rows.held for rows in every]), every[0].size)

    @cached
    def assembly(self) -> Assembly:
        """From nodes to elements and back."""
        return Assembly(self.topology, self.space.interpolation, self.space.dims.position)

    @property
    def smooth(self) -> bool:
        """Whether a step's residual falls as smooth ones do. Friction turns within a slip speed,
        and limits of joints within a hundredth of their range: what is left is measured there, not
        foreseen.
        """
        return all(interaction.smooth for interaction in self.interactions)

    def depends_on(self, load: Any) -> frozenset[str]:
        """What a load's wrench depends on."""
        return load.depends_on(self.inertia.offset.present)

    def kinematics(self, position: Tensor, rotation: Tensor) -> Any:
        """Of all elements, from nodes in the space's coordinates: see `element.Kinematics`."""
        return self.space.kinematics(*self.assembly.poses(position, rotation), self.length)

    def strain(self, kinematics: Any) -> Tensor:
        """(..., N, k), less that of the undeformed beam."""
        return self.space.strains(kinematics, self.length, self.reference)

    def kinetic_energy(self, position: Tensor, rotation: Tensor, *moving: Tensor) -> Tensor:
        """(...) J of nodes that move with velocity and spin (section axes)."""
        energy = self.inertia.kinetic_energy(rotation, *moving)
        if self.joints.inertia is not None:
            energy = energy + self.joints.kinetic_energy(position, rotation, *moving)
        return energy

    def crept_at_rest(
        self, position: Tensor, rotation: Tensor, eigenstrain: Tensor | float
    ) -> Tensor | None:
        """(..., N, m k): see `MaxwellArms`, where the strains last; None = nothing relaxes."""
        if not self.station_count or self.law.arms is None:
            return None
        strain = self.strain(self.kinematics(position, rotation)) - eigenstrain
        return self.law.arms.at_rest(strain)

    def strain_energy(
        self,
        position: Tensor,
        rotation: Tensor,
        eigenstrain: Tensor | float = 0.0,
        crept: Tensor | None = None,
    ) -> Tensor:
        """(...) J; an impossible strain stores none, whatever a start or rounding has left. crept:
        see `ElasticLaw.energy`.
        """
        e = self.strain(self.kinematics(position, rotation)) - eigenstrain
        return (self.length * self.law.energy(e, crept)).sum((-1, -2))
