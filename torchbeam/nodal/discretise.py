"""Discretisation: from a scene to the constants of the nodal form."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.arguments import boolean, instance
from ..core.leaves import own_leaves, sent
from ..core.remembered import remembered
from ..scene.beam import Beam
from ..scene.effects import PerElement, PointMass
from ..scene.scene import Scene
from ..scene.structure import unstressed
from ..topology.protocols import Topology
from .assembly import Assembly
from .constitutive_law import law_of
from .constraints import Constraints
from .coordinates.planar import PLANES
from .coordinates.selection import check_space, coordinates, in_space, only_numbers
from .coordinates.spatial import Spatial
from .inertia import Inertia, impossible_strains, inertia_of, warn_of_uneven
from .interactions import couplings_of
from .joint_constraints import joints_of
from .model import Model
from .model_check import check_plane, refuse_redundant
from .tendons import tendons_of
from .touching_parts import touching_of


def discretise(scene: Scene, lumped: bool = False, topology: Topology | None = None) -> Model:
    """The model of a scene; `lumped`: mass at the nodes alone; topology: None = the beam's own, a
    chain.

    Raises ValueError for what the nodal form does not take: sections whose mass is not that of
    rigid ones, loads and motions that leave the scene's plane or do not fit small rotations, and
    constraints that others hold already.
    """
    instance("a scene", scene, Scene)
    boolean("lumped", lumped)
    if scene.plane == "auto":
        return _in_a_plane(scene, lumped, topology)
    beam = scene.beam
    topology = scene.topology if topology is None else topology
    check_space(scene)
    warn_of_uneven(beam)
    reference_rows = remembered(
        _reference_rows,
        unstressed(beam),
        impossible_strains(beam),
        scene.bodies,
        scene.plane,
        scene.small,
        topology,
        lumped,
    )
    space = reference_rows.space
    if space.plane is not None and beam.coupled:
        space.check_section("compliance", beam.compliance.detach())
    if beam.linked_interpolation and any(
        isinstance(x.value, PerElement) for load in scene.loads for x in own_leaves(load)
    ):
        raise ValueError(
            "a load PerElement was given for a beam with linked interpolation; one Along the "
            "beam is wanted"
        )
    model = Model(
        scene=scene,
        space=space,
        topology=topology,
        constraints=Constraints.of(scene, space, topology),
        inertia=reference_rows.inertia,
        length=beam.length[..., None],
        reference=reference_rows.reference,
        law=law_of(scene, space),
        section_mass=reference_rows.section_mass,
        tributary_length=reference_rows.tributary_length,
        s=reference_rows.s,
        joints=joints_of(scene, space, topology),
        tendons=tendons_of(scene, space, topology),
        touching=touching_of(scene, space, reference_rows.s),
        couplings=couplings_of(scene, space),
    )
    if space.plane is not None:
        check_plane(model)
    refuse_redundant(model)
    return model


class ReferenceRows(NamedTuple):
    """What a beam's rows are by its shape, its mass and where it is rigid, whatever else it resists
    and whatever acts on it; see `Rows`.
    """

    space: Spatial
    inertia: Inertia
    section_mass: Tensor
    tributary_length: Tensor
    reference: Tensor
    s: Tensor


def _reference_rows(
    beam: Beam,
    impossible: Tensor | None,
    bodies: tuple[PointMass, ...],
    plane: str | None,
    small: bool,
    topology: Topology,
    lumped: bool,
) -> ReferenceRows:
    space = coordinates(beam, topology, plane, small)
    assembly = Assembly(topology, space.interpolation, space.dims.position)
    shape = beam.nodes, beam.frames, beam.length
    return ReferenceRows(
        space,
        *inertia_of(beam, impossible, bodies, space, assembly, lumped),
        remembered(_reference, space, assembly, in_space(beam), *shape),
        topology.arclength(beam.length),
    )


def _reference(
    space: Spatial,
    assembly: Assembly,
    whole: Spatial,
    nodes: Tensor,
    frames: Tensor,
    length: Tensor,
) -> Tensor:
    """Strain (..., N, k) of the undeformed beam, found in 3D."""
    h = length[..., None]
    rest = whole.strains(whole.kinematics(*assembly.poses(nodes, frames), h), h)
    return space.project_strain(rest) if space.turns else torch.zeros_like(rest)


def in_double(model: Model) -> Model:
    """The model in float64, with the law's inverse as float64 has it; differentiable."""
    wide = sent(model, torch.float64)
    return replace(wide, law=law_of(wide.scene, wide.space))


def _in_a_plane(scene: Scene, lumped: bool, topology: Topology | None) -> Model:
    """In the first plane that everything fits, where nothing but numbers acts; else in 3D."""
    for name in PLANES if only_numbers(scene) else ():
        with suppress(ValueError):
            return discretise(replace(scene, plane=name), lumped, topology)
    return discretise(replace(scene, plane=None), lumped, topology)
