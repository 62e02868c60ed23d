"""Inputs of a scene: values by name, or side by side, as tensors."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from ..core.arguments import function as check_function
from ..core.validation import as_tensor, axis_last, broadcast, refusal, shown
from .effects import Inputs


def input_tensors(scene: Any, given: dict[str, Any] | None) -> Inputs:
    """Inputs as tensors, by name or in a dictionary inputs={...}, which has room for names that
    are keywords of a function; None = there are none. Raises ValueError where one is missing,
    unknown, of the wrong size, or of axes that do not broadcast.
    """
    given = {} if given is None else given
    if not isinstance(given, dict):
        raise refusal(f"inputs = {shown(given)}", "a dictionary of values by name")
    if isinstance(given.get("inputs"), dict):
        others = {name: value for name, value in given.items() if name != "inputs"}
        given = merge_inputs(given["inputs"], others)
    sizes, dtype, device = scene.inputs, scene.dtype, scene.device
    for name in given:
        if name not in sizes:
            raise ValueError(
                f"the input {name!r} was given; the scene has {', '.join(sizes) or 'none'}"
            )
    for name in sizes:
        if name not in given:
            wanted = ", ".join(f"{other!r}: {size} numbers" for other, size in sizes.items())
            raise ValueError(
                f"the input {name!r} is missing; inputs={{{wanted}}} is wanted".replace(
                    ": 1 numbers", ": 1 number"
                )
            )
    tensors = {}
    for name, value in given.items():
        value = as_tensor(value, dtype, device)
        # a number for an input of one
        value = value[None] if value.ndim == 0 and sizes[name] == 1 else value
        tensors[name] = axis_last(f"input {name!r}", value, sizes[name])
    if tensors:
        lead = (value.shape[:-1] for value in tensors.values())
        broadcast("a scene and inputs", scene.batch_shape, *lead)
    return tensors


def by_name(scene: Any, u: Tensor | dict[str, Any] | None) -> dict[str, Any] | None:
    """Inputs u (..., m) side by side, in the scene's order, by name; those by name, and None, as
    they are. Raises ValueError for another m.
    """
    if u is None or isinstance(u, dict):
        return u
    sizes = scene.inputs
    whole = axis_last("u", as_tensor(u, scene.dtype, scene.device), sum(sizes.values()))
    return dict(zip(sizes, whole.split(tuple(sizes.values()), -1), strict=True))


def merge_inputs(inputs: Any, more: dict[str, Any]) -> dict[str, Any]:
    """A scene's inputs by name (None = none), and more of them. Raises ValueError where there are
    no names, or a name comes twice.
    """
    inputs = {} if inputs is None else inputs
    if not isinstance(inputs, dict):
        raise refusal(f"inputs of type {type(inputs).__name__}", "a dictionary of values by name")
    for name in more:
        if name in inputs:
            raise ValueError(f"the input {name!r} was given twice; once is wanted")
    whole = {**inputs, **more}
    for name, value in whole.items():
        if callable(value):
            check_function(f"the input {name!r}", value, "t")
    return whole
