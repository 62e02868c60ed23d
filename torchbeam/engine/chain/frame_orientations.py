"""Orientations of frame a in steps, in the space's coordinates."""

from __future__ import annotations

import torch
from torch import Tensor

from ...nodal.model import Model


def orientations(
    model: Model, start: Tensor | None, dt: Tensor, t: Tensor, K: int | None, dims: int
) -> tuple[Tensor | None, Tensor | None]:
    """In the middle and at the end of K steps of dt (K, ...) with the middles t, from `start`
    (...), (K, ..., q); of one step (K = None) without the axis of steps. start: None = it does not
    turn.
    """
    if start is None:
        return None, None
    space, frame = model.space, model.frame(t)
    if K is None:
        return frame.orientation(start, dt / 2), frame.orientation(start, dt)
    dt = dt.expand(K, *(1,) * dims) if dt.ndim == 0 else dt
    turns, half = (
        frame.orientation(space.identity(start[..., 1:]), part * dt) for part in (1.0, 0.5)
    )
    size = 1
    while size < len(turns):  # each is that of all steps up to its own
        turns = torch.cat((turns[:size], space.multiply(turns[:-size], turns[size:])))
        size *= 2
    end = space.normalize(space.multiply(start, turns))
    begin = torch.cat((start.expand(1, *end.shape[1:]), end[:-1]))
    return space.multiply(begin, half), end


def of_samples(frame: Tensor, status: Tensor, K: int | None) -> Tensor:
    """Orientations after steps (..., q) of samples with the axes of `status`."""
    steps, extra = status.shape[: K is not None], max(0, frame.ndim - 1 - status.ndim)
    return frame.reshape(*steps, *frame.shape[len(steps) + extra :])
