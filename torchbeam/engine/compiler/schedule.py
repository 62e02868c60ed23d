"""The order in which a function's numbers are computed, so that few of them wait in registers at a
time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

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
            # a bit for each node that it depends on
            needed[node] = (graph.ops[node] != "input") << len(registers)
            registers[node] = max((n + k for k, n in enumerate(needs)), default=1)
            for x in graph.args[node]:
                needed[node] |= needed.get(x, 0)
    stores = [
        Store(field, k, node)
        for field, out in function.outputs.items()
        for k, node in enumerate(out.nodes)
    ]
    wanting = _bits([needed.get(store.node, 0) for store in stores], len(registers))
    waiting, done = np.ones(len(stores), bool), set()
    for _ in stores:
        counts = np.bitwise_count(wanting).sum(-1, dtype=np.int64)
        first = np.where(waiting, counts, len(registers) + 1).argmin()
        store, waiting[first] = stores[first], False
        wanting &= ~wanting[first]
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


def _bits(rows: list[int], count: int) -> np.ndarray:
    """uint64 (rows, words) of numbers of `count` bits."""
    size = 8 * (count // 64 + 1)
    return (
        np.frombuffer(b"".join(row.to_bytes(size, "little") for row in rows), np.uint64)
        .reshape(len(rows), size // 8)
        .copy()
    )
