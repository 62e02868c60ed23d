"""Where supports that move lead their nodes in a step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ..nodal.model import Model
from ..state.state import State


class SupportMotion(NamedTuple):
    """A support's motion at the end of the step: u (..., p) and m (...) that lead there, and for a clamp its absolute velocity
    (frame a) and spin (section axes); None where the step finds it.
    """

    node: int
    position: Tensor
    rotation: bool
    u: Tensor | None
    m: Tensor | None
    velocity: Tensor | None
    spin: Tensor | None


def support_motions(model: Model, start: State, end: Tensor, part: float) -> tuple[SupportMotion, ...]:
    """One for each support where frame a or a support moves, else none. u and m lead a part (1/2 or 1) of the way from `start`
    to the time `end`.
    """
    if not model.scene.has_prescribed_motion:
        return ()
    space, found = model.space, []
    for support, fixed in zip(model.scene.supports, model.constraints.fixed, strict=True):
        u = m = velocity = spin = None
        at = support.node
        if support.moves:
            position, rotation = space.pose(*model.prescribed_motion.pose(support, end), at)
            u = (position - start.position[..., at, :]) * part
            m = space.multiply(space.inverse(start.rotation[..., at, :]), rotation)
            m = space.sqrt(m) if part == 0.5 else m
        if support.clamp:
            velocity, spin = space.motion(*model.prescribed_motion.absolute(support, end))
        whole = bool(fixed[space.position:].all())
        found.append(SupportMotion(at, fixed[:space.position] > 0, whole, u, m, velocity, spin))
    return tuple(found)
