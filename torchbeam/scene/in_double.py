"""Statics and spectra of scenes in single precision, in double: between the stiffnesses of
stretching and of bending lie more digits than float32 has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..core.functions_of_time import OtherPrecision
from ..core.leaves import Tree, sent
from ..core.warning import warn
from .scene import Scene

SINGLE = (
    "a scene in single precision with functions that take no other was given; it is solved in "
    "float32, where equilibria and the slowest modes may be lost to rounding"
)
NARROW = {torch.float64: torch.float32, torch.complex128: torch.complex64}


def in_double(function: Callable[..., Any], scene: Scene, state: Any, *given: Any) -> Any:
    """function(scene, state, *given); of a scene in float32 in double precision, what it returns
    rounded. Where the scene holds functions that take float32 alone it stays there, and a warning
    says so.
    """
    if scene.dtype != torch.float32:
        return function(scene, state, *given)
    wide = scene.to(torch.float64)
    start = None if state is None else state.to(torch.float64)
    try:
        return narrowed(function(wide, start, *map(widened, given)))
    except OtherPrecision:
        result = function(scene, state, *given)
    warn(SINGLE, UserWarning)
    return result


def widened(value: Any) -> Any:
    """Tensors, or a dictionary of them, in double precision."""
    if isinstance(value, dict):
        return {name: widened(x) for name, x in value.items()}
    return value.double() if isinstance(value, Tensor) and value.is_floating_point() else value


def narrowed(result: Any) -> Any:
    """A tree, or a dataclass that holds tensors, trees and others such, in single precision."""
    if isinstance(result, Tensor):
        return result.to(NARROW.get(result.dtype, result.dtype))
    if isinstance(result, Tree):
        return sent(result, torch.float32)
    if not is_dataclass(result):
        return result
    new = {f.name: narrowed(getattr(result, f.name)) for f in fields(result)}
    new = {name: value for name, value in new.items() if value is not getattr(result, name)}
    return replace(result, **new) if new else result
