"""The axes of beams: curves through the nodes of a state."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
from ..state.state import State

PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
POINTS = 8  # of the curve through an element


def nodes_of(state: Any) -> tuple[Tensor, Tensor]:
    """Positions (samples, N+1, 3) m and section axes (samples, N+1, 3, 3) as columns, frame a, of a
    state of any form. Raises ValueError for what is no state, and for one of no sample.
    """
    if not all(isinstance(getattr(state, x, None), Tensor) for x in ("position", "rotation")):
        raise ValueError(
            f"{type(state).__name__} was given to a picture of the beam; a state is wanted (of a "
            "solution: solution.state)"
        )
    R = quat.matrix(state.rotation) if isinstance(state, State) else state.rotation
    shape = broadcast_shapes(state.position.shape[:-1], R.shape[:-2])
    if 0 in shape:
        raise ValueError(
            f"a state with the batch axes {tuple(shape[:-1])}, without a sample, was given to a "
            "picture; one or more are wanted"
        )
    position, R = state.position.detach().expand(*shape, 3), R.detach().expand(*shape, 3, 3)
    return position.reshape(-1, shape[-1], 3), R.reshape(-1, shape[-1], 3, 3)


def rows_of(state: Any) -> list[slice]:
    """The nodes of each beam."""
    parts = getattr(state, "parts", ())
    return [part.nodes for part in parts if not part.body] if parts else [slice(None)]


def axis_curves(
    rows: list[slice], position: Tensor, along: Tensor, length: Tensor | None = None
) -> Tensor:
    """`axis_curve` of each beam, with a gap (not a number) between two."""
    curves = []
    for row in rows:
        inner = row if row.stop is None else slice(row.start, row.stop - 1)
        lengths = None if length is None else length[..., inner, :]
        curves.append(axis_curve(position[..., row, :], along[..., row, :], lengths))
        curves.append(torch.full_like(curves[-1][..., :1, :], torch.nan))
    return torch.cat(curves[:-1], -2) if curves else position[..., :0, :]


def axis_curve(position: Tensor, along: Tensor, length: Tensor | None = None) -> Tensor:
    """Cubic Hermite curves through nodes (samples, N+1, 3): (samples, points, 3). along
    (samples, N+1, 3): their derivative by arc length; length (..., N, 1) of the elements, by
    default their chords'.
    """
    rise = position.diff(dim=-2)
    length = torch.linalg.vector_norm(rise, dim=-1, keepdim=True) if length is None else length
    start, rise = position[..., :-1, None, :], rise[..., None, :]
    leaves, comes = (
        (length * along[..., part, :])[..., None, :] for part in (slice(None, -1), slice(1, None))
    )
    x = torch.linspace(0, 1, POINTS + 1, dtype=position.dtype, device=position.device)[:-1, None]
    inside = start + rise * x * x * (3 - 2 * x) + x * (1 - x) * (leaves * (1 - x) - comes * x)
    return torch.cat((inside.flatten(-3, -2), position[..., -1:, :]), -2)
