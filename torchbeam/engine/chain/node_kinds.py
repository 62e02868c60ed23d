"""Kinds of nodes and of elements, by which code differs; and what the nodes of an element are
called.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...nodal.model import Model


class SupportKind(NamedTuple):
    """Of a support, where something moves the beam: 1 for what it holds of its node's freedoms,
    else 0; whether it moves in frame a; whether it is a clamp.
    """

    fixed: tuple[float, ...]
    moves: bool
    clamp: bool


class PlacedKind(NamedTuple):
    """Of a support in an equilibrium, which puts its node where it has to be: what it holds;
    whether it has a displacement and a turn; the axis of its hinge.
    """

    fixed: tuple[float, ...]
    displaced: tuple[bool, bool]
    hinge: tuple[float, ...] | None


class EndKind(NamedTuple):
    """What holds a node of an element, see `NodeKind`."""

    hinge: tuple[float, ...] | None = None
    support: SupportKind | None = None


class NodeKind(NamedTuple):
    """What a node has beside what all have: numbers of the loads in `CommonConditions` that act
    there; the axis of its hinge, a mask in frame a, None = no hinge; its support, None = none, or
    nothing moves. In an equilibrium these two are in `placed`, of which elements know nothing.
    """

    acting: tuple[int, ...] = ()
    hinge: tuple[float, ...] | None = None
    support: SupportKind | None = None
    placed: PlacedKind | None = None

    @property
    def end(self) -> EndKind:
        """What elements know of it."""
        return EndKind(self.hinge, self.support)


ElementKind = tuple[EndKind, ...]  # of its nodes, in order
SIDES = {1: ("i", "j"), 2: ("i", "m", "j")}  # what the nodes of an element are called, by its order


def without_side(field: str) -> str:
    """What a field of one of an element's nodes is called at the node."""
    side, dot, name = field.partition(".")
    return name if dot and side in SIDES[max(SIDES)] else field


class Kinds(NamedTuple):
    """Of all nodes and of all elements; or those that there are."""

    nodes: tuple[NodeKind, ...]
    elements: tuple[ElementKind, ...]

    @classmethod
    def of(cls, nodes: list[NodeKind], order: int) -> Kinds:
        """From those of all nodes; order: of the elements."""
        held = [node.end for node in nodes]
        return cls(
            tuple(nodes),
            tuple(tuple(held[i : i + order + 1]) for i in range(0, len(held) - 1, order)),
        )

    def distinct(self) -> Kinds:
        return Kinds(*(tuple(dict.fromkeys(kinds)) for kinds in self))


def kinds_of(model: Model, loads: tuple[Any, ...], rest: bool = False) -> Kinds:
    """Of a model's nodes, on which these loads act, and elements: in a step, or at rest."""
    nodes, supports = model.node_count, {}
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
            for k, load in enumerate(loads)
            if not load.between_nodes and (load.node is None or load.node % nodes == j)
        )
        return (
            NodeKind(acting, placed=supports.get(j))
            if rest
            else NodeKind(acting, hinges.get(j), supports.get(j))
        )

    return Kinds.of([kind(j) for j in range(nodes)], model.scene.beam.order)
