"""Jacobians of batched functions: forward mode, and central differences as one batch."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Function = Callable[[Tensor], Tensor]  # x (N, p) -> y (N, T)


def forward(f: Function, x: Tensor) -> tuple[Tensor, Tensor]:
    """y (S, T) and dy/dx (S, T, p) at x (S, p), direction j of sample s being row s p + j."""
    S, p = x.shape
    directions = torch.eye(p, dtype=x.dtype, device=x.device).repeat(S, 1)
    value, slope = torch.func.jvp(f, (x.repeat_interleave(p, 0),), (directions,))
    return value.unflatten(0, (S, p))[:, 0], slope.unflatten(0, (S, p)).mT


def difference(
    f: Function,
    x: Tensor,
    size: Tensor,
    least: Tensor | None = None,
    largest: Tensor | None = None,
    y: Tensor | None = None,
    central: bool = True,
) -> tuple[Tensor, Tensor]:
    """The same by differences of `size` (S, p), all in one batch of 2 p samples for each, and of
    one more where y (S, T) is not known. Central, but for where one side leaves the bounds (S, p),
    or gives what is not finite: that difference is one of the other side. Not `central`: p samples,
    the differences of one side, that of the bound further away.
    """
    S, p = x.shape
    high, low = x + size, x - size
    if least is not None:
        high, low = torch.minimum(high, largest), torch.maximum(low, least)
    eye = torch.eye(p, dtype=torch.bool, device=x.device)
    here = x[:, None].expand(S, p, p)
    if not central:
        high, low = torch.where(high - x >= x - low, high, low), None
    stencil = [torch.where(eye, end[:, None], here) for end in (high, low) if end is not None]
    if y is None:
        stencil.append(x[:, None])
    values = f(torch.cat(stencil, 1).flatten(0, 1)).unflatten(
        0, (S, len(stencil[0][0]) * (1 + central) + (y is None))
    )
    y = values[:, -1] if y is None else y
    if not central:
        width = high - x
        return y, ((values[:, :p] - y[:, None]) / torch.where(width == 0, 1, width)[..., None]).mT
    above, below = values[:, :p], values[:, p : 2 * p]
    lacks_above, lacks_below = (~torch.isfinite(v).all(-1) for v in (above, below))
    above = torch.where((lacks_above & ~lacks_below)[..., None], y[:, None], above)
    below = torch.where((lacks_below & ~lacks_above)[..., None], y[:, None], below)
    width = torch.where(lacks_above, x, high) - torch.where(lacks_below, x, low)
    return y, ((above - below) / torch.where(width > 0, width, 1)[..., None]).mT
