"""Replacement of batch members in trees of dataclasses, without building or checking these again."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass
from typing import Any

from torch import Tensor

from torchbeam import ExplicitStepper, Stepper

FORGOTTEN = ("iterations",)  # of a stepper: what it says about its last step


def replaced(old: Any, new: Any, rows: Tensor, count: int) -> Any:
    """`old`, a tree whose tensors have the batch axis (count,), with its members `rows` (k,) taken from `new`, (k,).

    Trees are dataclasses, tuples, dicts and steppers. Tensors of the same shape in both have no batch axis and stay; so does
    all that is not a tensor. With k = count the new tree is the answer. Out of place; gradients of both survive.

    Raises ValueError where two tensors do not fit.
    """
    return new if len(rows) == count else _replaced(old, new, rows, count, {})


def _replaced(old: Any, new: Any, rows: Tensor, count: int, known: dict[int, Any]) -> Any:
    if old is new or old is None:
        return old
    if isinstance(old, Tensor):
        if old.shape == new.shape:
            return old
        if old.shape != (count, *new.shape[1:]):
            raise ValueError(f"a tensor of shape {tuple(new.shape)} was given for {len(rows)} rows of {tuple(old.shape)}")
        return old.index_copy(0, rows, new)
    if isinstance(old, dict):
        return {name: _replaced(value, new[name], rows, count, known) for name, value in old.items()}
    if isinstance(old, tuple):
        parts = [_replaced(a, b, rows, count, known) for a, b in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    if is_dataclass(old) and not isinstance(old, type):
        names = [f.name for f in fields(old)]
    elif isinstance(old, (Stepper, ExplicitStepper)):
        names = [name for name in vars(old) if name not in FORGOTTEN]
    else:
        return old
    if id(old) not in known:  # what a tree holds twice (a scene) is made once
        result = copy.copy(old)
        vars(result).clear()  # and with it what was cached
        vars(result).update({name: _replaced(getattr(old, name), getattr(new, name), rows, count, known) for name in names})
        known[id(old)] = result
    return known[id(old)]
