"""Arguments of `StripAir`: numbers along the beam, wind."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import torch

from ...core.arguments import function as check_function
from ...core.declared import real_numbers
from ...core.leaves import Tree
from ...core.validation import refusal
from .values import load_value


def numbers_along(name: str, value: Any) -> Any:
    """Numbers for all (..., 1), for each element or for each node; or a function of s."""
    if callable(value):
        return check_function(name, value, "s")
    value = real_numbers(name, value)
    return value if value.ndim else value[None]


def chord_along(name: str, value: Any) -> Any:
    """The same, none of them 0."""
    value = numbers_along(name, value)
    if not callable(value) and not torch.as_tensor(value).all():
        raise refusal(f"{name} of 0", "a chord other than 0")
    return value


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
