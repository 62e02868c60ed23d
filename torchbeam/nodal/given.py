"""Where supports that move lead their nodes in a step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from ..state import State
from .model import Model


class Given(NamedTuple):
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


def given(model: Model, start: State, end: Tensor, dt: Tensor, part: float) -> tuple[Given, ...]:
    """One for each support where frame a or a support moves, else none. u and m lead a part (1/2 or 1) of the way from `start`
    to the time `end`.
    """
    if not model.scene.carried:
        return ()
    space, found = model.space, []
    for support, fixed in zip(model.scene.supports, model.held.fixed, strict=True):
        u = m = velocity = spin = None
        at = support.node
        if support.moves:
            position, rotation = space.pose(*model.carrying.pose(support, end), at)
            u = (position - start.position[..., at, :]) * part
            m = space.multiply(space.inverse(start.rotation[..., at, :]), rotation)
            m = space.half(m) if part == 0.5 else m
        if support.clamp:
            velocity, spin = space.motion(*model.carrying.absolute(support, end, dt))
        whole = bool(fixed[space.position:].all())
        found.append(Given(at, fixed[:space.position] > 0, whole, u, m, velocity, spin))
    return tuple(found)
