"""Checks of a tree's fields, declared where the fields are: `leaf(0, positive=True)`.

A check takes what sentences call a value, and the value; it gives what the field then holds, or
raises ValueError in one sentence. `Tree` runs those of its fields when an object is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .validation import Value, as_tensor, axis_last, common_dtype, has_dtype, numbers, refusal
from .validation import finite as check_finite
from .validation import positive as check_positive

CHECK, NAME = "check", "name"  # keys of a field's metadata
Check = Callable[[str, Any], Any]


def declaration(
    check: Check | None,
    name: str | None,
    *,
    finite: bool = False,
    nonnegative: bool = False,
    positive: bool = False,
    size: int | tuple[int, ...] = (),
    copied: bool = False,
) -> dict[str, Any]:
    """What is declared of a field, see `leaf`, for its metadata."""
    size = (size,) if isinstance(size, int) else size
    wanted = finite or nonnegative or positive or size or copied
    if check is not None and wanted:
        raise TypeError("a check and what numbers must be were declared of a field; one is wanted")
    if positive or nonnegative:
        check = partial(_signed, size=size, zero=not positive, copied=copied)
    elif wanted:
        check = partial(_finite, size=size, copied=copied)
    return {} if check is None else {CHECK: check, NAME: name}


def _signed(name: str, value: Value, size: tuple[int, ...], zero: bool, copied: bool) -> Any:
    value = sized(name, parameter(name, value, zero=zero), size)
    return own(value) if copied else value


def _finite(name: str, value: Value, size: tuple[int, ...], copied: bool) -> Any:
    value = real_numbers(name, value, *size)
    return own(value) if copied else value


def sized(name: str, value: Tensor | np.ndarray, size: tuple[int, ...]) -> Tensor | np.ndarray:
    """`value` if its last axes have this size; ValueError otherwise."""
    if size:
        axis_last(name, value, size[-1])
    if size[1:] and tuple(value.shape[-len(size) :]) != size:
        wanted = ", ".join(map(str, size))
        raise refusal(f"{name} of shape {tuple(value.shape)}", f"(..., {wanted})")
    return value


def real_numbers(name: str, value: Value, *size: int) -> Tensor | np.ndarray:
    """Finite numbers, in their last axes as many as `size`; ValueError otherwise."""
    value = sized(name, plain(value), size)
    check_finite(name, torch.as_tensor(value))
    return value


def check_fields(tree: Any) -> None:
    """Checks the declared fields of a tree in order. One whose default is None may be left out."""
    for field, name, check, optional in _declared(type(tree)):
        value = getattr(tree, field)
        if value is None and optional:
            continue
        held = check(name, value)
        if held is not value:
            object.__setattr__(tree, field, held)


@cache
def _declared(kind: Any) -> tuple[tuple[str, str, Check, bool], ...]:
    """Of a class's checked fields: name, name in sentences, check, whether None is nothing."""
    declared = []
    for field in fields(kind):
        if CHECK in field.metadata:
            name = (field.metadata[NAME] or kind.in_words).format(kind.called, field.name)
            declared.append((field.name, name, field.metadata[CHECK], field.default is None))
    return tuple(declared)


def one_of(tree: Any, *names: str) -> None:
    """ValueError where none of these fields is there."""
    if all(getattr(tree, name) is None for name in names):
        raise refusal(f"{tree.called} with neither {' nor '.join(names)}", "one of them")


def together(tree: Any, *pairs: tuple[str, str]) -> None:
    """ValueError where one of a pair of fields is there alone."""
    for pair in pairs:
        there = [name for name in pair if getattr(tree, name) is not None]
        if len(there) == 1:
            raise ValueError(
                f"a {tree.called} with {there[0]} alone was given; {pair[0]} and {pair[1]} are "
                "wanted together"
            )


def plain(value: Value) -> Tensor | np.ndarray:
    """A tensor, NumPy's floating numbers and a sequence that holds tensors as a tensor of float64,
    and plain numbers as an array. Raises ValueError for what is no real number.
    """
    return as_tensor(value, *common_dtype(value)) if has_dtype(value) else numbers(value)


def own(value: Tensor | np.ndarray) -> Tensor | np.ndarray:
    """A copy, of which other numbers are made: what is written to the value later is not in it."""
    return value.clone() if isinstance(value, Tensor) else value.copy()


def parameter(name: str, value: Value, *, zero: bool = True) -> Tensor | np.ndarray:
    """A number (...) that may not be negative (nor zero, without `zero`); ValueError otherwise.

    Examples:
        >>> extend.parameter("Spring's stiffness", torch.tensor(2.0))
        tensor(2.)
    """
    value = plain(value)
    check_positive(name, torch.as_tensor(value), zero=zero)
    return value


def optional(name: str, value: Value | None) -> Tensor | np.ndarray | None:
    """The same, or None where it is absent: not given, or the plain number 0. A tensor is always
    there. (None stays None where an effect that a scene has bound to tensors is made again by
    `dataclasses.replace`; a 0 would have become a tensor.)
    """
    value = None if value is None else parameter(name, value)
    return value if isinstance(value, Tensor) or (value is not None and value.any()) else None
