"""Function of fields: named inputs and outputs of fixed shapes, and the graph between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import NamedTuple

from .graph import Graph


class Output(NamedTuple):
    """A field that is computed: its shape, and its nodes in the order of memory."""

    shape: tuple[int, ...]
    nodes: tuple[int, ...]


@dataclass(frozen=True)
class Function:
    """inputs: field -> shape; outputs: field -> `Output`. Component k of the input x is the graph's
    node input(x, k).
    """

    graph: Graph
    inputs: dict[str, tuple[int, ...]]
    outputs: dict[str, Output]

    def live(self) -> tuple[int, ...]:
        """The nodes that outputs need, in order."""
        return self._live

    @cached_property
    def _live(self) -> tuple[int, ...]:
        return tuple(self.graph.live(x for out in self.outputs.values() for x in out.nodes))

    def operations(self) -> int:
        """How many numbers are computed."""
        return sum(self.graph.ops[x] not in ("const", "input") for x in self.live())

    def read(self) -> set[tuple[str, int]]:
        """(field, component) of the inputs that outputs depend on."""
        return {self.graph.values[x] for x in self.live() if self.graph.ops[x] == "input"}

    def components(self, field: str) -> list[int]:
        """Nodes of an input."""
        return [self.graph.input(field, k) for k in range(prod(self.inputs[field]))]

    def copied(self) -> Function:
        """The same in a graph of its own."""
        return replace(self, graph=self.graph.copied())

    def only(self, outputs: Iterable[str]) -> Function:
        """The function of fewer outputs; inputs that nothing depends on any more are left out."""
        few = replace(self, outputs={name: self.outputs[name] for name in outputs})
        used = {field for field, _ in few.read()}
        return replace(
            few, inputs={name: shape for name, shape in self.inputs.items() if name in used}
        )

    def into(self, graph: Graph, inputs: Mapping[str, Sequence[int]]) -> dict[str, list[int]]:
        """The nodes of the outputs in another graph, or the same, with `inputs` (field -> nodes
        there) in place of the function's; a field that is not named stays an input by that name.
        """
        own, there = self.graph, {}
        for x in self.live():
            if own.ops[x] == "input" and own.values[x][0] in inputs:
                field, k = own.values[x]
                there[x] = inputs[field][k]
            else:
                there[x] = graph.again(own.ops[x], [there[y] for y in own.args[x]], own.values[x])
        return {name: [there[x] for x in out.nodes] for name, out in self.outputs.items()}

    def taking(
        self, places: Mapping[int, tuple[str, int]], fields: Mapping[str, tuple[int, ...]]
    ) -> Function:
        """The function that takes some of its nodes from elsewhere: `places`
        node -> (field, component) of the new inputs `fields`, with their shapes.
        """
        own, graph = self.graph, Graph()
        there = {x: graph.input(*place) for x, place in places.items()}
        there = {x: graph.truth(y) if own.truths[x] else y for x, y in there.items()}
        for x in own.live(
            {x for out in self.outputs.values() for x in out.nodes}, known=set(there)
        ):
            if x not in there:
                there[x] = graph.again(own.ops[x], [there[y] for y in own.args[x]], own.values[x])
        outputs = {
            name: Output(out.shape, tuple(there[x] for x in out.nodes))
            for name, out in self.outputs.items()
        }
        return Function(graph, {**fields, **self.inputs}, outputs).only(outputs)

    def with_zeros(self, shapes: Mapping[str, tuple[int, ...]]) -> Function:
        """The function with zeros in outputs of these names and shapes that it has not."""
        zeros = {
            name: Output(shape, (self.graph.zero,) * prod(shape))
            for name, shape in shapes.items()
            if name not in self.outputs
        }
        return replace(self, outputs={**self.outputs, **zeros})

    def joined(self, other: Function) -> Function:
        """The outputs of both, in one graph: what is equal is computed once."""
        graph, outputs = Graph(), {}
        for part in (self, other):
            nodes = part.into(graph, {})
            outputs |= {
                name: Output(out.shape, tuple(nodes[name])) for name, out in part.outputs.items()
            }
        return Function(graph, {**self.inputs, **other.inputs}, outputs)

    def with_constants(self, values: Mapping[str, Sequence[float]]) -> Function:
        """The function with constants (flat, in the order of memory) in place of some inputs;
        folded anew.
        """
        graph = Graph()
        nodes = self.into(
            graph, {name: [graph.const(v) for v in value] for name, value in values.items()}
        )
        outputs = {
            name: Output(out.shape, tuple(nodes[name])) for name, out in self.outputs.items()
        }
        return Function(
            graph,
            {name: shape for name, shape in self.inputs.items() if name not in values},
            outputs,
        )


Functions = dict[str, Function]  # by name
