"""Packing: fields that some functions give and others take, handed over without what is zero,
equal, or but of another sign.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from .function import Function, Output
from .graph import Graph


class Packing:
    """Of fields that each of `makers` gives, of the same shapes: one field `name` of `size`
    numbers, from which all of their components come. Where these are all zeros, so is it.
    """

    def __init__(self, name: str, makers: Sequence[Function], fields: Iterable[str]) -> None:
        self.name, self.fields = name, tuple(fields)
        # (place, whether it is the negative), None = zero
        self.components: dict[str, list[tuple[int, bool] | None]] = {}
        self._nodes: list[list[int]] = []  # of each place, one a maker
        places: dict[tuple[int, ...], int] = {}
        for name in self.fields:
            self.components[name] = []
            for nodes in zip(*(maker.outputs[name].nodes for maker in makers), strict=True):
                if all(x == maker.graph.zero for x, maker in zip(nodes, makers, strict=True)):
                    self.components[name].append(None)
                    continue
                opposite = tuple(
                    maker.graph.make("neg", x) for x, maker in zip(nodes, makers, strict=True)
                )
                negative = opposite in places
                if not negative and nodes not in places:
                    negative = makers[0].graph.ops[nodes[0]] == "neg"
                    places[opposite if negative else nodes] = len(self._nodes)
                    self._nodes.append([*(opposite if negative else nodes)])
                self.components[name].append((places[opposite if negative else nodes], negative))
        self._makers = [*makers]

    @property
    def size(self) -> int:
        return len(self._nodes)

    def made(self) -> list[Function]:
        """The makers, with the one field in the place of the many."""
        packed = []
        for k, maker in enumerate(self._makers):
            outputs = {name: out for name, out in maker.outputs.items() if name not in self.fields}
            outputs[self.name] = Output((self.size,), tuple(nodes[k] for nodes in self._nodes))
            packed.append(Function(maker.graph, maker.inputs, outputs))
        return packed

    def taken(self, function: Function, names: Mapping[str, str]) -> Function:
        """A function that takes fields by `names` (its own name -> that among the packed ones),
        with the one field in their place; what stands before the first dot in its own name
        (left.D), the field's name has as well (left.NAME).
        """
        graph, given, inputs = Graph(), {}, dict(function.inputs)
        for called, name in names.items():
            if called in inputs:
                field = f"{called.partition('.')[0]}.{self.name}" if "." in called else self.name
                inputs[field] = (self.size,)
                del inputs[called]
                given[called] = [
                    self._component(graph, field, component) for component in self.components[name]
                ]
        nodes = function.into(graph, given)
        outputs = {
            name: Output(out.shape, tuple(nodes[name])) for name, out in function.outputs.items()
        }
        return Function(graph, inputs, outputs).only(outputs)

    @staticmethod
    def _component(graph: Graph, field: str, one: tuple[int, bool] | None) -> int:
        if one is None:
            return graph.zero
        node = graph.input(field, one[0])
        return graph.make("neg", node) if one[1] else node
