"""Parts of a scene, and changes of all of one kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

import torchbeam as tb

Parts = dict[str, Any]


class NotHere(Exception):
    """The scene has nothing that could be said so."""


def times(k: float, value: Any) -> Any:
    """k times whatever may be a load's value, or what a user's function answers."""
    if value is None or isinstance(value, Tensor | np.ndarray | float | int):
        return value if value is None else k * value
    if isinstance(value, tb.Input):
        raise NotHere
    if isinstance(value, tb.PerElement):
        return tb.PerElement(times(k, value.value))
    if isinstance(value, tb.Along):
        return tb.Along(times(k, value.function))
    if callable(value):
        return lambda *arguments, **named: times(k, value(*arguments, **named))
    return type(value)(times(k, v) for v in value)


def each(change: Callable[[Any], Any]) -> Callable[[Parts], Parts]:
    """`change(part)` of every effect, support, frame and root: something else, or the same."""

    def changed(parts: Parts) -> Parts:
        new = {
            name: tuple(map(change, parts[name]))
            if isinstance(parts[name], tuple)
            else parts[name] and change(parts[name])
            for name in ("effects", "supports", "frame", "root")
        }
        if all(
            a is b
            for name in new
            for a, b in zip(listed(new[name]), listed(parts[name]), strict=True)
        ):
            raise NotHere
        return {**parts, **new}

    return changed


def listed(x: Any) -> tuple:
    return x if isinstance(x, tuple) else (x,)
