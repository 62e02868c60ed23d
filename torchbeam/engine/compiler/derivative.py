"""Derivatives of functions on their graphs: products of the Jacobian with cotangents (vjp) and with
tangents (jvp).

What is piecewise has the derivative that torch gives it: of select that of the chosen branch, of
max and min equal shares among equal arguments, of abs, norm and atan2 0 at 0, of floor, round,
comparisons and stop 0. (Griewank and Walther 2008, chapter 3.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

from .function import Function, Output
from .graph import Graph

Linear = Callable[[int], int]  # of a scalar: the same forward and backward


def _over(root: bool, sign: str, shift: float) -> Callable[[Graph, int, int, int], int]:
    """v / (shift +- x^2), or by its root."""

    def scaled(g: Graph, v: int, x: int, node: int) -> int:
        square = g.make(
            sign,
            *((g.const(shift), g.make("mul", x, x)) if shift > 0 else (g.make("mul", x, x), g.one)),
        )
        return g.make("div", v, g.make("sqrt", square) if root else square)

    return scaled


def _bell(sign: float) -> Callable[[Graph, int, int, int], int]:
    return lambda g, v, x, node: g.make(
        "mul",
        v,
        g.make(
            "mul",
            g.const(sign * 2 / math.sqrt(math.pi)),
            g.make("exp", g.make("neg", g.make("mul", x, x))),
        ),
    )


# operations of one number: v times the derivative at x, where the operation gives `node`
SMOOTH: dict[str, Callable[[Graph, int, int, int], int]] = {
    "exp": lambda g, v, x, node: g.make("mul", v, node),
    "log": lambda g, v, x, node: g.make("div", v, x),
    "expm1": lambda g, v, x, node: g.make("mul", v, g.make("add", node, g.one)),
    "log1p": lambda g, v, x, node: g.make("div", v, g.make("add", x, g.one)),
    "tanh": lambda g, v, x, node: g.make("mul", v, g.make("sub", g.one, g.make("mul", node, node))),
    "sinh": lambda g, v, x, node: g.make("mul", v, g.make("cosh", x)),
    "cosh": lambda g, v, x, node: g.make("mul", v, g.make("sinh", x)),
    "asinh": _over(True, "add", 1.0),
    "acosh": _over(True, "sub", -1.0),
    "atanh": _over(False, "sub", 1.0),
    "erf": _bell(1.0),
    "erfc": _bell(-1.0),
}


def bar(field: str) -> str:
    """The field of a cotangent."""
    return f"{field}_bar"


def dot(field: str) -> str:
    """The field of a tangent."""
    return f"{field}_dot"


def vjp(function: Function, wrt: Iterable[str], of: Iterable[str] | None = None) -> Function:
    """The inputs of `function` and the cotangents bar(name) of the outputs `of`
    (default: all) -> bar(name) of each input in `wrt`, the gradient. Inputs that no gradient
    depends on stay among the inputs.
    """
    graph, of, wrt = function.graph, tuple(function.outputs if of is None else of), tuple(wrt)
    active = _active(function, wrt)
    bars: dict[int, int] = {}
    for name in of:
        for k, node in enumerate(function.outputs[name].nodes):
            if node in active:
                bars[node] = graph.make(
                    "add", bars.get(node, graph.zero), graph.input(bar(name), k)
                )
    for node in sorted(active, reverse=True):
        if node in bars:
            for x, scale in partials(graph, node):
                if x in active:
                    bars[x] = graph.make("add", bars.get(x, graph.zero), scale(bars[node]))
    outputs = {
        bar(name): Output(
            function.inputs[name], tuple(bars.get(x, graph.zero) for x in function.components(name))
        )
        for name in wrt
    }
    return Function(
        graph,
        {**function.inputs, **{bar(name): function.outputs[name].shape for name in of}},
        outputs,
    )


def jvp(function: Function, wrt: Iterable[str], of: Iterable[str] | None = None) -> Function:
    """The inputs of `function` and the tangents dot(name) of those in `wrt` -> dot(name) of each
    output in `of`.
    """
    graph, of, wrt = function.graph, tuple(function.outputs if of is None else of), tuple(wrt)
    active = _active(function, wrt)
    dots = {
        x: graph.input(dot(name), k)
        for name in wrt
        for k, x in enumerate(function.components(name))
    }
    for node in sorted(active - set(dots)):
        dots[node] = graph.total(
            scale(dots[x]) for x, scale in partials(graph, node) if x in active
        )
    outputs = {
        dot(name): Output(
            function.outputs[name].shape,
            tuple(dots.get(x, graph.zero) for x in function.outputs[name].nodes),
        )
        for name in of
    }
    return Function(
        graph, {**function.inputs, **{dot(name): function.inputs[name] for name in wrt}}, outputs
    )


def _active(function: Function, wrt: tuple[str, ...]) -> set[int]:
    """Numbers that depend on the inputs `wrt`, these among them."""
    graph = function.graph
    active = {x for name in wrt for x in function.components(name)}
    for node in function.live():
        if graph.truths[node] or graph.ops[node] == "stop":
            continue
        if any(x in active for x in graph.args[node]):
            active.add(node)
    return active


def partials(graph: Graph, node: int) -> Iterator[tuple[int, Linear]]:
    """(argument, multiplication by the derivative with respect to it) of an operation."""
    op, args, make = graph.ops[node], graph.args[node], graph.make
    if op in ("add", "sub"):
        yield args[0], lambda v: v
        yield args[1], (lambda v: v) if op == "add" else lambda v: make("neg", v)
    elif op == "mul":
        yield args[0], lambda v: make("mul", v, args[1])
        yield args[1], lambda v: make("mul", v, args[0])
    elif op == "div":
        yield args[0], lambda v: make("div", v, args[1])
        yield args[1], lambda v: make("neg", make("mul", make("div", v, args[1]), node))
    elif op == "neg":
        yield args[0], lambda v: make("neg", v)
    elif op == "sqrt":
        yield args[0], lambda v: make("mul", graph.const(0.5), make("div", v, node))
    elif op == "norm":
        none = make("eq", node, graph.zero)
        yield (
            args[0],
            lambda v: make(
                "select", none, graph.zero, make("mul", graph.const(0.5), make("div", v, node))
            ),
        )
    elif op == "sin":
        yield args[0], lambda v: make("mul", v, make("cos", args[0]))
    elif op == "cos":
        yield args[0], lambda v: make("neg", make("mul", v, make("sin", args[0])))
    elif op in SMOOTH:
        yield args[0], lambda v: SMOOTH[op](graph, v, args[0], node)
    elif op == "pow":
        x, y = args
        none = make("eq", y, graph.zero)
        at_zero = make("and", make("eq", x, graph.zero), make("le", graph.zero, y))
        yield (
            x,
            lambda v: make(
                "select",
                none,
                graph.zero,
                make("mul", v, make("mul", y, make("pow", x, make("sub", y, graph.one)))),
            ),
        )
        yield (
            y,
            lambda v: make(
                "select", at_zero, graph.zero, make("mul", v, make("mul", node, make("log", x)))
            ),
        )
    elif op == "atan2":
        y, x = args
        square = graph.dot((y, x), (y, x))
        square = make("select", make("eq", square, graph.zero), graph.one, square)
        yield y, lambda v: make("div", make("mul", v, x), square)
        yield x, lambda v: make("neg", make("div", make("mul", v, y), square))
    elif op == "abs":
        minus, none = make("lt", args[0], graph.zero), make("eq", args[0], graph.zero)
        yield (
            args[0],
            lambda v: make("select", none, graph.zero, make("select", minus, make("neg", v), v)),
        )
    elif op == "select":
        yield args[1], lambda v: make("select", args[0], v, graph.zero)
        yield args[2], lambda v: make("select", args[0], graph.zero, v)
    elif op == "pick":
        for k, x in enumerate(args[1:]):
            chosen = make("eq", args[0], graph.const(float(k)))
            yield x, lambda v, chosen=chosen: make("select", chosen, v, graph.zero)
    elif op in ("max", "min"):
        taken = [make("eq", x, node) for x in args]
        count = graph.total(graph.number(x) for x in taken)
        for x, chosen in zip(args, taken, strict=True):
            yield (
                x,
                lambda v, chosen=chosen: make("select", chosen, make("div", v, count), graph.zero),
            )
    elif op in ("exponent", "mantissa", "power2"):
        raise NotImplementedError(
            f"{op} was differentiated; it is for functions that are already lowered"
        )
