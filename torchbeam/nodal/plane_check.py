"""Whether what acts on a beam, moves it or is fixed to it lies in its plane."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.leaves import constant, with_values
from ..core.validation import concrete
from ..scene.effects import RootSpring
from ..scene.effects.loads import LineLoad, PointLoad
from . import interactions
from .conditions import conditions
from .coordinates.planar import Planar
from .coordinates.selection import in_space
from .element_loads import at_nodes
from .loads import Nodes, load_points, wrench
from .model import Model

ROUNDING = 1e-9  # of a vector, that may lie out of a plane


def check_plane(model: Model) -> None:
    """Refuse numbers that act out of the plane of a model: loads on the beam at rest, the points
    that springs are tied to, what the beam bends by itself, masses that are not alike on both
    sides, motions of the frame and of supports. Raises ValueError.
    """
    scene, space, beam = model.scene, model.space, model.scene.beam
    for called, load in _of_loads(model):
        _refuse(space, called, load, space.embed(space.project(load)))
    for load in scene.loads:
        if load.between_nodes and constant(load):
            _refuse_vector(space, load.called, load.directions(beam.nodes))
        if load.offset is not None:
            _refuse_offset(space, load)
        if isinstance(load.anchor, Tensor):  # slack at rest, a spring pulls nowhere
            to = load.anchor - beam.nodes[..., load.node, :]
            if load.offset is not None:
                to = to - (model.drawn_axes[..., load.node, :, :] @ load.offset[..., None])[..., 0]
            _refuse_vector(space, f"a {load.called} to a point", to)
    for effect in scene.eigenstrains:
        if constant(effect):
            strain = effect.eigenstrain(
                beam.nodes.new_zeros(()), {}, model.length, beam.element_count
            )
            _refuse(space, effect.called, strain, space.embed_strain(space.project_strain(strain)))
    for tendon in scene.tendons:
        points = tendon.at(beam.nodes, beam.frames) - beam.nodes[..., :1, :]
        _refuse_vector(space, "a Tendon", points)
    for body in scene.bodies:
        if body.offset is not None:
            _refuse_offset(space, body)
        if body.inertia is not None:
            J = space.section.mT @ body.inertia @ space.section
            # products of inertia with the normal
            across = J[..., 2:, :] * J.new_tensor((1.0, 1.0, 0.0))
            _refuse(space, "PointMass", J[..., 2:, :], J[..., 2:, :] - across)
    moves = [("a displacement of a support", support.displacement) for support in scene.supports]
    turns = [("a turn of a support", support.turn) for support in scene.supports]
    if scene.frame is not None:
        moves.insert(0, ("a frame with a velocity", scene.frame.velocity))
        turns.insert(0, ("a frame that turns", scene.frame.angular_velocity))
    for what, x in moves:
        if isinstance(x, Tensor):
            _refuse_vector(space, what, x)
    for what, x in turns:
        if isinstance(x, Tensor):
            _refuse(space, what, x, space.project_spin(x) @ space.basis[:, 2:].mT)


def _of_loads(model: Model) -> Iterator[tuple[str, Tensor]]:
    """Forces and moments (..., 6) of loads that are numbers, on the beam at rest, but for those
    that lie in the plane to the bit whatever the beam does; with what loads are called.
    """
    acts = *model.scene.loads, *model.scene.interactions
    loads = tuple([x for x in acts if constant(x) and not _inside(model, x)])
    if not loads:
        return
    beam, still = model.scene.beam, torch.zeros_like(model.scene.beam.nodes)
    t = still.new_zeros(())
    whole = with_values(model, space=in_space(beam))
    nodes = Nodes(beam.nodes, beam.frames, still, still, axes=model.drawn_axes)
    now = conditions(model, t, {}, loads=loads)
    for acting, point in load_points(whole, nodes, now, now.loads):
        yield acting.load.called, wrench(whole.space, acting.load, point, t, {})
    for acting in now.between:
        yield acting.load.called, at_nodes(whole, nodes, replace(now, between=(acting,)))
    for acting in now.interactions:
        one, unknowns = replace(now, interactions=(acting,)), acting.load.unknowns
        inner = interactions.Inner(still.new_ones(1, unknowns))
        push = interactions.at_nodes(whole.space, nodes, one, 0.0, inner, bool(unknowns))
        yield acting.load.called, push


def _inside(model: Model, load: Any) -> bool:
    """Whether a load is a dead force, or moment, in the plane; or an elastic clamp whose support
    rests, where the beam at rest is.
    """
    space, scene = model.space, model.scene
    if isinstance(load, RootSpring):
        return scene.root is None and scene.frame is None
    if not isinstance(load, PointLoad | LineLoad) or load.depends:
        return False
    for x, normals in ((load.force, slice(2, None)), (load.moment, slice(2))):
        if x is not None and not isinstance(x, Tensor):
            return False
        if x is not None and concrete(x.detach() @ space.basis[:, normals]).any():
            return False
    return True


def _refuse_offset(space: Planar, effect: Any) -> None:
    inside = space.project_offset(effect.offset) @ space.section[:, :2].mT
    _refuse(space, effect.called, effect.offset, inside)


def _refuse_vector(space: Planar, what: str, x: Tensor) -> None:
    _refuse(space, what, x, space.project_vector(x) @ space.basis[:, :2].mT)


def _refuse(space: Planar, what: str, given: Tensor, inside: Tensor) -> None:
    given = given.detach()
    if not given.numel():  # of no sample
        return
    out, size = (torch.linalg.vector_norm(x, torch.inf) for x in (given - inside.detach(), given))
    if concrete(out > ROUNDING * size).any():
        raise ValueError(
            f"{what} out of the plane {space.name!r} was given; one in it is wanted, or plane=None"
        )
