"""What the public doors share: turning input into tensors, and saying in one sentence what is wrong with it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch

Value = Any  # a tensor, a Python number or a (nested) sequence of them


def common_dtype(*values: Value) -> tuple[torch.dtype, torch.device]:
    """dtype and device of the floating tensors among `values`; the default dtype on the CPU if there is none.

    Raises ValueError where tensors of different floating dtypes or devices meet, and for other than single and double
    precision.
    """
    dtype, device = None, None
    for tensor in _tensors(values):
        if tensor.is_floating_point() or tensor.is_complex():
            if dtype not in (None, tensor.dtype):
                raise ValueError(f"tensors of dtype {dtype} and {tensor.dtype} were given; one dtype is wanted")
            dtype = tensor.dtype
        if device not in (None, tensor.device):
            raise ValueError(f"tensors on {device} and {tensor.device} were given; one device is wanted")
        device = tensor.device
    return precision(dtype or torch.get_default_dtype()), device or torch.device("cpu")


def precision(dtype: torch.dtype) -> torch.dtype:
    """`dtype` if it is float32 or float64; ValueError otherwise."""
    if dtype not in (torch.float32, torch.float64):
        raise ValueError(f"{dtype} was given; torch.float32 or torch.float64 is wanted")
    return dtype


def as_tensor(value: Value, dtype: torch.dtype, device: torch.device | None = None) -> Tensor:
    """`value` as a tensor of the given dtype. A (nested) sequence that holds tensors is stacked, so that gradients survive:
    its axes come last, those of the tensors in it are batch axes.
    """
    if holds_tensor(value):
        parts = [as_tensor(v, dtype, device) for v in value]
        return torch.stack(torch.broadcast_tensors(*parts), -_depth(value))
    try:
        return torch.as_tensor(value, dtype=dtype, device=device)
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} was given; numbers or a tensor are wanted") from None


def holds_tensor(value: Value) -> bool:
    """Whether `value` is a (nested) sequence with a tensor in it."""
    return isinstance(value, (list, tuple)) and next(_tensors(value), None) is not None


def _tensors(value: Value) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (list, tuple)):
        for v in value:
            yield from _tensors(v)


def _depth(value: Value) -> int:
    return 1 + max(map(_depth, value), default=0) if isinstance(value, (list, tuple)) else 0


def broadcast(what: str, *shapes: torch.Size) -> torch.Size:
    """The shape that all broadcast to; ValueError where there is none."""
    try:
        return torch.broadcast_shapes(*shapes)
    except RuntimeError:
        given = " and ".join(str(tuple(shape)) for shape in dict.fromkeys(shapes) if shape)
        raise ValueError(f"{what} with the batch axes {given} were given; axes that broadcast are wanted") from None


def keywords(*takers: Any) -> list[str]:
    """Keywords of the functions that are nothing but keywords."""
    return [p.name for f in takers for p in inspect.signature(f).parameters.values() if p.kind is p.KEYWORD_ONLY]


def options(name: str, given: dict[str, Any], known: list[str]) -> None:
    """ValueError where an option is not a known one."""
    for option in given:
        if option not in known:
            raise ValueError(f"the option {option!r} was given; {name} has {', '.join(known)}")


def concrete(x: Tensor) -> Tensor:
    """The numbers in x, to decide by: those of every sample, where torch.func.vmap shows one at a time."""
    while functorch.is_functorch_wrapped_tensor(x):
        x = functorch.get_unwrapped(x)
    return x


def axis_last(name: str, value: Any, size: int) -> Any:
    """`value` if its last axis has `size` entries; ValueError otherwise."""
    if value.ndim == 0 or value.shape[-1] != size:
        raise ValueError(f"{name} of shape {tuple(value.shape)} was given; (..., {size}) is wanted")
    return value


def positive(name: str, value: Tensor, *, infinite: bool = False, zero: bool = False) -> Tensor:
    """`value` if every entry is positive (or zero, or infinite, where allowed); ValueError otherwise."""
    bad = ~(value >= 0) if zero else ~(value > 0)
    if not infinite:
        bad = bad | torch.isinf(value)
    bad = concrete(bad)
    if bad.any():
        wanted = ("a non-negative" if zero else "a positive") + (" or infinite" if infinite else " finite") + " number"
        raise ValueError(f"{name} = {concrete(value)[bad].flatten()[0].item():g} was given; {wanted} is wanted")
    return value


def finite(name: str, value: Tensor) -> Tensor:
    """`value` if every entry is finite; ValueError otherwise."""
    numbers = concrete(value)
    if not torch.isfinite(numbers).all():
        raise ValueError(f"{name} holds {numbers[~torch.isfinite(numbers)].flatten()[0].item()}; finite numbers are wanted")
    return value


def count(name: str, value: int, least: int = 1) -> int:
    """`value` if it is a whole number of at least `least`; ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{name} = {value!r} was given; a whole number of at least {least} is wanted")
    return value


def increasing(name: str, value: Tensor) -> Tensor:
    """`value` if it is a strictly increasing series of at least two finite numbers; ValueError otherwise."""
    if value.ndim != 1 or value.numel() < 2:
        raise ValueError(f"{name} of shape {tuple(value.shape)} was given; a series of two or more instants is wanted")
    finite(name, value)
    step = value.diff()
    if not (step > 0).all():
        k = int((step <= 0).nonzero()[0, 0])
        raise ValueError(
            f"{name} goes from {value[k].item():g} to {value[k + 1].item():g}; strictly increasing instants are wanted"
        )
    return value


def tolerance(name: str, value: Any, *, zero: bool = False) -> Any:
    """`value` if it is a positive finite number (or zero, where allowed), or a tensor of such; ValueError otherwise."""
    if isinstance(value, Tensor):
        return positive(name, value, zero=zero)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (0 < value < math.inf or (zero and value == 0)):
        raise ValueError(f"{name} = {value!r} was given; a {'non-negative' if zero else 'positive'} finite number is wanted")
    return value


def step_size(name: str, value: float) -> float:
    """`value` if it is a positive finite Python number; ValueError otherwise."""
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not (0 < value < math.inf):
        raise ValueError(f"{name} = {value!r} was given; a positive finite number of seconds is wanted")
    return float(value)
