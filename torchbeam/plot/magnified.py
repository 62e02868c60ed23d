"""Magnified displacements: states drawn further from the undeformed beam than they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance
from ..math import quaternions as quat
from ..scene.scene import Scene
from ..state.rest_shape import RestShape
from ..state.state import State


def undeformed_state(state: Any, scene: Scene | None) -> State:
    """The same, with nodes where the beam has them: of a scene, or of the state itself. Raises
    ValueError for a state of another form, and one that does not know its beam.
    """
    shape = instance("a state", state, State).rest_shape
    shape = shape if scene is None else RestShape.of(scene.beam)
    own = state.position, state.rotation
    try:
        x, q = (at.to(now).expand_as(now) for at, now in zip(shape, own, strict=True))
    except (TypeError, RuntimeError):  # there is none, or one of other samples
        raise ValueError(
            "a state that does not know its undeformed beam was given; scene=, whose state it is, "
            "is wanted"
        ) from None
    return replace(state, position=x, rotation=q)


def magnified(state: State, at_rest: State, times: float) -> State:
    """With `times` the displacements, and section axes that tilt as the beam does then."""
    R0, R = (quat.matrix(x.rotation.detach()) for x in (at_rest, state))
    moved = at_rest.position + times * (state.position.detach() - at_rest.position)
    return replace(state, position=moved, rotation=tilted(R0 + times * (R - R0)))


def tilted(axes: Tensor) -> Tensor:
    """Quaternions (..., 4) of axes (..., 3, 3) that moves without bound have made oblique: x stays
    along the beam, y in its plane with it.
    """
    x, y, _ = axes.unbind(-1)
    x = torch.nn.functional.normalize(x, dim=-1)
    z = torch.nn.functional.normalize(torch.linalg.cross(x, y), dim=-1)
    return quat.from_matrix(torch.stack((x, torch.linalg.cross(z, x), z), -1))
