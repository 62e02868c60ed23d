"""Validation of input to public functions: conversion to tensors, and errors of one sentence."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch._C import _functorch as functorch

Value = Any  # a tensor, a NumPy array or scalar, a Python number, or a (nested) sequence of them
NUMPY = (np.ndarray, np.generic)
BOOLEANS = (bool, np.bool_)
ROUNDING = 1e-6  # relative, of moments of inertia
LONGEST = 80  # characters of what was given, in a sentence about it


def common_dtype(*values: Value) -> tuple[torch.dtype, torch.device]:
    """dtype and device of the floating tensors and NumPy arrays and scalars among `values`; the default dtype on the CPU where
    there is none: Python numbers and whole numbers have no dtype of their own.

    Raises ValueError where different floating dtypes or devices meet, and for other than single and double precision.
    """
    dtype, device = None, None
    for leaf in _leaves(values):
        if isinstance(leaf, NUMPY):
            own = numpy_dtype(leaf)
        else:
            own = leaf.dtype if leaf.is_floating_point() or leaf.is_complex() else None
            if device not in (None, leaf.device):
                raise ValueError(f"tensors on {device} and {leaf.device} were given; one device is wanted")
            device = leaf.device
        if own is not None and dtype not in (None, own):
            raise ValueError(f"numbers of dtype {dtype} and {own} were given; one dtype is wanted")
        dtype = own or dtype
    return precision(dtype or torch.get_default_dtype()), device or torch.device("cpu")


def precision(dtype: torch.dtype) -> torch.dtype:
    """`dtype` if it is float32 or float64; ValueError otherwise."""
    if dtype not in (torch.float32, torch.float64):
        raise ValueError(f"{dtype} was given; torch.float32 or torch.float64 is wanted")
    return dtype


def numpy_dtype(value: np.ndarray | np.generic) -> torch.dtype | None:
    """torch's dtype of a floating NumPy array or scalar, None of whole and `Plain` numbers; or NumPy's own."""
    own = value.dtype.kind in "fc" and not isinstance(value, Plain)
    return getattr(torch, value.dtype.name, value.dtype) if own else None


def as_tensor(value: Value, dtype: torch.dtype, device: torch.device | None = None) -> Tensor:
    """`value` as a tensor of the given dtype. A (nested) sequence that holds tensors is stacked, so that gradients survive:
    its axes come last, those of the tensors in it are batch axes. NumPy's arrays are copied.

    Raises ValueError for what is no real number: text, None, booleans, complex numbers, rows of different lengths.
    """
    if holds_tensor(value):
        parts = [as_tensor(v, dtype, device) for v in value]
        broadcast("a sequence of tensors", *(part.shape for part in parts))
        return torch.stack(torch.broadcast_tensors(*parts), -_depth(value))
    if isinstance(value, Tensor):
        return real(value).to(dtype=dtype, device=device)
    return torch.from_numpy(numbers(value)).to(dtype=dtype, device=device)


def real(value: Tensor) -> Tensor:
    """`value` if it holds real numbers; ValueError for booleans and complex numbers."""
    if value.dtype == torch.bool or value.is_complex():
        raise ValueError(f"a tensor of {value.dtype} was given; real numbers are wanted")
    return value


class Plain(np.ndarray):
    """Python numbers as an array: they take the dtype of what they meet, where another array of NumPy has its own."""


def numbers(value: Value) -> Plain:
    """Python or NumPy numbers as a new array of double precision. Raises ValueError for what is no real number."""
    try:
        array = np.array(value)
    except (TypeError, ValueError):
        array = np.array(None)
    if array.dtype.kind not in "fiu" or not array.size or any(isinstance(leaf, BOOLEANS) for leaf in _scalars(value)):
        raise ValueError(f"{shown(value)} was given; numbers or a tensor are wanted")
    return array.astype(np.float64, order="C").view(Plain)


def shown(value: Any) -> str:
    """`value` in one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def holds_tensor(value: Value) -> bool:
    """Whether `value` is a (nested) sequence with a tensor in it."""
    return isinstance(value, (list, tuple)) and any(isinstance(leaf, Tensor) for leaf in _leaves(value))


def has_dtype(value: Value) -> bool:
    """Whether there is a tensor, or a floating array or scalar of NumPy, in `value`: its dtype is then not for us to choose."""
    return any(isinstance(leaf, Tensor) or numpy_dtype(leaf) is not None for leaf in _leaves(value))


def _leaves(value: Value) -> Iterator[Tensor | np.ndarray | np.generic]:
    """Tensors and NumPy's arrays and scalars in a (nested) sequence."""
    return (leaf for leaf in _scalars(value) if isinstance(leaf, (Tensor, *NUMPY)))


def _scalars(value: Value) -> Iterator[Any]:
    if isinstance(value, (list, tuple)):
        for v in value:
            yield from _scalars(v)
    else:
        yield value


def _depth(value: Value) -> int:
    return 1 + max(map(_depth, value), default=0) if isinstance(value, (list, tuple)) else 0


def broadcast(what: str, *shapes: torch.Size) -> torch.Size:
    """Common broadcast shape; ValueError where there is none."""
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


def whole(name: str, value: int) -> int:
    """`value` if it is a whole number; ValueError otherwise."""
    if isinstance(value, BOOLEANS) or not isinstance(value, (int, np.integer)):
        raise ValueError(f"{name} = {shown(value)} was given; a whole number is wanted")
    return int(value)


def count(name: str, value: int, least: int = 1) -> int:
    """`value` if it is a whole number of at least `least`; ValueError otherwise."""
    if isinstance(value, BOOLEANS) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} = {shown(value)} was given; a whole number of at least {least} is wanted")
    return int(value)


def boolean(name: str, value: bool) -> bool:
    """`value` if it is True or False; ValueError otherwise."""
    if not isinstance(value, BOOLEANS):
        raise ValueError(f"{name} = {shown(value)} was given; True or False is wanted")
    return bool(value)


def choice(name: str, value: Any, known: Iterable[Any]) -> Any:
    """`value` if it is one of the `known` strings (or None, where that is one); ValueError otherwise."""
    if not isinstance(value, (str, type(None))) or value not in known:
        raise ValueError(f"{name} = {shown(value)} was given; {', '.join(map(repr, known))} are there")
    return value


def function(name: str, value: Any) -> Any:
    """`value` if it can be called; ValueError otherwise."""
    if not callable(value):
        raise ValueError(f"{name} = {shown(value)} was given; a function is wanted")
    return value


def instance(name: str, value: Any, wanted: type) -> Any:
    """`value` if it is an object of the class `wanted`, one of torchbeam's; ValueError otherwise."""
    if not isinstance(value, wanted):
        raise ValueError(f"{name} of type {type(value).__name__} was given; a torchbeam.{wanted.__name__} is wanted")
    return value


def number(name: str, value: Any, *, infinite: bool = False) -> float:
    """One real number, of Python, NumPy or a tensor, as Python's; ValueError otherwise, and for one that is not finite."""
    one = as_tensor(value, torch.float64) if value is not None else torch.empty(0)
    if one.ndim or not (torch.isfinite(one) or (infinite and torch.isinf(one))):
        raise ValueError(f"{name} = {shown(value)} was given; one {'' if infinite else 'finite '}number is wanted")
    return one.item()


def instant(name: str, value: Any, like: Tensor) -> Tensor:
    """A time (0-dim) s in the dtype and on the device of `like`; ValueError for what is not one finite number."""
    one = as_tensor(value, like.dtype, like.device)
    if one.ndim:
        raise ValueError(f"{name} of shape {tuple(one.shape)} was given; one instant is wanted")
    return finite(name, one)


def mask(name: str, value: Any, like: Tensor) -> Tensor:
    """Booleans (...) that broadcast with `like`, on its device; ValueError otherwise."""
    if not isinstance(value, Tensor) and all(isinstance(leaf, BOOLEANS) or getattr(leaf, "dtype", None) == np.bool_
                                             for leaf in _scalars(value)):
        value = torch.as_tensor(np.array(value), device=like.device)
    if not isinstance(value, Tensor) or value.dtype != torch.bool:
        given = f"of {value.dtype}" if isinstance(value, Tensor) else f"= {shown(value)}"
        raise ValueError(f"{name} {given} was given; booleans, one a sample, are wanted")
    if value.ndim > like.ndim or broadcast(f"{name} and samples", value.shape, like.shape) != like.shape:
        raise ValueError(f"{name} of shape {tuple(value.shape)} was given for samples of shape {tuple(like.shape)}; one a "
                         "sample is wanted")
    return value.to(like.device)


def rotations(name: str, value: Tensor) -> Tensor:
    """`value` (..., 3, 3) if its columns are right-handed and orthonormal, to 1e-5; ValueError otherwise."""
    if value.ndim < 2 or value.shape[-2:] != (3, 3):
        raise ValueError(f"{name} of shape {tuple(value.shape)} was given; (..., 3, 3) is wanted")
    R = concrete(finite(name, value)).detach()
    if ((R.mT @ R - torch.eye(3, dtype=R.dtype, device=R.device)).abs() > 1e-5).any():
        raise ValueError(f"{name} that are not orthonormal were given; rotation matrices are wanted")
    if (torch.linalg.det(R) < 0).any():
        raise ValueError(f"{name} with left-handed axes were given; right-handed ones are wanted")
    return value


def inertia(name: str, J: Tensor, size: Tensor) -> Tensor:
    """`J` (..., 3, 3) if it is the inertia of a body: no principal moment negative, none above the sum of the others, to 1e-6
    of `size` (...), that of the numbers it was made of; ValueError otherwise.
    """
    least, middle, most = torch.linalg.eigvalsh(concrete(J).detach()).unbind(-1)
    size = ROUNDING * torch.maximum(concrete(size).detach(), most)
    if (least < -size).any():
        raise ValueError(f"{name} with the principal moment {least.min().item():g} was given; none is negative")
    if (most > least + middle + size).any():
        raise ValueError(f"{name} with a principal moment above the sum of the two others was given; no body has such")
    return J


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
        return positive(name, real(value), zero=zero)
    if not _real(value) or not (0 < value < math.inf or (zero and value == 0)):
        wanted = "a non-negative" if zero else "a positive"
        raise ValueError(f"{name} = {shown(value)} was given; {wanted} finite number is wanted")
    return value


def step_size(name: str, value: float) -> float:
    """`value` if it is a positive finite Python number; ValueError otherwise."""
    if not _real(value) or not (0 < value < math.inf):
        raise ValueError(f"{name} = {shown(value)} was given; a positive finite number of seconds is wanted")
    return float(value)


def _real(value: Any) -> bool:
    """Whether this is a real number of Python or NumPy."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, BOOLEANS)


def duration(name: str, value: float | Tensor, dtype: torch.dtype, device: torch.device) -> Tensor:
    """`value` as a 0-dim tensor if it is a positive finite number or such a tensor; ValueError otherwise."""
    if not isinstance(value, Tensor):
        return torch.as_tensor(step_size(name, value), dtype=dtype, device=device)
    if value.ndim or value.is_complex() or value.dtype == torch.bool:
        raise ValueError(f"{name} of shape {tuple(value.shape)} and {value.dtype} was given; one number of seconds is wanted")
    return positive(name, value.to(dtype=dtype, device=device))
