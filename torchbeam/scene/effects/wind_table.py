"""Wind from a table of time and place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.functions_of_time import at_time
from ...core.leaves import FunctionOfTime, leaf, with_values
from ...core.validation import as_tensor, common_dtype, finite, increasing, refusal
from ...math.shapes import broadcast_shapes
from .histories import _interval
from .values import Inputs
from .wind import WindField, hats

LOOKED_AT = 256  # places of a table up to which all are summed, so that native code can be made


@dataclass(frozen=True)
class _Planes(FunctionOfTime):
    """Values (..., x, y, z, 3) at t (0-dim) of a table (..., n, x, y, z, 3): linear between the
    instants (n,), constant before and after.
    """

    t: Tensor = leaf(1)
    values: Tensor = leaf(5)

    def __call__(self, t: Tensor) -> Tensor:
        k = _interval(self.t, t)
        a, b = self.t.index_select(0, k)[0], self.t.index_select(0, k + 1)[0]
        before, after = (self.values.index_select(-5, i)[..., 0, :, :, :, :] for i in (k, k + 1))
        return before + ((t.to(self.t) - a) / (b - a)).clamp(0, 1) * (after - before)


@dataclass(frozen=True, eq=False)
class WindTable(WindField):
    """Wind from a table of time and place: a turbulence box, or measured.

    Args:
        t: (n,) s, strictly increasing
        values: (..., n, X, Y, Z, 3) m/s
        x, y, z: (X,), (Y,), (Z,) m, strictly increasing, from the origin; None: it is the same
            along that axis, and the table has one place there

    Linear between instants and places, constant beyond them. Differentiable in the values. Native
    code takes up to 256 places (the instants do not count), and asks for the instant once a step.

    Raises:
        ValueError: for instants or places that do not increase, or values of another shape.

    Examples:
        >>> values = torch.zeros(2, 1, 1, 2, 3)  # two instants, two heights
        >>> values[1, 0, 0, 1, 0] = 8.0
        >>> table = tb.WindTable((0.0, 1.0), values, z=(0.0, 10.0))
        >>> table.velocity(torch.tensor([[0.0, 0, 5.0]]), torch.tensor(0.5))
        tensor([[2., 0., 0.]])
    """

    t: Tensor = leaf(1)
    values: Tensor = leaf(5)
    x: Tensor | None = leaf(1, default=None, kw_only=True)
    y: Tensor | None = leaf(1, default=None, kw_only=True)
    z: Tensor | None = leaf(1, default=None, kw_only=True)
    _now: Any = leaf(lambda table: 1 if callable(table._now) else 4, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        dtype, device = common_dtype(self.t, self.values)
        t, values = (as_tensor(v, dtype, device) for v in (self.t, self.values))
        increasing("a WindTable's t", t)
        axes: dict[str, Tensor | None] = {}
        for name in "xyz":
            places = getattr(self, name)
            if places is not None:
                places = as_tensor(places, dtype, device)
                increasing(f"a WindTable's {name}", places)
            axes[name] = places
        sizes = (len(t), *(1 if v is None else len(v) for v in axes.values()), 3)
        if values.ndim < 5 or tuple(values.shape[-5:]) != sizes:
            raise refusal(
                f"a WindTable's values of shape {tuple(values.shape)}",
                f"(..., {', '.join(map(str, sizes))})", are=True, were=True,
            )  # fmt: skip
        finite("a WindTable's values", values)
        vars(self).update(t=t, values=values, _now=_Planes(t, values), **axes)

    def resolved(self, t: Tensor, inputs: Inputs, like: Tensor) -> WindTable:
        return (
            with_values(self, _now=at_time(self._now, t, axes=4)) if callable(self._now) else self
        )

    def __str__(self) -> str:
        return f"a WindTable of {len(self.t)} instants"

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        now = self._now(t) if callable(self._now) else self._now
        if now.shape[-4:-1].numel() > LOOKED_AT:
            return self._looked_up(now, position)
        now = now[..., None, :, :, :, :]  # of sites
        for name, component in zip("xyz", position.unbind(-1), strict=True):
            places, behind = getattr(self, name), now.ndim - position.ndim
            if places is None:
                now = now.squeeze(-behind - 1)
            else:
                weights = hats(component, places)
                weights = weights[(..., *(None,) * behind)]
                now = (weights * now).sum(-behind - 1)
        return now + torch.zeros_like(position)

    def _looked_up(self, now: Tensor, position: Tensor) -> Tensor:
        """The same from the eight corners of the cell about each site."""
        lead = broadcast_shapes(now.shape[:-4], position.shape[:-2])
        flat = now.expand(*lead, *now.shape[-4:]).reshape(-1, 3)
        size, count = now.shape[-4:-1].numel(), lead.numel()
        shape = (*lead, position.shape[-2])
        corners = [(torch.arange(count).reshape(*lead, 1) * size, torch.ones(shape).to(now))]
        strides = {"x": now.shape[-3] * now.shape[-2], "y": now.shape[-2], "z": 1}
        for name, component in zip("xyz", position.unbind(-1), strict=True):
            places = getattr(self, name)
            if places is None:
                continue
            k = torch.searchsorted(places.detach(), component.detach().contiguous(), right=True)
            k = (k - 1).clamp(0, len(places) - 2)
            share = ((component - places[k]) / places.diff()[k]).clamp(0, 1)
            corners = [
                (at + (k + end) * strides[name], weight * part)
                for at, weight in corners
                for end, part in ((0, 1 - share), (1, share))
            ]
        values = (
            weight[..., None] * flat.index_select(0, at.expand(shape).flatten()).reshape(*shape, 3)
            for at, weight in corners
        )
        return sum(values)
