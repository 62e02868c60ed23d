"""Arguments of `StripAir`: numbers along the beam, wind, what polars return."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.declared import real_numbers
from ...core.functions_of_time import taken
from ...core.leaves import Tree
from ...core.validation import concrete, refusal
from .values import load_value

SLENDER = 1e-6  # of the largest chord, in the place of one that vanishes at a tip


def numbers_along(name: str, value: Any) -> Any:
    """Numbers for all (..., 1), for each element or for each node; or a function of s."""
    if callable(value):
        return check_function(name, value, "s")
    value = real_numbers(name, value)
    return value if value.ndim else value[None]


def chord_along(name: str, value: Any) -> Any:
    """The same, not 0 everywhere."""
    value = numbers_along(name, value)
    if not callable(value) and not concrete(torch.as_tensor(value != 0)).any(-1).all():
        raise refusal(f"{name} of 0", "a chord other than 0")
    return value


def not_vanishing(chord: Tensor) -> Tensor:
    """Chords (..., sites), `SLENDER` of the largest more where they are 0: lags in semichords of
    travel ask for one.
    """
    return chord + (chord == 0) * (SLENDER * chord.abs().amax(-1, keepdim=True))


def coefficients(value: Any, like: Tensor) -> list[Tensor]:
    """Lift, drag and moment (..., sites) that a polar returned; ValueError for other than three."""
    try:
        several = [*value]
    except TypeError:
        several = [value]
    if len(several) != 3:
        count = "one coefficient" if len(several) == 1 else f"{len(several)} coefficients"
        raise refusal(f"a polar that returns {count}", "one of lift, drag and moment")
    return [taken("a polar's coefficient", x, like) for x in several]


def wind_value(name: str, value: Any) -> Any:
    """Wind, checked: a field, a function of place and time, or what a load's value may be."""
    if isinstance(value, Tree) and hasattr(value, "velocity"):
        return value
    if callable(value) and of_place(value):
        return check_function(name, value, "position", "t")
    return load_value(name, value)


def of_place(function: Callable[..., Any]) -> bool:
    """Whether a function takes two arguments, place and time."""
    try:
        inspect.signature(function).bind(None, None)
    except (TypeError, ValueError):
        return False
    return True


def axes_of(value: Any, axes: int) -> int | None:
    """Own axes of a leaf that may be a function of the motion, which has none that are known."""
    return None if callable(value) and not isinstance(value, Tree) else axes
