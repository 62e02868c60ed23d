"""Step jacobian: how the coordinates of the state after a step follow those of the state before it,
and the inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from ..core.validation import broadcast, shown
from ..nodal.coordinates.spatial import Spatial
from ..nodal.moves import move_between, moved
from ..scene.effects import Inputs
from ..state.state import State


class Coordinates(Protocol):
    """Coordinates z (..., n) of a state, as a linear model has them: reads (..., n, moves) those of
    its own state's moves.
    """

    reads: Tensor

    def slopes(self, state: State) -> tuple[Tensor, Tensor]:
        """dz/dm (..., n, moves) and dm/dz (..., moves, n) by moves of a state in the space's
        coordinates.
        """


def step_jacobian(
    step: Callable[[State, Inputs], State],
    space: Spatial,
    coordinates: Coordinates,
    state: State,
    inputs: Inputs,
) -> tuple[Tensor, Tensor]:
    """A (..., n, n) and B (..., n, m) of one step(state, inputs) of public states: dz after = A dz
    before + B d(inputs, side by side).

    By reverse mode, all n rows as one batch of as many equal steps. Constants: no derivatives go
    through them.
    """
    if not hasattr(coordinates, "reads"):
        raise ValueError(
            f"model = {shown(coordinates)} was given; what `linearize` returns is wanted"
        )
    n, start = coordinates.reads.shape[-2], space.to_reduced(state.detach())
    lead = broadcast(
        "a state, a model and inputs",
        state.batch_shape,
        coordinates.reads.shape[:-2],
        *(u.shape[:-1] for u in inputs.values()),
    )
    with torch.enable_grad():
        move = start.position.new_zeros(n, *lead, coordinates.reads.shape[-1], requires_grad=True)
        held = {
            name: u.detach().expand(n, *lead, -1).clone().requires_grad_()
            for name, u in inputs.items()
        }
        ends = space.to_reduced(step(space.to_public(moved(space, start, move)), held))
        end = ends.broadcast((n, *lead))[0].detach()
        with torch.no_grad():
            (_, by_moves), (moves, _) = (
                slope.unbind(0) for slope in coordinates.slopes(State.stack([start, end]))
            )
        rows = by_moves.movedim(-2, 0) * move_between(space, end, ends)
        slopes = torch.autograd.grad(
            rows.sum(), (move, *held.values()), allow_unused=True, materialize_grads=True
        )
    A, *B = (slope.movedim(0, -2) for slope in slopes)
    return A @ moves, torch.cat(B, -1) if B else A[..., :0]
