"""Discretisation: from a scene to the constants of the nodal form."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import torch
from torch import Tensor

from ..core.arguments import boolean, instance
from ..core.leaves import constant, own_leaves, sent, with_values
from ..core.remembered import remembered
from ..core.validation import concrete
from ..scene.effects import PerElement
from ..scene.scene import Scene
from ..topology.protocols import Topology
from .assembly import Assembly
from .conditions import conditions
from .constitutive_law import law_of
from .constraints import Constraints
from .coordinates.planar import PLANES, Planar
from .coordinates.selection import in_space, only_numbers, space_of
from .coordinates.spatial import Spatial
from .element_loads import all_loads
from .inertia import inertia_of
from .joint_constraints import joints_of
from .loads import Nodes
from .model import Model
from .redundant import refuse_redundant
from .tendons import tendons_of
from .touching_parts import touching_of

ROUNDING = 1e-9  # of a vector, that may lie out of a plane


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
    space = space_of(scene, topology)
    if beam.linked_interpolation and any(
        isinstance(x.value, PerElement) for load in scene.loads for x in own_leaves(load)
    ):
        raise ValueError(
            "a load PerElement was given for a beam with linked interpolation; one Along the "
            "beam is wanted"
        )
    h = beam.length[..., None]
    assembly = Assembly(topology, space.interpolation, space.dims.position)
    inertia, section_mass, share = inertia_of(scene, space, assembly, lumped)
    model = Model(
        scene=scene,
        space=space,
        topology=topology,
        constraints=Constraints.of(scene, space, topology),
        inertia=inertia,
        length=h,
        reference=remembered(
            _reference, space, assembly, in_space(beam), beam.nodes, beam.frames, beam.length
        ),
        law=law_of(scene, space),
        section_mass=section_mass,
        tributary_length=share,
        s=topology.arclength(beam.length),
        joints=joints_of(scene, space, topology),
        tendons=tendons_of(scene, space, topology),
        touching=touching_of(scene, space, topology.arclength(beam.length)),
    )
    if space.plane is not None:
        check_plane(model, with_values(model, space=in_space(beam)))
    refuse_redundant(model)
    return model


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
    """In the first plane that everything fits, if there is one and nothing but numbers acts; else
    in 3D.
    """
    for name in PLANES if only_numbers(scene) else ():
        with suppress(ValueError):
            return discretise(replace(scene, plane=name), lumped, topology)
    return discretise(replace(scene, plane=None), lumped, topology)


def check_plane(model: Model, whole: Model) -> None:
    """Refuse numbers that act out of the plane: loads on the beam at rest, the points that springs
    are tied to, what the beam bends by itself, masses that are not alike on both sides, motions of
    the frame and of supports. `whole`: the rows with the space of 3D. Raises ValueError.
    """
    scene, space, beam = model.scene, model.space, model.scene.beam
    still = torch.zeros_like(beam.nodes)
    t = still.new_zeros(())
    for load in scene.loads:
        if constant(load):
            wrench = all_loads(
                whole,
                Nodes(beam.nodes, beam.frames, still, still),
                conditions(whole, t, {}, loads=(load,)),
            )
            _refuse(space, load.called, wrench, space.embed(space.project(wrench)))
        if load.between_nodes and constant(load):
            pushed = load.directions(beam.nodes)
            _refuse(
                space, load.called, pushed, space.project_vector(pushed) @ space.basis[:, :2].mT
            )
        if isinstance(load.anchor, Tensor):  # slack at rest, a spring pulls nowhere
            to = load.anchor - beam.nodes[..., load.node, :]
            _refuse(
                space,
                f"a {load.called} to a point",
                to,
                space.project_vector(to) @ space.basis[:, :2].mT,
            )
    for effect in scene.eigenstrains:
        if constant(effect):
            own = effect.eigenstrain(t, {}, model.length, beam.element_count)
            _refuse(space, effect.called, own, space.embed_strain(space.project_strain(own)))
    for tendon in scene.tendons:
        points = tendon.at(beam.nodes, beam.frames) - beam.nodes[..., :1, :]
        _refuse(space, "a Tendon", points, space.project_vector(points) @ space.basis[:, :2].mT)
    for body in scene.bodies:
        if body.offset is not None:
            _refuse(
                space,
                "PointMass",
                body.offset,
                space.project_offset(body.offset) @ space.section[:, :2].mT,
            )
        if body.inertia is not None:
            J = space.section.mT @ body.inertia @ space.section
            # products of inertia with the normal
            across = J[..., 2:, :] * J.new_tensor((1.0, 1.0, 0.0))
            _refuse(space, "PointMass", J[..., 2:, :], J[..., 2:, :] - across)
    motions = (
        []
        if scene.frame is None
        else [
            ("a frame with a velocity", scene.frame.velocity, False),
            ("a frame that turns", scene.frame.angular_velocity, True),
        ]
    )
    for support in scene.supports:
        motions += [
            ("a displacement of a support", support.displacement, False),
            ("a turn of a support", support.turn, True),
        ]
    for what, x, turns in motions:
        if isinstance(x, Tensor):
            inside = (
                space.project_spin(x) @ space.basis[:, 2:].mT
                if turns
                else space.project_vector(x) @ space.basis[:, :2].mT
            )
            _refuse(space, what, x, inside)


def _refuse(space: Planar, what: str, given: Tensor, inside: Tensor) -> None:
    out = (given - inside).detach().abs()
    if concrete(out > ROUNDING * given.detach().abs().amax()).any():
        raise ValueError(
            f"{what} out of the plane {space.name!r} was given; one in it is wanted, or plane=None"
        )
