"""What a model cannot be: in a plane out of which something acts, moves it or is fixed to it; with
a joint that holds what supports and other joints hold, where nothing between them gives way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import constant, with_values
from ..core.remembered import remembered
from ..core.validation import concrete
from ..scene.ball import Ball
from ..scene.effects import RootSpring
from ..scene.effects.loads import LineLoad, PointLoad
from ..scene.joints import SQUARE, DrivenJoint
from . import interactions
from .conditions import conditions
from .coordinates.planar import Planar
from .coordinates.selection import in_space
from .element_loads import at_nodes
from .joint_motion import Pose
from .joints import Joints
from .loads import Nodes, load_points, wrench
from .model import Model

ROUNDING = 1e-9  # of a vector, that may lie out of a plane


def check_plane(model: Model) -> None:
    """Refuse numbers that act out of the plane of a model: loads on the beam at rest, the points
    that springs are tied to, what the beam bends by itself, masses that are not alike on both
    sides, motions of the frame and of supports; and joints that do not move in it. Raises
    ValueError.
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
                R = model.reference_axes[..., load.node, :, :]
                to = to - (R @ load.offset[..., None])[..., 0]
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
    for k, joint in enumerate(scene.joints):
        if isinstance(joint, Ball):
            turns.append(("a Ball with a torque", joint.torque))
        if isinstance(joint, DrivenJoint):
            _check_joint(space, f"joint {k}, a {joint}", joint, joint.axes(beam).detach())
    for what, x in turns:
        if isinstance(x, Tensor):
            _refuse(space, what, x, space.project_spin(x) @ space.basis[:, 2:].mT)


def _check_joint(space: Planar, called: str, joint: DrivenJoint, axes: Tensor) -> None:
    """Refuse a joint without a coordinate in the plane, and what acts along one that is not there:
    a turn wants an axis along the plane's normal, a travel an axis in it. axes (..., 3, 3).
    """
    idle = []
    for names in joint.GIVEN:
        turns = names[1].endswith("angle")
        axis = axes[..., int(names[1].startswith("second"))]
        off = (axis @ (space.basis[:, :2] if turns else space.basis[:, 2:])).abs()
        if concrete(off > SQUARE[off.dtype]).any():
            idle.append((turns, [name for name in names if name in joint.acts]))
    for turns, acting in idle:
        if acting or len(idle) == len(joint.GIVEN):
            normal = "z" if space.name == "xy" else "y"
            raise ValueError(
                f"{called},{' with ' * bool(acting)}{' and '.join(acting)} was given, which cannot "
                f"{'turn' if turns else 'slide'} in the plane {space.name!r}; its axis must "
                f"{f'be {normal}' if turns else 'lie in it'}, or plane=None"
            )


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
    nodes = Nodes(beam.nodes, beam.frames, still, still, axes=model.reference_axes)
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


RANK = {torch.float64: 1e-9, torch.float32: 1e-4}  # of a row
CLEAR = 1e-3  # of a row: a singular value that is no matter of rounding


def refuse_redundant(model: Model) -> None:
    """Raises ValueError where the gradients of the constraints by all moves that supports leave are
    dependent, as drawn: their forces are then not determined. Names the first joint in the list
    that holds what those before it hold.
    """
    if not model.joints.count:
        return
    beam, least = model.scene.beam, RANK[model.scene.dtype]
    bare = {name: None for name in ("laws", "balls") if hasattr(model.joints, name)}
    joints, moving = with_values(model.joints, **bare), model.constraints.moving.flatten()
    with no_derivatives():
        G = concrete(remembered(_gradient, joints, beam.nodes, beam.axes, moving)).double()
        if remembered(_rank, G, least) == G.shape[-2]:
            return
    counts, before = [int(held.sum()) for held in model.joints.held], 0
    for k, (joint, count) in enumerate(zip(model.scene.joints, counts, strict=True)):
        more = count - _rank(G[..., : before + count, :], least) + before
        if more:
            raise ValueError(
                f"joint {k}, a {joint}, was given, which holds {more} of {count} components that "
                "supports or joints before it hold already; one that leaves these free (a Ball or "
                "a Cylindrical in place of a Hinge), or a beam that bends between them, is wanted"
            )
        before += count


def _rank(G: Tensor, least: float) -> int:
    """The least of all samples; a row that is smaller than `least` is none. Where all are clearly
    independent, a factorisation of G G^T tells it, a tenth of the work of singular values.
    """
    apart = G @ G.mT - CLEAR**2 * torch.eye(G.shape[-2]).to(G)
    if (torch.linalg.cholesky_ex(apart).info == 0).all():
        return G.shape[-2]
    return int((torch.linalg.svdvals(G) > least).sum(-1).amin())


def _gradient(joints: Joints, nodes: Tensor, axes: Tensor, moving: Tensor) -> Tensor:
    """(..., constraints, unknowns) as drawn, by what supports leave `moving` (unknowns,):
    displacements in sizes of the whole, and rotations.
    """
    ends = joints.framework.at_joints
    r, R = ends(nodes), ends(axes.flatten(-2)).unflatten(-1, (3, 3))
    G = joints.held_rows(Pose(r, R) if joints.space.turns else Pose(r, 0 * R, R))
    size, space = joints.size.detach()[..., None, None], joints.space
    along = torch.arange(len(moving), device=G.device) % space.unknowns < space.dims.position
    G = G * torch.where(along, size, 1.0) * moving
    rows = torch.linalg.vector_norm(G, dim=-1, keepdim=True)
    return G / torch.where(rows > 0, rows, 1.0)
