"""Evaluation of a function in torch: vectorised over leading axes, differentiable; what native code
is tested against.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchbeam.engine.compiler.function import Function
from torchbeam.math.shapes import broadcast_shapes


def _norm(square: Tensor) -> Tensor:
    none = square == 0
    return torch.where(none, 0.0, torch.where(none, torch.ones_like(square), square).sqrt())


def _extreme(
    binary: Callable[[Tensor, Tensor], Tensor], reduced: Callable[..., Tensor]
) -> Callable[..., Tensor]:
    return lambda *x: (
        binary(*x) if len(x) == 2 else reduced(torch.stack(torch.broadcast_tensors(*x), -1), -1)
    )


def _pick(place: Tensor, *xs: Tensor) -> Tensor:
    place, *xs = torch.broadcast_tensors(place, *xs)
    return torch.gather(torch.stack(xs, -1), -1, place.long()[..., None])[..., 0]


# fmt: off
OPERATIONS: dict[str, Callable[..., Tensor]] = {
    "add": torch.add, "sub": torch.sub, "mul": torch.mul, "div": torch.div, "neg": torch.neg,
    "sqrt": torch.sqrt, "norm": _norm,
    "sin": torch.sin, "cos": torch.cos, "atan2": torch.atan2, "exp": torch.exp, "log": torch.log,
    "tanh": torch.tanh,
    **{name: getattr(torch, name) for name in ("abs", "expm1", "log1p", "sinh", "cosh", "asinh",
                                               "acosh", "atanh", "erf",
                                               "erfc", "pow")},
    "floor": torch.floor, "round": torch.round, "max": _extreme(torch.maximum, torch.amax),
    "min": _extreme(torch.minimum, torch.amin), "lt": torch.lt, "le": torch.le, "eq": torch.eq,
    "and": torch.logical_and,
    "or": torch.logical_or, "not": torch.logical_not, "select": torch.where,
    "exponent": lambda x: torch.frexp(x).exponent.to(x.dtype) - 1,
    "mantissa": lambda x: 2 * torch.frexp(x).mantissa,
    "power2": lambda x: torch.ldexp(torch.ones_like(x), x), "stop": lambda x: x,
    "pick": _pick,
}
# fmt: on


def evaluate(function: Function, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
    """Fields (..., *shape) -> fields (..., *shape), leading axes broadcast; in the inputs' dtype.
    Truth values come as bool.
    """
    graph, leads, parts = function.graph, [], {}
    like = next(iter(inputs.values()))
    for name, shape in function.inputs.items():
        x = inputs[name]
        lead = x.shape[: x.ndim - len(shape)]
        if x.shape[len(lead) :] != torch.Size(shape):
            raise ValueError(
                f"{name} of the shape {tuple(x.shape)} was given; {shape} behind leading axes is "
                "wanted"
            )
        leads.append(lead)
        parts[name] = x.reshape(*lead, -1).unbind(-1)
    lead, values = broadcast_shapes(*leads), {}
    for node in function.live():
        op, value = graph.ops[node], graph.values[node]
        if op == "const":
            values[node] = torch.tensor(
                value, dtype=torch.bool if graph.truths[node] else like.dtype, device=like.device
            )
        elif op == "input":
            values[node] = parts[value[0]][value[1]]
        else:
            values[node] = OPERATIONS[op](*(values[x] for x in graph.args[node]))
    results = {}
    for name, out in function.outputs.items():
        same = all(graph.truths[x] for x in out.nodes)
        rows = [values[x] if same else values[x].to(like.dtype) for x in out.nodes]
        rows = torch.stack([x.expand(lead) for x in rows], -1) if rows else like.new_zeros(*lead, 0)
        results[name] = rows.reshape((*lead, *out.shape))
    return results


def fields(value, name=""):
    """Tensors of what a function returns, by their names in a trace."""
    if isinstance(value, torch.Tensor):
        return {name or "out": value}
    pairs = (
        value.items()
        if isinstance(value, dict)
        else zip(getattr(value, "_fields", range(len(value))), value, strict=True)
    )
    return {
        k: v
        for key, part in pairs
        if part is not None
        for k, v in fields(part, f"{name}.{key}".strip(".")).items()
    }
