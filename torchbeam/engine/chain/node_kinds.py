"""Kinds of nodes, of elements and of what acts between nodes, by which code differs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

from torch import Tensor

from ...nodal.acting import ActingLoad
from ...nodal.centreline import piece_nodes
from ...nodal.fixed_touching import KnownPairs
from ...nodal.model import Model
from ...state.instant import READINGS
from .order import MANNERS, manners_of
from .sorts import PAIR_SIDES, SIDES


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


class ElementKind(NamedTuple):
    """What holds the nodes of an element, in order; numbers of the loads in `CommonConditions` that
    act between them.
    """

    ends: tuple[EndKind, ...]
    loads: tuple[int, ...] = ()


NO_ELEMENT = ElementKind((EndKind(), EndKind()))


class JointKind(NamedTuple):
    """What code of a joint depends on: what holds its two ends, None = it is the ground; its rows
    of `Joints.held`, `angles`, `travels`, `second` and, where there are any, `prescribed`; of v, w
    and across the shift, row by row, None = a value; its rows of `Joints.parts`; whether it is a
    ball.
    """

    ends: tuple[EndKind | None, EndKind | None]
    held: tuple[float, ...]
    angles: tuple[float, ...]
    travels: tuple[float, ...]
    second: tuple[float, ...]
    prescribed: tuple[float, ...] | None
    shifts: tuple[tuple[float | None, ...], ...]
    parts: tuple[tuple[tuple[float, ...], ...], ...]
    ball: bool = False
    multiplied: ClassVar[bool] = True  # whether it has forces of constraints
    kept: ClassVar[int] = READINGS  # how many numbers a state has of it

    @property
    def sides(self) -> tuple[str, ...]:
        """What its ends are called that are nodes."""
        return _sides(self.ends)


class StretchKind(NamedTuple):
    """What code of a stretch of a tendon depends on: what holds its two ends, None = it is the
    ground; whether the tendon has a stiffness, and friction.
    """

    ends: tuple[EndKind | None, EndKind | None]
    elastic: bool
    has_friction: bool
    multiplied: ClassVar[bool] = False
    kept: ClassVar[int] = 0

    @property
    def sides(self) -> tuple[str, ...]:
        """What its ends are called that are nodes."""
        return _sides(self.ends)

    @property
    def coupled(self) -> bool:
        """Whether its tension depends on where the other stretches are."""
        return self.elastic or self.has_friction

    def by_word(self) -> dict[str, tuple[Any, ...]]:
        """What each of its functions depends on, by the first word of their names."""
        return {
            "stretch": (self.ends, self.coupled, self.has_friction),
            "tension": (self.elastic, self.has_friction),
            "tie": (self.ends, self.coupled),
        }


def alike(kinds: tuple[Any, ...], k: int, word: str) -> int:
    """The first of the kinds that has the same functions of this word as kind k."""
    words = [kind.by_word()[word] if hasattr(kind, "by_word") else kind for kind in kinds]
    return words.index(words[k])


def distinct(kinds: tuple[Any, ...], word: str) -> list[tuple[int, Any]]:
    """Those whose functions of this word are not those of an earlier one, with their numbers."""
    return [(k, kind) for k, kind in enumerate(kinds) if alike(kinds, k, word) == k]


class PairKind(NamedTuple):
    """What code of a pair that may touch depends on, see `TouchingPairs`: what holds its six nodes;
    its law, see `PairLaw`.
    """

    ends: tuple[EndKind, ...]
    has_friction: bool
    has_damping: bool
    surface: type | None
    has_taper: bool
    multiplied: ClassVar[bool] = False
    kept: ClassVar[int] = 0

    sides = property(lambda self: PAIR_SIDES)


class CouplingKind(NamedTuple):
    """What code of an `Interaction` depends on: what holds its nodes; its number among the loads in
    `CommonConditions`; its row of `Couplings.held`, () = it has no unknowns; the most numbers that
    one of a scene remembers.
    """

    ends: tuple[EndKind, ...]
    load: int
    held: tuple[float, ...] = ()
    kept: int = 0

    sides = property(lambda self: PAIR_SIDES[: len(self.ends)])
    multiplied = property(lambda self: bool(self.held))


def _sides(ends: tuple[EndKind | None, ...]) -> tuple[str, ...]:
    return tuple(side for side, end in zip(SIDES[1], ends, strict=True) if end is not None)


def without_side(field: str) -> str:
    """What a field of one of an element's nodes is called at the node."""
    side, dot, name = field.partition(".")
    return name if dot and side in (*SIDES[max(SIDES)], *PAIR_SIDES) else field


class Kinds(NamedTuple):
    """Of all nodes, of all elements and of all joints; or those that there are. runs: how nodes are
    eliminated, see `order.manners_of`; stretches: of tendons; pairs: that
    may touch, which are of the `touching` kinds.
    """

    nodes: tuple[NodeKind, ...]
    elements: tuple[ElementKind, ...]
    joints: tuple[JointKind, ...] = ()
    runs: tuple[str, ...] = ()
    stretches: tuple[StretchKind, ...] = ()
    pairs: tuple[PairKind, ...] = ()
    touching: tuple[PairKind, ...] = ()
    couplings: tuple[CouplingKind, ...] = ()

    @property
    def between(self) -> tuple[tuple[Any, ...], ...]:
        """Those of each of `INTERACTIONS`."""
        return self.joints, self.stretches, self.pairs, self.couplings

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
        joints, stretches = _of_joints(model, held), _of_stretches(model, held)
        pairs, touching = _of_pairs(model, held)
        runs = MANNERS if touching else manners_of(model)  # pairs come and go
        w = model.space.unknowns
        couplings = tuple(
            CouplingKind(
                tuple(held[node] for node in act.node),
                k,
                _own(act.load.unknowns, w),
                model.scene.memory[1],
            )
            for k, act in several.items()
        )
        return cls(tuple(nodes), elements, joints, runs, stretches, pairs, touching, couplings)

    def distinct(self) -> Kinds:
        """Each once; where there are bodies alone, a kind of elements that none is of."""
        kinds = Kinds(*(tuple(dict.fromkeys(sort)) for sort in self))
        kinds = kinds._replace(pairs=kinds.touching)
        return kinds if kinds.elements else kinds._replace(elements=(NO_ELEMENT,))


def _own(count: int, w: int) -> tuple[float, ...]:
    """Which of w numbers so many unknowns are; () = none."""
    return tuple(float(k < count) for k in range(w)) if count else ()


def _of_joints(model: Model, held: list[EndKind]) -> tuple[JointKind, ...]:
    joints = model.joints
    if not joints.count:
        return ()
    masks = [joints.held, joints.angles, joints.travels, joints.second]
    prescribed = getattr(joints, "prescribed", None)
    masks = [
        *map(_tuples, masks),
        [None] * joints.count if prescribed is None else _tuples(prescribed),
    ]
    at = () if joints.balls is None else joints.balls.at
    balls = [k in at for k in range(joints.count)]
    factors = joints.v, joints.w, joints.across
    shifts = zip(*(_shifts(factor.shift) for factor in factors), strict=True)
    return tuple(
        JointKind(tuple(None if node is None else held[node] for node in pair), *more)
        for pair, *more in zip(
            model.topology.joints, *masks, shifts, _tuples(joints.parts), balls, strict=True
        )
    )


def _of_stretches(model: Model, held: list[EndKind]) -> tuple[StretchKind, ...]:
    tendons = model.tendons
    if not tendons.stretches:
        return ()
    ends = [None if node is None else held[node] for node in tendons.nodes]
    ropes = [(x.stiffness is not None, x.friction is not None) for x in tendons.ropes]
    return tuple(StretchKind((ends[e], ends[e + 1]), *ropes[k]) for k, e in tendons.stretches)


def _of_pairs(
    model: Model, held: list[EndKind]
) -> tuple[tuple[PairKind, ...], tuple[PairKind, ...]]:
    """Of the pairs of a model whose pairs are known, and of all that there may be; none where
    none is near.
    """
    if not isinstance(model.touching, KnownPairs) or not model.touching.nodes:
        return (), ()
    pairs = tuple(
        PairKind(tuple(held[node] for node in nodes), *law)
        for nodes, law in zip(model.touching.nodes, model.touching.laws, strict=True)
    )
    possible = {}
    for touching in model.touching.each:
        points, pieces = (
            dict.fromkeys(tuple(held[node] for node in nodes) for nodes in rows)
            for rows in (piece_nodes(*touching.along), touching.pieces)
        )
        possible |= dict.fromkeys(PairKind(a + b, *touching.law) for a in points for b in pieces)
    return pairs, tuple(possible)


def _tuples(x: Tensor) -> tuple[Any, ...]:
    """As tuples of tuples."""

    def nested(rows: Any) -> Any:
        return tuple(map(nested, rows)) if isinstance(rows, list) else rows

    return nested(x.tolist())


def _shifts(shift: Tensor) -> list[tuple[float | None, ...]]:
    """Of the rows of all joints (..., J, m, 1): the number, where it is 0 or 1 in all samples."""
    values = shift.detach()[None, ..., 0].flatten(0, -3)
    number = ((values == 0) | (values == 1)) & (values == values[:1])
    return [
        tuple(value if same else None for value, same in zip(*row, strict=True))
        for row in zip(values[0].tolist(), number.all(0).tolist(), strict=True)
    ]


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
