"""Where supports that move lead their nodes in a step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ..nodal.model import Model
from ..state.state import State


class SupportPose(NamedTuple):
    """Where a support that moves leads its node: u (..., p) to the positions that it holds, a mask (p,), and m (...) to the
    rotation, where it holds that.
    """

    node: int
    position: Tensor
    rotation: bool
    u: Tensor
    m: Tensor


class ClampMotion(NamedTuple):
    """Absolute velocity (..., p), frame a, and spin (..., s), section axes, of a clamp at the end of the step."""

    node: int
    velocity: Tensor
    spin: Tensor


class SupportMotions(NamedTuple):
    """Supports of a beam that moves with frame a or with one of them: nodes of all, poses of those that move in frame a, and
    clamps. None, where nothing moves.
    """

    nodes: tuple[int, ...] = ()
    poses: tuple[SupportPose, ...] = ()
    clamps: tuple[ClampMotion, ...] = ()


def support_motions(model: Model, start: State, end: Tensor, part: float) -> SupportMotions:
    """From `start` to the time `end`; u and m lead a part (1/2 or 1) of the way."""
    if not model.scene.has_prescribed_motion:
        return SupportMotions()
    space, poses, clamps = model.space, [], []
    for support, fixed in zip(model.scene.supports, model.constraints.fixed, strict=True):
        at = support.node
        if support.moves:
            position, rotation = space.of_nodes(at).pose(*model.prescribed_motion.pose(support, end))
            m = space.multiply(space.inverse(start.rotation[..., at, :]), rotation)
            whole = bool(fixed[space.position:].all())
            poses.append(SupportPose(at, fixed[:space.position] > 0, whole, (position - start.position[..., at, :]) * part,
                                     space.sqrt(m) if part == 0.5 else m))
        if support.clamp:
            clamps.append(ClampMotion(at, *space.motion(*model.prescribed_motion.absolute(support, end))))
    return SupportMotions(model.constraints.nodes, tuple(poses), tuple(clamps))
