"""Where supports that move lead their nodes in a step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ..nodal.conditions import SupportConditions
from ..nodal.coordinates.spatial import Spatial
from ..state.state import State


class SupportPose(NamedTuple):
    """Where a support that moves leads its node: u (..., p) to the positions that it holds, a mask
    (p,), and m (...) to the rotation, where it holds that.
    """

    node: int
    position: Tensor
    rotation: bool
    u: Tensor
    m: Tensor


class ClampMotion(NamedTuple):
    """Velocity (..., p), frame a, and spin (..., s), section axes, of a clamp at a step's end."""

    node: int
    velocity: Tensor
    spin: Tensor


class SupportMotions(NamedTuple):
    """Supports of a beam that moves with frame a or with one of them: nodes of all, poses of those
    that move in frame a, and clamps. None, where nothing moves.
    """

    nodes: tuple[int, ...] = ()
    poses: tuple[SupportPose, ...] = ()
    clamps: tuple[ClampMotion, ...] = ()


def support_motions(
    space: Spatial, supports: tuple[SupportConditions, ...], start: State, part: float
) -> SupportMotions:
    """From `start` to where supports are at the end; u and m lead a part (1/2 or 1) of the way."""
    poses, clamps = [], []
    for support in supports:
        at, node_space = support.node, space.of_nodes(support.node)
        if support.pose is not None:
            position, rotation = node_space.pose(*support.pose)
            m = space.multiply(space.inverse(start.rotation[..., at, :]), rotation)
            whole = bool(support.fixed[space.dims.position :].all())
            poses.append(
                SupportPose(
                    at,
                    support.fixed[: space.dims.position] > 0,
                    whole,
                    (position - start.position[..., at, :]) * part,
                    space.sqrt(m) if part == 0.5 else m,
                )
            )
        if support.motion is not None:
            clamps.append(ClampMotion(at, *space.motion(*support.motion)))
    return SupportMotions(tuple(support.node for support in supports), tuple(poses), tuple(clamps))
