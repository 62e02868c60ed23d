"""Places: which rows of an axis are meant, a range where they follow each other evenly, for then
they are a view; and sums at the nodes of a line of nodes.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.shapes import broadcast_shapes

Places = range | tuple[int, ...]


def even(places: Iterable[int]) -> Places:
    """As a range, where they are one that goes up."""
    places = tuple(places)
    step = places[1] - places[0] if len(places) > 1 else 1
    line = range(places[0], places[0] + step * len(places), step) if places and step > 0 else None
    return line if line is not None and tuple(line) == places else places


@lru_cache(maxsize=256)
def index(places: Places, device: torch.device) -> Tensor:
    """As an index."""
    return torch.tensor(tuple(places), dtype=torch.long, device=device)


def take(x: Tensor, places: Places, axes: int = 1) -> Tensor:
    """(..., n, *) -> (..., len(places), *), with `axes` axes behind the one that is meant."""
    if not isinstance(places, range):
        return x.index_select(-1 - axes, index(places, x.device))
    if places.step == 1:
        full = len(places) == x.shape[-1 - axes]
        return x if full else x.narrow(-1 - axes, places.start, len(places))
    behind = (slice(None),) * axes
    return x[(..., slice(places.start, places.stop, places.step), *behind)]


def added(total: Tensor | None, places: Places, part: Tensor, count: int, axes: int) -> Tensor:
    """total (..., count, *), None = zeros, with part (..., len(places), *) added at the places."""
    shape = (*part.shape[: -1 - axes], count, *part.shape[part.ndim - axes :])
    if total is None:
        total = part.new_zeros(shape)
    shape = broadcast_shapes(total.shape, shape)
    part = part.expand(*shape[: -1 - axes], len(places), *shape[len(shape) - axes :])
    return total.expand(shape).index_add(-1 - axes, index(places, part.device), part)


def at_i(x: Tensor, axes: int = 1) -> Tensor:
    """What each link of a line gives its first node, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (0, 1))


def at_j(x: Tensor, axes: int = 1) -> Tensor:
    """What each link of a line gives its second node, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (1, 0))


def interleaved(a: Tensor, b: Tensor, axes: int = 1) -> Tensor:
    """a_0, b_0, a_1, b_1 ... along the axis before `axes` others."""
    return torch.stack((a, b), -axes - 1).flatten(-axes - 2, -axes - 1)
