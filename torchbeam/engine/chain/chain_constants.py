"""Trees of a model's constants: `Rows` and `Conditions` by nodes, elements, supports, and what all
have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

from torch import Tensor

from ...core.leaves import Tree, leaf, leaves_in_order, map_leaves, own_leaves, with_values
from ...nodal.rows import ElementRows, NodeRows
from ...scene.effects import Inputs

HELD = ("position", "rotation", "velocity", "spin")  # of a support


@dataclass(frozen=True)
class NodeConditions(Tree):
    """What is of each node in `Conditions`. dead (..., N+1, w): loads that depend on no motion,
    None = none; loads: those of `CommonConditions` that have values by place, rows in each of their
    leaves but the `shared` ones, which are None; None in the place of the others.
    """

    dead: Tensor | None = leaf(2)
    loads: tuple[Any, ...]


@dataclass(frozen=True)
class NodeConstants(Tree):
    """Rows of nodes. before: conditions at the start of the step, None = they are the same there,
    or not asked for.
    """

    rows: NodeRows
    now: NodeConditions
    before: NodeConditions | None


@dataclass(frozen=True)
class ElementConstants(Tree):
    """Rows of elements. C: the law's stiffness in the tangent of this step; eigenstrain
    (..., N, k), None = none.
    """

    rows: ElementRows
    C: Tensor = leaf(3)
    eigenstrain: Tensor | None = leaf(2)


@dataclass(frozen=True)
class RootPose(Tree):
    """`Pose` of the root's support, each field a leaf."""

    position: Tensor = leaf(1)
    R: Tensor = leaf(2)
    velocity: Tensor = leaf(1)
    spin: Tensor = leaf(1)


@dataclass(frozen=True)
class CommonConditions(Tree):
    """What is of all nodes alike in `Conditions`: the loads that are evaluated natively (of those
    of `NodeConditions` the `shared` leaves alone, None where there are none), and where a root's
    support stands.
    """

    loads: tuple[Any, ...]
    support: RootPose | None


def by_rows(load: Any, by_place: bool) -> tuple[Any, Any]:
    """A load as `NodeConditions` and `CommonConditions` have it."""
    if not by_place or not load.shared:
        return (load, None) if by_place else (None, load)
    own = {leaf.name for leaf in own_leaves(load)}.difference(load.shared)
    return with_values(load, **dict.fromkeys(load.shared)), with_values(load, **dict.fromkeys(own))


def of_row(row: Any, load: Any) -> Any:
    """The inverse."""
    if row is None or load is None:
        return row or load
    return with_values(row, **{name: getattr(load, name) for name in row.shared})


@dataclass(frozen=True)
class Captured(Tree):
    """A tensor that users' functions read beside their arguments, as an input of the program, with
    its number of own axes, and of those before them, which are a batch's.
    """

    value: Tensor = leaf(lambda one: one.axes)
    axes: int
    batch: int = 0


@dataclass(frozen=True)
class Common(Tree):
    """One of all nodes: dt and t (...) s of the step and of the instant at which it takes its
    loads, inputs, the place of a plane; of frame a, in the middle of the step, its velocity and
    angular velocity (..., 3) and its orientation, see `State.frame`, None = at rest; now, before:
    see `NodeConstants`; captured: what users' functions read; mixture: see `ExtrapolatedFunctions`.
    """

    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    place: Tensor | None = leaf(0)
    velocity: Tensor | None = leaf(1)
    angular_velocity: Tensor | None = leaf(1)
    frame: Tensor | None = leaf(1)
    now: CommonConditions
    before: CommonConditions | None
    captured: tuple[Captured, ...] = ()
    mixture: Tensor | None = leaf(1, default=None)


@dataclass(frozen=True)
class SupportConstants(Tree):
    """Rows of supports at the end of the step: position (..., S, 3) m and quaternion (..., S, 4) of
    those that move, velocity (..., S, 3) m/s, absolute, frame a, and spin (..., S, 3) rad/s,
    absolute, section axes, of clamps; zeros of the others.
    """

    position: Tensor = leaf(2)
    rotation: Tensor = leaf(2)
    velocity: Tensor = leaf(2)
    spin: Tensor = leaf(2)


class Trees(NamedTuple):
    """Of all constants; support: None where nothing moves; between: of what acts between nodes, by
    the names of their records, None where there is nothing of the sort.
    """

    node: NodeConstants
    element: ElementConstants
    common: Common
    support: SupportConstants | None
    between: dict[str, Any]

    @property
    def by_record(self) -> dict[str, Any]:
        """By the names of their records."""
        return dict(zip(self._fields[:-1], self[:-1], strict=True)) | self.between


def flattened(tree: Any) -> list[tuple[Tensor, int]]:
    """The tensors of a tree, each with its number of own axes, in the order of `filled`."""
    return [(x, axes) for x, axes in leaves_in_order(tree) if isinstance(x, Tensor)]


def reader_of(tree: Any) -> Callable[[Any], Sequence[Tensor]]:
    """What gives the tensors of trees of this one's structure, in the order of `flattened`: by
    names, where they all are fields, or fields of fields.
    """
    tensors, names = [x for x, _ in flattened(tree)], [*_names(tree)]
    if len(tensors) > 1:
        by_names = attrgetter(*names) if len(names) == len(tensors) else lambda tree: ()
        if [*map(id, by_names(tree))] == [*map(id, tensors)]:
            return by_names
    return lambda tree: [x for x, _ in flattened(tree)]


def _names(tree: Any) -> Iterator[str]:
    """Of the tensors of trees in fields."""
    for name, value in vars(tree).items() if isinstance(tree, Tree) else ():
        if isinstance(value, Tensor) and " " not in name:
            yield name
        elif isinstance(value, Tree):
            yield from (f"{name}.{own}" for own in _names(value))


def filled(tree: Any, value: Callable[[int], Tensor]) -> Any:
    """The tree with value(k) in the place of its k-th tensor."""
    count = -1

    def put(x: Any, axes: int | None) -> Any:
        nonlocal count
        if not isinstance(x, Tensor):
            return x
        count += 1
        return value(count)

    return map_leaves(put, tree)
