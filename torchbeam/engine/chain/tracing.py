"""Tracing of local functions, with the shapes of the fields that they take."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from ..compiler.function import Function
from ..compiler.trace import trace
from .chain_constants import flattened
from .local_functions import LocalFunctions
from .local_problem import INELASTIC, INTERNAL
from .method_functions import OTHER
from .sorts import Sort

Shapes = dict[str, tuple[int, ...]]
Traced = dict[tuple, Function]  # by their names, kinds and shapes
# functions that ask loads, and so what users wrote
OF_LOADS = ("node", "balance", "transposed_interaction", "finished")


class Tracing:
    """shapes: of the states' and unknowns' fields; constants: of those of each record; node,
    element: see `of`; known: functions of the same trees that were
    traced before, and are not traced again, to which those that are traced now are added.
    """

    def __init__(self, local: LocalFunctions, known: Traced) -> None:
        self.local, self.known, self.like = local, known, local.model.length.detach()
        space = local.model.space
        p, s, k = space.dims.position, space.dims.spin, space.dims.strain
        q = space.identity(self.like.new_zeros(p)).shape[-1]
        self.shapes: Shapes = {
            "position": (p,),
            "rotation": (q,),
            "velocity": (p,),
            "spin": (s,),
            "u": (p,),
            "m": (q,),
            "stress": (local.order, k),
        }
        if INTERNAL in local.state:
            self.shapes[INTERNAL] = (sum(local.internal),)
        if INELASTIC in local.element_state:
            self.shapes[INELASTIC] = (local.order, local.model.law.arms.count * k)
        ends = {f"{OTHER}{name}": shape for name, shape in self.shapes.items()}
        states = *local.state, *local.element_state
        self.shapes |= {name: shape for name, shape in ends.items() if name in states}
        self.shapes |= {"acceleration": (2 * (p + s),), "straining": (local.order, 2 * k)}
        self.constants = {
            kind: {
                f"{kind}.{i}": tuple(x.shape[x.ndim - axes + (kind != "common") :])
                for i, (x, axes) in enumerate(flattened(tree))
            }
            for kind, tree in local.trees.by_record.items()
        }
        elements = zip(flattened(local.trees.element), local.element_rows, strict=True)
        self.constants["element"] = {
            f"element.{i}": (rows, *x.shape[x.ndim - axes + 1 :])
            for i, ((x, axes), rows) in enumerate(elements)
        }
        tensors = {
            **self.constants["node"],
            **{name: self.shapes[name] for name in (*local.state, "u", "m")},
            **self.constants["support"],
        }
        support = {"found": (p + s,), "last": (p + s,)} if local.trees.support is not None else {}
        self.node = {**tensors, **self.constants["common"], **support}
        self.element = {
            **self.constants["element"],
            **self.constants["common"],
            **{name: self.shapes[name] for name in ("stress", *local.element_state)},
            **{f"{side}.{name}": shape for side in local.sides for name, shape in tensors.items()},
        }
        self.end = tensors | {"free": (p + s,), "reaction": (p + s,)}
        tensors = [x for captured in local.trees.common.captured for x, _ in flattened(captured)]
        self.captured = {
            f"common.{i}": x
            for i, (x, _) in enumerate(flattened(local.trees.common))
            if any(x is y for y in tensors)
        }

    def of(self, sort: Sort) -> Shapes:
        """All that a function of such a row may read."""
        if sort.functions is None:
            return getattr(self, sort.constants)
        ends = {f"{side}.{name}": shape for side in sort.sides for name, shape in self.end.items()}
        shapes = self.constants[sort.constants] | self.constants["common"]
        return shapes | sort.functions.fields(self.local.model) | ends

    def __call__(self, function: Callable, shapes: Shapes) -> Function:
        """The function of fields of these shapes, without those that it does not read."""
        function = partial(function)  # of one, the same
        func, named = function.func, tuple(sorted(function.keywords.items()))
        key = func.__qualname__, function.args, named, tuple(shapes.items())
        if key not in self.known:
            captured = self.captured if func.__name__ in OF_LOADS else {}
            self.known[key] = self._traced(function, shapes, captured)
        return self.known[key].copied()  # in a graph of its own, that grows

    def _traced(self, function: Callable, shapes: Shapes, captured: dict[str, Tensor]) -> Function:
        generator = torch.Generator().manual_seed(0)
        given = {
            name: torch.rand(shape, generator=generator, dtype=self.like.dtype)
            for name, shape in shapes.items()
        }
        traced = trace(function, given, {name: x for name, x in captured.items() if name in shapes})
        return traced.only(traced.outputs)
