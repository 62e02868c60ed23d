"""Splitting of a function: what depends on some inputs alone is computed once, before the rest."""

from __future__ import annotations

from collections.abc import Iterable

from .function import Function, Output
from .graph import Graph

HOISTED = "hoisted"  # the field that is handed over
CHEAP = {
    "add",
    "sub",
    "mul",
    "neg",
    "abs",
    "lt",
    "le",
    "eq",
    "and",
    "or",
    "not",
    "select",
    "max",
    "min",
    "stop",
}


def split(function: Function, fixed: Iterable[str]) -> tuple[Function, Function]:
    """(before, rest): `before` takes the inputs `fixed` and gives one field, `HOISTED`, of what the
    rest needs of them; `rest` takes that field, the other inputs, and those of `fixed` that it
    reads themselves; it gives what `function` gives.

    A division by what is settled before becomes a product with its reciprocal. The field is kept
    small: what is one cheap operation away from numbers that are handed over, or read, anyway is
    computed again, and several numbers that are so made of fewer ones are replaced by these.
    """
    fixed = set(fixed)
    function = _with_reciprocals(function, settled(function, fixed))
    graph, live, known = function.graph, function.live(), settled(function, fixed)
    wanted = {x for node in live if node not in known for x in graph.args[node] if x in known}
    wanted |= {x for out in function.outputs.values() for x in out.nodes if x in known}
    read = _smallest(graph, wanted)
    handed = sorted(x for x in read if graph.ops[x] != "input")
    before = Function(
        graph,
        {name: shape for name, shape in function.inputs.items() if name in fixed},
        {HOISTED: Output((len(handed),), tuple(graph.number(x) for x in handed))},
    )
    return before, function.taking(
        {x: (HOISTED, k) for k, x in enumerate(handed)}, {HOISTED: (len(handed),)}
    )


def settled(function: Function, fixed: set[str]) -> set[int]:
    """Nodes that depend on the inputs `fixed`, and on these alone."""
    graph, settled_nodes = function.graph, set()
    for node in function.live():
        if graph.ops[node] == "input":
            if graph.values[node][0] in fixed:
                settled_nodes.add(node)
        elif graph.args[node] and all(
            x in settled_nodes or graph.is_const(x) for x in graph.args[node]
        ):
            settled_nodes.add(node)
    return settled_nodes


def _with_reciprocals(function: Function, known: set[int]) -> Function:
    source, graph, there = function.graph, Graph(), {}
    for x in function.live():
        op, value, args = source.ops[x], source.values[x], [there[y] for y in source.args[x]]
        if op == "div" and x not in known and source.args[x][1] in known:
            there[x] = graph.make("mul", args[0], graph.make("div", graph.one, args[1]))
        else:
            there[x] = graph.again(op, args, value)
    outputs = {
        name: Output(out.shape, tuple(there[x] for x in out.nodes))
        for name, out in function.outputs.items()
    }
    return Function(graph, function.inputs, outputs)


def _smallest(graph: Graph, wanted: set[int]) -> set[int]:
    """Nodes that the wanted ones are at most one cheap operation away from; greedily, as few as
    possible.
    """
    open_nodes = set(wanted)
    sources = {
        v: {x for x in graph.args[v] if not graph.is_const(x)}
        for v in wanted
        if graph.ops[v] in CHEAP
    }
    pinned: set[int] = set()  # what is computed again reads these
    for v in sorted(sources, reverse=True):
        if v not in pinned and sources[v] <= open_nodes - {v}:
            open_nodes.discard(v)
            pinned |= sources[v]
    groups = _groups(
        {
            v: needs - open_nodes
            for v, needs in sources.items()
            if v in open_nodes and v not in pinned
        }
    )
    for group in groups:
        while True:  # without a member that alone brings in two or more numbers
            users: dict[int, list[int]] = {}
            for v, needs in group.items():
                for x in needs:
                    users.setdefault(x, []).append(v)
            dear = [v for v, needs in group.items() if sum(len(users[x]) == 1 for x in needs) > 1]
            if not dear:
                break
            del group[dear[0]]
        if len(group) > len(users):
            cut = {x for v in group for x in sources[v]}
            if not cut & set(group):
                open_nodes = open_nodes - set(group) | cut
    return open_nodes


def _groups(needs: dict[int, set[int]]) -> list[dict[int, set[int]]]:
    """Parts that share no need."""
    groups: list[tuple[dict[int, set[int]], set[int]]] = []
    for v, wanted in needs.items():
        joined, apart = ({v: wanted}, set(wanted)), []
        for group in groups:
            if group[1] & joined[1]:
                joined = ({**joined[0], **group[0]}, joined[1] | group[1])
            else:
                apart.append(group)
        groups = [*apart, joined]
    return [group for group, _ in groups]
