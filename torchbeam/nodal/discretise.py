"""Discretisation: from a scene to the constants of the nodal form."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple
from weakref import ReferenceType, ref

import torch
from torch import Tensor

from ..core.arguments import boolean, instance
from ..core.leaves import sent
from ..core.remembered import few, remembered
from ..scene.beam import Beam
from ..scene.scene import Scene
from ..scene.structure import unstressed
from ..topology.protocols import Topology
from .assembly import Assembly
from .constitutive_law import law_of
from .constraints import Constraints
from .coordinates.planar import PLANES
from .coordinates.selection import check_space, coordinates, in_space, only_numbers
from .coordinates.spatial import Spatial
from .inertia import impossible_strains, inertia_of, warn_of_uneven
from .interactions import couplings_of
from .joint_constraints import joints_of
from .line_loads import warn_of_jumps
from .model import Model
from .model_check import check_plane, refuse_redundant
from .tendons import tendons_of
from .touching_parts import touching_of

LAST = " model"  # of a scene, which its copies and pickles go without


class Last(NamedTuple):
    """The last model of a scene, as long as something else holds it, whether its mass is lumped,
    and copies of the scene's tensors as they were when it was made.
    """

    model: ReferenceType[Model]
    lumped: bool
    numbers: list[Tensor]


def discretise(scene: Scene, lumped: bool = False, topology: Topology | None = None) -> Model:
    """The model of a scene, that of its last call where this has the same numbers, by whatever way
    they were written to; `lumped`: mass at the nodes alone; topology: None = the beam's own, a
    chain.

    Raises ValueError for what the nodal form does not take: sections whose mass is not that of
    rigid ones, loads and motions that leave the scene's plane or do not fit small rotations, and
    constraints that others hold already.
    """
    instance("a scene", scene, Scene)
    boolean("lumped", lumped)
    numbers = None if topology is not None else scene.numbers
    if numbers is None or torch.is_inference_mode_enabled() or not few(numbers):
        return _discretised(scene, lumped, topology)
    last = vars(scene).get(LAST)
    model = last.model() if last is not None and last.lumped == lumped else None
    if model is None or not all(map(torch.equal, last.numbers, numbers)):
        model = _discretised(scene, lumped, topology)
        copies = [x.clone() for x in numbers]
        vars(scene)[LAST] = Last(ref(model), lumped, copies)
    return model


def _discretised(scene: Scene, lumped: bool, topology: Topology | None) -> Model:
    if scene.plane == "auto":
        return _in_a_plane(scene, lumped, topology)
    beam = scene.beam
    topology = scene.topology if topology is None else topology
    check_space(scene)
    warn_of_uneven(beam)
    drawn = unstressed(beam)
    rows = remembered(_reference_rows, drawn, scene.plane, scene.small, topology)
    space = rows.space
    nodes = remembered(
        inertia_of, scene.bodies, drawn, impossible_strains(beam), space, rows.assembly, lumped
    )
    if space.plane is not None and beam.coupled:
        space.check_section("compliance", beam.compliance.detach())
    model = Model(
        scene=scene,
        space=space,
        topology=topology,
        constraints=Constraints.of(scene, space, topology),
        length=beam.length[..., None],
        reference=rows.reference,
        law=law_of(scene, space),
        s=rows.s,
        joints=joints_of(scene, space, topology),
        tendons=tendons_of(scene, space, topology),
        touching=touching_of(scene, space, rows.s),
        couplings=couplings_of(scene, space),
        **nodes._asdict(),
    )
    if space.plane is not None:
        check_plane(model)
    refuse_redundant(model)
    if any(load.integrated for load in scene.loads):
        warn_of_jumps(model)
    return model


class ReferenceRows(NamedTuple):
    """What a beam's rows are by its shape, whatever mass it has, whatever it resists and whatever
    acts on it; see `Rows`.
    """

    space: Spatial
    assembly: Assembly
    reference: Tensor
    s: Tensor


def _reference_rows(
    beam: Beam, plane: str | None, small: bool, topology: Topology
) -> ReferenceRows:
    space = coordinates(beam, topology, plane, small)
    assembly = Assembly(topology, space.interpolation, space.dims.position)
    shape = beam.nodes, beam.frames, beam.length
    reference = remembered(_reference, space, assembly, in_space(beam), *shape)
    return ReferenceRows(space, assembly, reference, topology.arclength(beam.length))


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
    rest = space.project_strain(rest)
    return rest if space.turns else torch.zeros_like(rest)


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
