"""What may stand where an effect wants a value: a tensor, numbers, a function of t, an Input; along the beam also a
function of s, or a value for each element.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..checks import Value, as_tensor, axis_last, common_dtype, count, finite, positive


@dataclass(frozen=True)
class Input:
    """In place of a load's value: `size` numbers by `name`, given at each step (or call) and held over it."""

    name: str
    size: int

    def __post_init__(self) -> None:
        count("size", self.size)


@dataclass(frozen=True)
class Along:
    """A line load's value as a function of place and time: `function(s, t)` -> (..., sites, 3) per metre.

    s (..., sites) m is the arclength from the root, t (0-dim) s.
    """

    function: Callable[[Tensor, Tensor], Tensor]

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise ValueError(f"Along({self.function!r}) was given; a function of s and t is wanted")

    def __call__(self, s: Tensor, t: Tensor) -> Tensor:
        value = torch.as_tensor(self.function(s, t), dtype=s.dtype, device=s.device)
        return axis_last("an Along function's value", value, 3)


@dataclass(frozen=True)
class PerElement:
    """A line load's value for each element: (..., N, 3) per metre, or a function t -> (..., N, 3).

    A node takes the mean of its two elements, by their lengths: the load that it gathers is then half of each.
    """

    value: Value | Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        if callable(self.value):
            return
        value = plain(self.value)
        if value.ndim < 2 or value.shape[-1] != 3:
            raise ValueError(f"PerElement of shape {tuple(value.shape)} was given; (..., N, 3) is wanted")
        finite("PerElement's value", torch.as_tensor(value))
        object.__setattr__(self, "value", value)

    @property
    def shape(self) -> torch.Size:
        """Batch axes and 3, as another value has them; a function has none."""
        if callable(self.value):
            raise AttributeError("shape")
        return torch.Size((*self.value.shape[:-2], 3))

    def __call__(self, s: Tensor, t: Tensor) -> Tensor:
        value = torch.as_tensor(self.value(t) if callable(self.value) else self.value, dtype=s.dtype, device=s.device)
        sites = s.shape[-1]
        if value.ndim < 2 or value.shape[-1] != 3 or value.shape[-2] not in (sites, sites - 1):
            raise ValueError(f"PerElement of shape {tuple(value.shape)} was given; (..., N, 3) is wanted, one of each element")
        if value.shape[-2] == sites:  # the sites are elements
            return value
        h = s.diff(dim=-1)[..., None]
        ends = torch.zeros_like(h[..., :1, :])
        before, after = torch.cat((ends, h), -2), torch.cat((h, ends), -2)
        first, last = value[..., :1, :], value[..., -1:, :]
        return (before * torch.cat((first, value), -2) + after * torch.cat((value, last), -2)) / (before + after)


Inputs = dict[str, Tensor]
LoadValue = Tensor | np.ndarray | Callable[..., Tensor] | Input  # an array: plain numbers, of no dtype of their own


def value_at(value: LoadValue, t: Tensor, inputs: Inputs, like: Tensor) -> Tensor:
    """The load's value (..., 3) at time t; an `Input` is looked up by name.

    Raises ValueError where an input is missing or has the wrong last axis.
    """
    if isinstance(value, Input):
        if value.name not in inputs:
            given = ", ".join(sorted(inputs)) or "none"
            raise ValueError(f"the input {value.name!r} is wanted at each step; given were: {given}")
        return axis_last(f"input {value.name!r}", inputs[value.name], value.size)
    if callable(value):
        value = torch.as_tensor(value(t), dtype=like.dtype, device=like.device)
        return axis_last("a load function's value", value, 3)
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


def value_along(value: LoadValue | Along | PerElement, s: Tensor | None, t: Tensor, inputs: Inputs, like: Tensor) -> Tensor:
    """The same (..., sites or 1, 3) at sites along the beam, at the arclengths s (..., sites)."""
    return value(s, t) if isinstance(value, (Along, PerElement)) else value_at(value, t, inputs, like)[..., None, :]


def of_time(value: Any, s: Tensor) -> Callable[[Tensor], Tensor] | None:
    """A value that may change in time as a function of t alone, at the sites s; None where it is constant or an Input."""
    if isinstance(value, (Along, PerElement)):
        return None if isinstance(value, PerElement) and not callable(value.value) else partial(value, s)
    return value if callable(value) else None


def plain(value: Value) -> Tensor | np.ndarray:
    """A tensor as it is, a sequence that holds tensors stacked, and plain numbers as an array: they take the dtype of
    what they meet.
    """
    if isinstance(value, Tensor):
        return value
    if isinstance(value, (list, tuple)) and any(isinstance(v, Tensor) for v in value):
        return as_tensor(value, *common_dtype(value))
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} was given; numbers, a tensor, a function of t or an Input are wanted") from None


def load_value(name: str, value: Value | None, *, along: bool = False) -> LoadValue | None:
    """`value` checked: (..., 3), a function, an Input of size 3, or None; `along` the beam also Along and PerElement."""
    if isinstance(value, (Along, PerElement)):
        if not along:
            raise ValueError(f"{name} as {type(value).__name__} was given; only what acts along the beam takes it")
        return value
    if value is None or callable(value):
        return value
    if isinstance(value, Input):
        if value.size != 3:
            raise ValueError(f"{name} with an Input of size {value.size} was given; size 3 is wanted")
        return value
    value = axis_last(name, plain(value), 3)
    finite(name, torch.as_tensor(value))
    return value


def parameter(name: str, value: Value, *, zero: bool = True) -> Tensor | np.ndarray:
    """A number (...) that may not be negative (nor zero, without `zero`); ValueError otherwise."""
    value = plain(value)
    positive(name, torch.as_tensor(value), zero=zero)
    return value


def present(value: Tensor | np.ndarray) -> bool:
    """Whether a parameter is there: any tensor, and any number but 0."""
    return isinstance(value, Tensor) or bool(value.any())


def like(value: Tensor | np.ndarray, other: Tensor) -> Tensor:
    """`value` as a tensor of the other's dtype and device."""
    return torch.as_tensor(value, dtype=other.dtype, device=other.device)
