"""Step jacobian: how the coordinates of the state after a step follow those of the state before it,
and the inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from ..core.validation import broadcast, refusal, shown
from ..nodal.coordinates.spatial import Spatial
from ..nodal.moves import move_between, moved
from ..scene.effects import Inputs
from ..state.state import State


class Coordinates(Protocol):
    """Coordinates z (..., n) of a state, as a linear model has them: reads (..., n, moves) those of
    its own state's moves.
    """

    reads: Tensor

    def place(self, state: State) -> Any:
        """What belongs to a state in the space's coordinates: tensors with its batch axes."""

    def slopes(self, state: State, place: Any = None) -> tuple[Tensor, Tensor]:
        """dz/dm (..., n, moves) and dm/dz (..., moves, n) by moves of such a state."""


class StepSlopes(NamedTuple):
    """Derivatives of z after a step, and of what is read of its end: by z before it (..., r, n),
    and by each of what was given, in order (..., r, m); `Coordinates.place` before and after.
    """

    by_coordinates: Tensor
    by_given: list[Tensor]
    places: tuple[Any, Any]


def step_slopes(
    step: Callable[[State, dict[str, Tensor]], tuple[State, Tensor | None]],
    space: Spatial,
    coordinates: Coordinates,
    start: State,
    given: dict[str, Tensor],
    readings: int = 0,
    held: Sequence[Tensor] = (),
) -> tuple[State, Tensor | None, StepSlopes]:
    """The state after step(public state, given), in the space's coordinates as `start` is, what it
    reads of that (..., readings), and the derivatives of z and of these, in rows.

    By reverse mode, all rows as one batch of as many equal steps. held: what `step` is made of
    beside, each (r, ..., m) with gradient: derivatives by it come behind those by what is given,
    and what was made of it lasts. Constants: no derivatives go through them.
    """
    n, lead = coordinates.reads.shape[-2], start.batch_shape
    rows = n + readings
    with torch.enable_grad():
        move = start.position.new_zeros(
            rows, *lead, coordinates.reads.shape[-1], requires_grad=True
        )
        own = {
            name: x.detach().expand(rows, *lead, -1).clone().requires_grad_()
            for name, x in given.items()
        }
        now, read = step(space.to_public(moved(space, start, move)), own)
        ends = space.to_reduced(now)
        end = ends.broadcast((rows, *lead))[0].detach()
        with torch.no_grad():
            both = State.stack([start, end])
            place = coordinates.place(both)
            (_, by_moves), (moves, _) = (
                slope.unbind(0) for slope in coordinates.slopes(both, place)
            )
        total = (by_moves.movedim(-2, 0) * move_between(space, end, ends)[:n]).sum()
        if read is not None:
            total = total + diagonal(read[n:]).sum()
            read = read.detach()[0].expand(*lead, readings)
        slopes = torch.autograd.grad(
            total, (move, *own.values(), *held), retain_graph=bool(held), allow_unused=True,
            materialize_grads=True,
        )  # fmt: skip
    by_move, *by_given = (slope.movedim(0, -2) for slope in slopes)
    places = tuple(type(place)(*(part[k] for part in place)) for k in (0, 1))
    return end, read, StepSlopes(by_move @ moves, by_given, places)


def diagonal(rows: Tensor) -> Tensor:
    """(r, ...): of rows (r, ..., r) the i-th number of the i-th."""
    return torch.stack([row[..., i] for i, row in enumerate(rows)])


def step_jacobian(
    stepper: Any, coordinates: Coordinates, state: State, inputs: Inputs, dt: Tensor
) -> tuple[Tensor, Tensor]:
    """A (..., n, n) and B (..., n, m) of one step of dt (...) s from a public state: dz after = A
    dz before + B d(inputs, side by side, in the scene's order).

    Constants: no derivatives go through them.
    """
    space = stepper.model.space
    state = space.to_public(stepper.reduced(state))
    state = state.broadcast(broadcast("a state and dt", state.status.shape, dt.shape))
    if not hasattr(coordinates, "reads"):
        raise refusal(f"model = {shown(coordinates)}", "what `linearize` returns")
    start = space.to_reduced(state.detach())
    lead = broadcast(
        "a state, a model and inputs",
        state.batch_shape,
        coordinates.reads.shape[:-2],
        *(u.shape[:-1] for u in inputs.values()),
    )
    _, _, slopes = step_slopes(
        lambda before, held: (stepper.advance(before, held, dt=dt), None),
        space,
        coordinates,
        start.broadcast(lead),
        {name: inputs[name] for name in stepper.scene.inputs},
    )
    A, B, _ = slopes
    return A, torch.cat(B, -1) if B else A[..., :0]
