"""Midside nodes in a program: the functions by which they are eliminated, element by element, and
follow their ends.
"""

from __future__ import annotations

from collections.abc import Iterable

from ..compiler.function import Function
from ..compiler.packing import Packing
from .layout import BETWEEN, ELEMENT_PLACES, ELEMENTS, INNER, MIDDLE, ONE, Layout, sizes
from .sorts import SIDES

BLOCKS = ("U", "L", "far_U", "far_L")  # of an element, beside those of its nodes
# what a midside node's move is made from, beside the moves of its element's ends
FOLLOWING = ("own", "by_i", "by_j")


def to_nodes(names: Iterable[str]) -> list[str]:
    """Of what an element gives: what is for the rows of its nodes."""
    return [name for name in names if name in BLOCKS or name.partition(".")[0] in SIDES[max(SIDES)]]


def eliminating(
    condense: dict[str, Function], restore: Function, inside: Packing, inner: Packing
) -> tuple[dict[str, Function], Packing, dict[str, tuple[int, ...]]]:
    """Functions of midside nodes by name, from those that eliminate them, which take fields of the
    midside node (own.) and of the element (element.), and the one that restores them; what elements
    then give their ends, and the shapes of that.
    """
    names = {f"element.{name}": name for name in inner.fields}
    makers = [
        inner.taken(inside.taken(function, {f"own.{name}": name for name in inside.fields}), names)
        for function in condense.values()
    ]
    between = Packing(BETWEEN, makers, to_nodes(makers[0].outputs))
    middle = Packing(MIDDLE, between.made(), FOLLOWING)
    functions = dict(zip(condense, middle.made(), strict=True))
    functions["restore"] = middle.taken(restore, {name: name for name in FOLLOWING})
    return functions, between, {name: makers[0].outputs[name].shape for name in between.fields}


def record(layout: Layout, functions: dict[str, Function], element: str) -> None:
    """Records of what elements give, by the function of that name, and of their midside nodes."""
    last = "condense" if "condense" in functions else element
    layout.record("between", ELEMENT_PLACES, [(BETWEEN, sizes(functions, last)[BETWEEN])])
    if last == element:
        return
    layout.record("inner", ONE, [(INNER, sizes(functions, element)[INNER])])
    layout.record("middle", ELEMENTS, [(MIDDLE, sizes(functions, last)[MIDDLE])])
