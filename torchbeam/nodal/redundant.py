"""Redundant constraints: what a joint holds that supports and other joints hold, where nothing
between them gives way.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from .joint_motion import Pose
from .model import Model

RANK = {torch.float64: 1e-9, torch.float32: 1e-4}  # of a row


def refuse_redundant(model: Model) -> None:
    """Raises ValueError where the gradients of the constraints by all moves that supports leave are
    dependent, as drawn: their forces are then not determined. Names the first joint in the list
    that holds what those before it hold.
    """
    if not model.joints.count:
        return
    with no_derivatives():
        G = concrete(_gradient(model)).double()
    least = RANK[model.scene.dtype]
    if _rank(G, least) == G.shape[-2]:
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
    """The least of all samples; a row that is smaller than `least` is none."""
    return int((torch.linalg.svdvals(G) > least).sum(-1).amin())


def _gradient(model: Model) -> Tensor:
    """(..., constraints, unknowns) as drawn, by what supports leave: displacements in sizes of the
    whole, and rotations.
    """
    joints, beam = model.joints, model.scene.beam
    ends = joints.framework.at_joints
    pose = Pose(ends(beam.nodes), ends(beam.axes.flatten(-2)).unflatten(-1, (3, 3)))
    none = beam.nodes.new_zeros(joints.held.shape)
    G = joints.alone(joints.blocks(pose, pose, none, None, 1.0)).constraints()
    size, p = joints.size.detach()[..., None, None], model.space.dims.position
    along = torch.arange(model.space.unknowns, device=G.device).repeat(model.node_count) < p
    G = G * torch.where(along, size, 1.0) * model.constraints.moving.flatten()
    rows = torch.linalg.vector_norm(G, dim=-1, keepdim=True)
    return G / torch.where(rows > 0, rows, 1.0)
