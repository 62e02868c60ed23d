"""Kinds of all rows of a structure, by which code differs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from ...nodal.acting import ActingLoad
from ...nodal.model import Model
from .interaction_sorts import INTERACTIONS
from .order import MANNERS, manners_of
from .row_kinds import ElementKind, EndKind, NodeKind, PlacedKind, SupportKind
from .sorts import PAIR_SIDES, SIDES

NO_ELEMENT = ElementKind((EndKind(), EndKind()))


def same_code(kinds: tuple[Any, ...], k: int, word: str) -> int:
    """The first of the kinds that has the same functions of this word as kind k."""
    words = [kind.by_word()[word] if hasattr(kind, "by_word") else kind for kind in kinds]
    return words.index(words[k])


def distinct(kinds: tuple[Any, ...], word: str) -> list[tuple[int, Any]]:
    """Those whose functions of this word are not those of an earlier one, with their numbers."""
    return [(k, kind) for k, kind in enumerate(kinds) if same_code(kinds, k, word) == k]


def without_side(field: str) -> str:
    """What a field of one of an element's nodes is called at the node."""
    side, dot, name = field.partition(".")
    return name if dot and side in (*SIDES[max(SIDES)], *PAIR_SIDES) else field


class Kinds(NamedTuple):
    """Of all nodes, of all elements and of all rows of each of `INTERACTIONS`; or those that there
    are. runs: how nodes are eliminated, see `order.manners_of`; possible: of each of `INTERACTIONS`
    those that there may be, () = no others.
    """

    nodes: tuple[NodeKind, ...]
    elements: tuple[ElementKind, ...]
    between: tuple[tuple[Any, ...], ...] = ((),) * len(INTERACTIONS)
    runs: tuple[str, ...] = ()
    possible: tuple[tuple[Any, ...], ...] = ((),) * len(INTERACTIONS)

    @property
    def multiplied(self) -> bool:
        """Whether there are forces of constraints."""
        return any(kind.multiplied for kinds in self.between for kind in kinds)

    @classmethod
    def of(
        cls,
        nodes: list[NodeKind],
        model: Model,
        loads: Callable[[int], tuple[int, ...]],
        several: dict[int, ActingLoad],
    ) -> Kinds:
        """From those of all nodes of a model, and the numbers of the loads between those of each
        element; several: those that act on several nodes.
        """
        held, topology = [node.end for node in nodes], model.topology
        ends = (tuple(held[node] for node in row) for row in zip(*topology.elements, strict=True))
        elements = tuple(ElementKind(row, loads(e)) for e, row in enumerate(ends))
        of_sorts = [sort.functions for sort in INTERACTIONS]
        between = tuple(of_sort.kinds(model, held, several) for of_sort in of_sorts)
        possible = tuple(of_sort.possible(model, held) for of_sort in of_sorts)
        runs = MANNERS if any(possible) else manners_of(model)  # they come and go
        return cls(tuple(nodes), elements, between, runs, possible)

    def distinct(self) -> Kinds:
        """Each once; where there are bodies alone, a kind of elements that none is of."""
        nodes, elements = (tuple(dict.fromkeys(rows)) for rows in self[:2])
        pairs = zip(self.between, self.possible, strict=True)
        between = tuple(tuple(dict.fromkeys(possible or rows)) for rows, possible in pairs)
        return Kinds(nodes, elements or (NO_ELEMENT,), between, self.runs)


def kinds_of(model: Model, loads: tuple[ActingLoad, ...], rest: bool = False) -> Kinds:
    """Of a model's nodes, on which these loads act, and elements: in a step, or at rest."""
    nodes, supports = model.node_count, {}
    several = {k: act for k, act in enumerate(loads) if isinstance(act.node, tuple)}
    hinges = {node: tuple(axis.tolist()) for node, axis in model.constraints.hinges}
    for support, fixed in zip(
        model.scene.supports, map(tuple, model.constraints.fixed.tolist()), strict=True
    ):
        if rest:
            displaced = support.displacement is not None, support.turn is not None
            supports[support.node] = PlacedKind(fixed, displaced, hinges.get(support.node))
        elif model.scene.has_prescribed_motion:
            supports[support.node] = SupportKind(fixed, support.moves, support.clamp)

    def kind(j: int) -> NodeKind:
        acting = tuple(
            k
            for k, act in enumerate(loads)
            if k not in several and not act.load.between_nodes and act.acts_on(j)
        )
        return (
            NodeKind(acting, placed=supports.get(j))
            if rest
            else NodeKind(acting, hinges.get(j), supports.get(j))
        )

    def between(e: int) -> tuple[int, ...]:
        first = e * model.topology.order
        return tuple(
            k
            for k, act in enumerate(loads)
            if act.load.between_nodes
            and (act.node is None or act.node.start <= first < act.node.stop)
        )

    return Kinds.of([kind(j) for j in range(nodes)], model, between, several)
