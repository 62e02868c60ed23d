"""Places along a part at which it may touch a curve, and how much each of them stands for."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.validation import concrete
from .centreline import bernstein, control_shares, piece_nodes

DENSITY = 2.0  # places in half of the length along which two that cross touch


class Places(NamedTuple):
    """P places along a part, `count` in each of its pieces; see `PartContact`."""

    count: int
    shares: Tensor
    measure: Tensor


def places_along(
    first: int,
    nodes: int,
    s: Tensor,
    radii: Tensor,
    thickness: Tensor,
    points: int | None,
    share: float,
) -> Places:
    """Of a part of `nodes` nodes from `first` on, at the arclength s (..., N+1) m; each has `share`
    of the force. radii (..., 2) m, thickness (...) m; points in a piece, None = by these.
    """
    if nodes == 1:
        return Places(1, s.new_tensor([[0.0, 1.0, 0.0]]), s.new_ones(1))
    control = s.new_tensor(control_shares(nodes))
    corners = (control @ s[..., piece_nodes(first, nodes), None])[..., 0]
    lengths = corners.diff(dim=-1)  # (..., n, 2), halves of what the curve begins and ends with
    number = _number(lengths, radii.detach(), thickness.detach(), points)
    count = int(concrete(number).amax())
    t = (torch.arange(count, dtype=s.dtype, device=s.device) + 0.5) / number
    t = t.clamp(max=1)[..., None, :]  # 1: a place that this sample has not
    shares = (bernstein(t) @ control).flatten(-3, -2)
    speed = 2 * (lengths[..., :1] * (1 - t) + lengths[..., 1:] * t)
    return Places(count, shares, share * (speed / number[..., None] * (t < 1)).flatten(-2))


def _number(lengths: Tensor, radii: Tensor, thickness: Tensor, points: int | None) -> Tensor:
    """(..., 1) places of a piece, each sample's own: `DENSITY` in half of the length along which
    two beams touch that cross at a right angle, or as the pair says.
    """
    if points:
        return radii.new_tensor([float(points)])
    D = radii.sum(-1)
    half = (thickness * (2 * D + thickness)).sqrt()
    longest = lengths.detach().sum(-1).amax(-1)
    return (DENSITY * longest / half).ceil().clamp(min=1)[..., None]
