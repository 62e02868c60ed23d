"""Redundant constraints: what a joint holds that supports and other joints hold, where nothing
between them gives way.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import with_values
from ..core.remembered import remembered
from ..core.validation import concrete
from .joint_motion import Pose
from .joints import Joints
from .model import Model

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
    pose = Pose(ends(nodes), ends(axes.flatten(-2)).unflatten(-1, (3, 3)))
    G = joints.held_rows(pose)
    size, space = joints.size.detach()[..., None, None], joints.space
    along = torch.arange(len(moving), device=G.device) % space.unknowns < space.dims.position
    G = G * torch.where(along, size, 1.0) * moving
    rows = torch.linalg.vector_norm(G, dim=-1, keepdim=True)
    return G / torch.where(rows > 0, rows, 1.0)
