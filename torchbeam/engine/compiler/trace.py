"""Tracing: an ordinary function of torch tensors becomes a graph of scalar operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from ...core.functions_of_time import beside_hooks
from .arrays import UNKNOWN
from .elementwise import array
from .function import Function, Output
from .readings import NotTraceable, Readings, memory
from .tracer import Tracer


def trace(
    function: Callable[..., Any],
    inputs: dict[str, Tensor],
    captured: dict[str, Tensor] | None = None,
) -> Function:
    """Trace `function(**inputs)` as a graph. Shapes and dtype of the inputs matter; values matter
    only if the function refuses some. The function returns a tensor (field "out"), or tensors in
    dictionaries and (named) tuples. Their fields have keys, names and places as names, joined by
    dots; None is left out.

    Tensors that do not come from inputs are constants: their values are read. Operations on
    constants alone run at once, in the inputs' dtype by default. Hooks on saved tensors
    (torch.utils.checkpoint) do not change the graph; the function does not see them.

    Args:
        captured: name of an input -> tensor that the function reads beside its arguments; it then
            reads this input instead. An input of fewer axes stands for a sample of it: it is read
            with axes of 1 in place of the missing ones

    Raises:
        NotTraceable: for an unknown operation, for control flow by traced values or reading them,
            and for a constant that carries gradient, which would be lost.

    Examples:
        >>> function = extend.trace(lambda x: x * x + 1, {"x": torch.ones(2)})
        >>> function.operations(), list(function.outputs)
        (4, ['out'])
    """
    captured = captured or {}
    names = set(inputs)
    read = {name: x[(0,) * (x.ndim - inputs.get(name, x).ndim)] for name, x in captured.items()}
    inputs = inputs | read
    given = {
        name: value.detach().clone(memory_format=torch.contiguous_format)
        for name, value in inputs.items()
    }
    tracer = Tracer({memory(x) for x in captured.values()})
    stand = {
        id(x): given[name][(None,) * (x.ndim - given[name].ndim)] for name, x in captured.items()
    }
    for name, value in given.items():
        nodes = [tracer.graph.input(name, k) for k in range(value.numel())]
        tracer.hold(value, array(nodes, value.shape))

    def run() -> Any:
        with torch.no_grad(), Readings(tracer.traced, stand), tracer:
            return function(
                **{name: given[name] for name in inputs if name not in captured or name in names}
            )

    before = torch.get_default_dtype()
    floating = {
        value.dtype
        for name, value in given.items()
        if value.is_floating_point() and name not in captured
    }
    try:
        torch.set_default_dtype(floating.pop() if len(floating) == 1 else before)
        result = beside_hooks(run)
    finally:
        torch.set_default_dtype(before)
    outputs = {}
    for name, value in _fields(result, ""):
        if not isinstance(value, Tensor):
            raise NotTraceable(
                f"{type(value).__name__} was returned as {name!r}; tensors are wanted"
            )
        nodes = tracer.nodes(value)
        if (nodes == UNKNOWN).any():
            raise NotTraceable(
                f"the output {name!r} cannot be traced: it is an index, or a factorisation"
            )
        outputs[name] = Output(tuple(value.shape), tuple(nodes.ravel().tolist()))
    traced = Function(
        tracer.graph, {name: tuple(value.shape) for name, value in given.items()}, outputs
    )
    if any(tracer.graph.ops[x] == "factor" for x in traced.live()):
        raise NotTraceable("the factors of a matrix were read; what solves with them is wanted")
    return traced


def _fields(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """(name, tensor) of what a function returns."""
    if isinstance(value, (dict, tuple, list)):
        keys = (
            value.keys()
            if isinstance(value, dict)
            else getattr(value, "_fields", range(len(value)))
        )
        for key, part in zip(
            keys, value.values() if isinstance(value, dict) else value, strict=True
        ):
            yield from _fields(part, f"{name}.{key}" if name else str(key))
    elif value is not None:
        yield name or "out", value
