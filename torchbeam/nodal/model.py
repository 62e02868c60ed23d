"""Model: what the nodal form needs of a scene, computed once and differentiable in everything the scene holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..core.derivatives import cached
from ..core.functions_of_time import past_hooks
from ..core.leaves import Tree, leaf
from ..scene.effects import INERTIAL, Inputs
from ..scene.prescribed_motion import PrescribedMotion, orientation, turning
from ..scene.scene import Scene
from ..topology.protocols import Topology
from .assembly import Assembly
from .constitutive_law import ElasticLaw
from .constraints import Constraints
from .coordinates.spatial import Space
from .frame import FixedFrame, frame_of
from .inertia import Inertia


@dataclass(frozen=True)
class Model(Tree):
    """Constants of the nodal form; leading axes are batch axes; w, k: a node's unknowns and an element's strains in `space`.

    length     (..., N, 1) m
    reference  (..., N, k) strain of the undeformed beam
    law        the constitutive law
    section_mass  (..., N+1, 6, 6) mean mass per length about each node, with what is fixed to it: for line loads
    tributary_length  (..., N+1, 1) m of beam that belong to each node
    """

    scene: Scene
    space: Space
    topology: Topology
    constraints: Constraints
    inertia: Inertia
    length: Tensor = leaf(2)
    reference: Tensor = leaf(2)
    law: ElasticLaw
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)

    @property
    def node_count(self) -> int:
        return self.topology.node_count

    @property
    def station_count(self) -> int:
        """Of stress: of elements of order 1 one each, of order 2 two."""
        return self.length.shape[-2]

    @cached
    def assembly(self) -> Assembly:
        """From nodes to elements and back."""
        return Assembly(self.topology, self.space.interpolation, self.space.position)

    @cached
    def s(self) -> Tensor:
        """(..., N+1) m, arclength of the nodes."""
        with past_hooks():
            return self.topology.arclength(self.length[..., 0])

    @property
    def turning(self) -> bool:
        """Whether frame a turns."""
        return turning(self.scene)

    @property
    def conservative(self) -> bool:
        """Whether the work of all loads is independent of the path, and frame a does not turn: tangents are symmetric."""
        return all(load.conservative for load in self.scene.loads) and not self.turning

    @property
    def internal_states(self) -> int:
        """How many numbers the loads remember."""
        return sum(self.scene.internal_states)

    @cached
    def prescribed_motion(self) -> PrescribedMotion:
        return PrescribedMotion(self.scene)

    def frame(self, t: Tensor) -> FixedFrame:
        """Frame a at time t."""
        return frame_of(self.space, *self.prescribed_motion.frame(t))

    def orientation(self, t: Tensor) -> Tensor | None:
        """Frame a -> inertial axes at time t, in the space's coordinates; None where it does not turn."""
        frame = orientation(self.scene, t.shape, t)
        return None if frame is None else self.space.reduced_frame(frame)

    def depends_on(self, load: Any) -> frozenset[str]:
        """What a load's wrench depends on."""
        return load.depends_on(self.inertia.offset.present)

    @cached
    def adds_mass(self) -> bool:
        """Whether a load depends on an acceleration."""
        return bool(self.read.intersection(INERTIAL))

    @cached
    def read(self) -> frozenset[str]:
        """What the loads depend on."""
        return frozenset().union(*(self.depends_on(load) for load in self.scene.loads))

    @cached
    def loads(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """(loads that depend on how the nodes stand or move, dead ones)."""
        loads = self.scene.loads
        return tuple(x for x in loads if self.depends_on(x)), tuple(x for x in loads if not self.depends_on(x))

    def eigenstrain(self, t: Tensor, inputs: Inputs) -> Tensor | float:
        """Strain (..., N or 1, k) that the beam takes by itself; 0.0 where there is none."""
        total = 0.0
        for effect in self.scene.eigenstrains:
            own = self.space.project_strain(effect.eigenstrain(t, inputs, self.length, self.scene.beam.element_count))
            total = total + self.scene.beam.at_stations(own, 1)
        return total

    def tangent_stiffness(self, dt: Tensor | None = None) -> Tensor:
        """S^-1 for the tangent of a balance, or of a step of dt (0-dim or (...)), see `ElasticLaw.tangent_stiffness`."""
        return self.law.tangent_stiffness(self.length, self.inertia.mass / self.tributary_length, dt)

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

