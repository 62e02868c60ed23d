"""Model: what the nodal form needs of a scene, computed once and differentiable in everything the
scene holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached
from ..core.remembered import remembered
from ..math import quaternions as quat
from ..scene.effects import INERTIAL, SPIN, VELOCITY, Contact, Inputs
from ..scene.prescribed_motion import PrescribedMotion, orientation, turning
from ..scene.scene import Scene
from ..topology.framework import Framework
from ..topology.framework_unknowns import FrameworkUnknowns
from .acting import ActingLoad, acting, by_part
from .assembly import Assembly
from .coordinates.elements import ELEMENTS
from .frame import FixedFrame, frame_of
from .line_loads import line_rule
from .rigid_moves import Base, free_pieces
from .rows import Rows

# beside trees: what a model that was saved holds, for torch.load(weights_only=True)
torch.serialization.add_safe_globals(
    [
        Assembly,
        Framework,
        FrameworkUnknowns,
        *(type(element.interpolation) for element in ELEMENTS.values()),
    ]
)


@dataclass(frozen=True)
class Model(Rows):
    """Rows of all of a scene, and what acts and is prescribed in it."""

    scene: Scene

    @property
    def turning(self) -> bool:
        """Whether frame a turns."""
        return turning(self.scene)

    @cached
    def acts(self) -> tuple[ActingLoad, ...]:
        """All loads of the scene; of a structure in the pieces that act along its parts."""
        scene = self.scene
        acts = acting(self, scene.loads, scene.internal_states)
        acts += acting(self, scene.interactions, (0,) * len(scene.interactions))
        if self.scene.beam.parts:
            acts = tuple(part for act in acts for part in by_part(self.scene.beam, act))
        return tuple(
            act._replace(rule=line_rule(self, act.node)) if act.load.integrated else act
            for act in acts
        )

    @cached
    def reference_axes(self) -> Tensor:
        """(..., N+1, 3, 3): section axes of the nodes of the undeformed beam, frame a."""
        return remembered(quat.matrix, self.scene.beam.frames)

    @property
    def conservative(self) -> bool:
        """Whether at rest the work of all loads is independent of the path, as they declare, and
        frame a does not turn: tangents are symmetric.
        """
        acts = (*self.scene.loads, *self.scene.interactions)
        return self.conserves and all(map(self.declared, acts))

    @property
    def conserves(self) -> bool:
        """The same of all but the loads."""
        has_friction = self.tendons.dissipative or any(pair.rubs for pair in self.scene.pairs)
        return not (has_friction or self.turning)

    def declared(self, load: Any) -> bool:
        """Whether a load declares that it is conservative. What one that reads velocities says is
        of those that are none.
        """
        moved = self.scene.frame is not None or self.scene.has_prescribed_motion
        return load.conservative and not (moved and self.depends_on(load) & {VELOCITY, SPIN})

    @property
    def extent(self) -> Tensor:
        """(...) m, a constant."""
        if self.station_count:
            return self.length.detach().sum((-1, -2))
        return self.scene.beam.extent.detach()

    @property
    def unit(self) -> Tensor:
        """(..., w) of a node's moves: 1 m, and the turn that moves the beam's far end by 1 m."""
        L, dims = self.extent[..., None], self.space.dims
        moves, sizes = (torch.ones_like(L), 1 / L), (dims.position, dims.spin)
        return torch.cat(
            [v.expand(*v.shape[:-1], n) for v, n in zip(moves, sizes, strict=True)], -1
        )

    @property
    def bodies_touch(self) -> bool:
        """Whether bodies, single nodes, touch obstacles."""
        loads = self.scene.loads
        return any(isinstance(load, Contact) and load.node is not None for load in loads)

    @property
    def touches(self) -> bool:
        """Whether there are contacts."""
        return any(effect.touches for effect in (*self.scene.loads, *self.scene.pairs))

    @property
    def has_friction(self) -> bool:
        """Whether there is friction of contacts."""
        return any(effect.rubs for effect in (*self.scene.loads, *self.scene.pairs))

    @property
    def patient(self) -> bool:
        """Whether steps of Newton's method may raise the merit for a while: with friction of beams
        on obstacles, which come back from deep inside by themselves. What is held by several parts
        that move does not: a hand that closes on a ball has no solution found so.
        """
        return self.has_friction and not (self.touching.present or self.bodies_touch)

    @property
    def internal_states(self) -> int:
        """How many numbers the loads remember."""
        return sum(self.scene.internal_states)

    @property
    def lag_count(self) -> int:
        """How many numbers loads and, where their stress relaxes, elements remember."""
        arms = self.scene.arms
        return self.internal_states + self.station_count * self.space.dims.strain * arms

    @cached
    def prescribed_motion(self) -> PrescribedMotion:
        return PrescribedMotion(self.scene)

    def frame(self, t: Tensor) -> FixedFrame:
        """Frame a at time t."""
        return frame_of(self.space, *self.prescribed_motion.frame(t))

    def orientation(self, t: Tensor) -> Tensor | None:
        """Frame a -> inertial axes at time t, in the space's coordinates; None = no turn."""
        frame = orientation(self.scene, t.shape, t)
        return None if frame is None else self.space.reduced_frame(frame)

    @cached
    def free_pieces(self) -> list[list[Base]]:
        """See `rigid_moves.free_pieces`."""
        return free_pieces(self)

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
        return tuple(x for x in loads if self.depends_on(x)), tuple(
            x for x in loads if not self.depends_on(x)
        )

    def eigenstrain(self, t: Tensor, inputs: Inputs) -> Tensor | float:
        """Strain (..., N or 1, k) that the beam takes by itself; 0.0 where there is none."""
        total, beam = 0.0, self.scene.beam
        for effect in self.scene.eigenstrains:
            for span in beam.spans(effect) or (None,):
                elements = beam.element_count if span is None else span.element_count
                strain = beam.at_stations(
                    self.space.project_strain(effect.eigenstrain(t, inputs, self.length, elements)),
                    1,
                )
                if span is not None:
                    strain = strain.expand(
                        *strain.shape[:-2],
                        span.stations.stop - span.stations.start,
                        strain.shape[-1],
                    )
                    strain = pad(
                        strain, (0, 0, span.stations.start, beam.station_count - span.stations.stop)
                    )
                total = total + strain
        return total

    def tangent_stiffness(self, dt: Tensor | None = None) -> Tensor:
        """S^-1 for the tangent of a balance, or of a step of dt (0-dim or (...)), see
        `ElasticLaw.tangent_stiffness`.
        """
        return self.law.tangent_stiffness(
            self.length, self.inertia.mass / self.tributary_length, dt
        )
