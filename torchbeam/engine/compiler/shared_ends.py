"""Ends: what functions of two ends compute of one end alone is computed once, for all of them,
where the end is.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence

from .function import Function, Output
from .graph import Graph
from .split import settled

END = "end"  # the field that is handed over; of the side i it is called i.end


def share_ends(
    functions: Sequence[tuple[Function, Mapping[str, Hashable]]],
    unknown: Iterable[str],
    common: Iterable[str],
) -> tuple[list[Function], dict[Hashable, Function]]:
    """(rests, ends). Each function comes with the kind of its end on each side; a side's inputs
    begin with its name and a dot. What depends on the `unknown` inputs of one side, and beside them
    on that side and the inputs `common` alone, is the end's: `ends` has for each kind the function
    of inputs without the side's name that gives it, as the one field `END`, and each rest takes
    that field of its sides instead.
    """
    unknown, common = tuple(unknown), set(common)
    graphs: dict[Hashable, Graph] = {}
    shapes: dict[Hashable, dict[str, tuple[int, ...]]] = {}
    places: dict[Hashable, dict[int, int]] = {}  # node of an end -> its component
    handed: list[dict[int, tuple[str, int]]] = []  # of each function, node -> side and component
    for function, sides in functions:
        handed.append(shared := {})
        for side, kind in sides.items():
            end, place = graphs.setdefault(kind, Graph()), places.setdefault(kind, {})
            names = {
                name: name.removeprefix(f"{side}.")
                for name in function.inputs
                if name.startswith(f"{side}.") or name in common
            }
            shapes.setdefault(kind, {}).update(
                {short: function.inputs[name] for name, short in names.items()}
            )
            for x, there in _of_end(
                function, names, {f"{side}.{name}" for name in unknown}, end
            ).items():
                shared[x] = side, place.setdefault(there, len(place))
    ends = {
        kind: Function(
            end, shapes[kind], {END: Output((len(places[kind]),), tuple(places[kind]))}
        ).only([END])
        for kind, end in graphs.items()
    }
    rests = [
        function.taking(
            {x: (f"{side}.{END}", place) for x, (side, place) in shared.items()},
            {f"{side}.{END}": (len(places[kind]),) for side, kind in sides.items()},
        )
        for (function, sides), shared in zip(functions, handed, strict=True)
    ]
    return rests, ends


def _of_end(
    function: Function, names: Mapping[str, str], unknown: set[str], end: Graph
) -> dict[int, int]:
    """Nodes that are an end's and that others, or outputs, read: each with that of the end's
    graph.
    """
    graph, live = function.graph, function.live()
    still, moving = settled(function, set(names)), set()
    for x in live:
        if x in still and (
            graph.values[x][0] in unknown
            if graph.ops[x] == "input"
            else any(y in moving for y in graph.args[x])
        ):
            moving.add(x)
    read = {y for x in live if x not in still for y in graph.args[x]}
    read |= {x for out in function.outputs.values() for x in out.nodes}
    wanted = [x for x in sorted(read & moving) if graph.ops[x] != "input"]
    there: dict[int, int] = {}
    for x in graph.live(wanted):
        value = graph.values[x]
        there[x] = end.again(
            graph.ops[x],
            [there[y] for y in graph.args[x]],
            (names[value[0]], value[1]) if graph.ops[x] == "input" else value,
        )
    return {x: end.number(there[x]) for x in wanted}
