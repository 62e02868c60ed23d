"""Rows: constants of nodes and of the elements between them, which are all that the physics reads of a beam: of all nodes and
elements of a model, or of one node or one element of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..topology.protocols import Topology
from .assembly import Assembly
from .constitutive_law import ElasticLaw
from .constraints import Constraints
from .coordinates.spatial import Space
from .inertia import Inertia
from .joint_motion import NoJoints


@dataclass(frozen=True)
class Rows(Tree):
    """Constants of the nodal form; leading axes are batch axes; w, k: a node's unknowns and an element's strains in `space`.

    length     (..., N, 1) m; None = there are no elements, as with reference and law
    reference  (..., N, k) strain of the undeformed beam
    law        the constitutive law
    section_mass  (..., N+1, 6, 6) mean mass per length about each node, with what is fixed to it: for line loads
    tributary_length  (..., N+1, 1) m of beam that belong to each node, 1 of a body
    s          (..., N+1) m, arclength of the nodes
    joints     between nodes
    """

    space: Space
    topology: Topology
    constraints: Constraints
    inertia: Inertia
    length: Tensor | None = leaf(2)
    reference: Tensor | None = leaf(2)
    law: ElasticLaw | None
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)
    s: Tensor = leaf(1)
    joints: NoJoints = field(default_factory=NoJoints, kw_only=True)

    @property
    def node_count(self) -> int:
        return self.topology.node_count

    @property
    def station_count(self) -> int:
        """Of stress: of elements of order 1 one each, of order 2 two."""
        return 0 if self.length is None else self.length.shape[-2]

    @property
    def spans(self) -> Tensor:
        """(..., N, 1) m, what forces and moments are measured against: lengths of the elements; of none, (..., 1, 1) the size
        of what joints connect.
        """
        return self.length if self.station_count else self.joints.spans(self.length)

    @cached
    def assembly(self) -> Assembly:
        """From nodes to elements and back."""
        return Assembly(self.topology, self.space.interpolation, self.space.position)

    def depends_on(self, load: Any) -> frozenset[str]:
        """What a load's wrench depends on."""
        return load.depends_on(self.inertia.offset.present)

    def kinematics(self, position: Tensor, rotation: Tensor) -> Any:
        """Of all elements, from nodes in the space's coordinates: see `element.Kinematics`."""
        return self.space.kinematics(*self.assembly.poses(position, rotation), self.length)

    def strain(self, kin: Any) -> Tensor:
        """(..., N, k), less that of the undeformed beam."""
        return self.space.strains(kin, self.length, self.reference)

    def kinetic_energy(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(...) J"""
        return self.inertia.kinetic_energy(rotation, velocity, spin)

    def strain_energy(self, position: Tensor, rotation: Tensor, eigenstrain: Tensor | float = 0.0) -> Tensor:
        """(...) J; an impossible strain stores none, whatever a start or rounding has left of it."""
        e = self.strain(self.kinematics(position, rotation)) - eigenstrain
        return (self.length * self.law.energy(e)).sum((-1, -2))
