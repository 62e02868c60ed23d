"""Arguments of `StripAir`: lags, numbers along the beam, wind."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import torch

from ...core.arguments import function as check_function
from ...core.declared import real_numbers
from ...core.leaves import Tree
from ...core.validation import refusal, shown
from .values import load_value

# shares and rates (per semichord travelled) of what is late of Wagner's function, by which lift
# follows a section's motion (Jones 1940), and of Kuessner's, by which it follows a gust that the
# section enters (Bisplinghoff, Ashley and Halfman 1955, section 5-7)
LAGS = {"wagner": ((0.165, 0.0455), (0.335, 0.3)), "kussner": ((0.5, 0.13), (0.5, 1.0))}


def delays(name: str, value: Any) -> tuple[tuple[float, float], ...] | None:
    """Lags as pairs of share and rate, checked."""
    if value is None or (isinstance(value, str) and value in LAGS):
        return LAGS.get(value)
    wanted = 'None, "wagner", "kussner" or pairs (share, rate) of positive numbers'
    try:
        pairs = tuple((float(share), float(rate)) for share, rate in value)
    except (TypeError, ValueError):
        raise refusal(f"{name} = {shown(value)}", wanted) from None
    if not all(share > 0 and 0 < rate < math.inf for share, rate in pairs) or (
        sum(share for share, _ in pairs) > 1
    ):
        raise refusal(f"{name} = {shown(value)}", f"{wanted}, shares of 1 in all at most,")
    return pairs


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
