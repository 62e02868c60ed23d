"""The order in which a function's numbers are computed, so that few of them wait in registers at a
time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from .function import Function


class Store(NamedTuple):
    """A node that is written to a component of an output."""

    field: str
    component: int
    node: int


def schedule(function: Function) -> Iterator[int | Store]:
    """Nodes, each behind those that it reads, and stores, each right behind what it writes: that
    output first for which the fewest nodes are wanting; depth first, the argument first that needs
    more registers (Sethi and Ullman 1970). Constants are left out.
    """
    graph, registers, needed = function.graph, {}, {}
    for node in function.live():
        if graph.ops[node] != "const":
            needs = sorted(
                (registers[x] for x in set(graph.args[node]) if x in registers), reverse=True
            )
            registers[node] = max((n + k for k, n in enumerate(needs)), default=1)
            # a bit for each node that it depends on
            needed[node] = (graph.ops[node] != "input") << node
            for x in graph.args[node]:
                needed[node] |= needed.get(x, 0)
    stores = [
        Store(field, k, node)
        for field, out in function.outputs.items()
        for k, node in enumerate(out.nodes)
    ]
    done, wanting = set(), -1  # a bit for each node that is not done
    while stores:
        store = min(stores, key=lambda one: (needed.get(one.node, 0) & wanting).bit_count())
        stores.remove(store)
        wanting &= ~needed.get(store.node, 0)
        todo = [(store.node, False)]
        while todo:
            node, ready = todo.pop()
            if ready:
                yield node
            elif node in registers and node not in done:
                done.add(node)
                todo.append((node, True))
                todo.extend(
                    (x, False) for x in sorted(graph.args[node], key=lambda x: registers.get(x, 0))
                )
        yield store
