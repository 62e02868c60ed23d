"""Given forces and moments: on a node, on the tip, along the beam."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean
from ...core.declared import one_of
from ...core.leaves import leaf, option, with_values
from ...core.validation import Value, refusal
from ...math.quaternions import skew
from ..parts import Place, check_node, node_and_point
from .load_point import ROTATION, LoadEffect, LoadPoint, Wrench, together
from .values import (
    AtSites,
    ByPlace,
    Inputs,
    LoadValue,
    line_value,
    load_value,
    value_along,
    value_at,
)

# Forces and moments have a value each: a tensor (..., 3), a function t -> (..., 3), an `Input`, or
# None = absent. A dead load keeps its direction in frame a; a follower load is given in section
# axes and turns with the section.


def _depends(load: Any) -> frozenset[str]:
    return frozenset({ROTATION} if load.follower else ())


def _conservative(load: Any) -> bool:
    """Whether its work is independent of the path: of a dead force it is, of a moment not."""
    return load.moment is None and not load.follower


def _wrench(load: Any, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
    values = [
        None if v is None else load.value(v, point, t, inputs) for v in (load.force, load.moment)
    ]
    return tuple(point.rotate(v) if load.follower and v is not None else v for v in values)


def _tangent(load: Any, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
    """d(R f) = spin x R f."""
    if not load.follower:
        return {}
    both = together(load.wrench(point, t, inputs), point.R).split(3, -1)
    return {ROTATION: -torch.cat([skew(w) for w in both], -2)}


@dataclass(frozen=True)
class PointLoad(LoadEffect):
    """Force (N) and moment (N m) on one node; nodes count from the root, -1 is the tip.

    Args:
        node: its number, of a structure (name, number) or the name of a body
        force: (..., 3) N: numbers, a function of t, an `Input`, a `History`. A dead load keeps its
            direction in frame a
        moment: (..., 3) N m, the same
        follower: whether both turn with their section
        offset: (..., 3) m from the node to where the force acts, section axes; None = at the node.
            On a body, node = (name, point in its axes) says the same

    Examples:
        >>> pushed = tb.Scene(
        ...     beam, [tb.PointLoad(2, force=(0, 0, 1.0))]
        ... )  # N, in the middle of four elements
        >>> tb.equilibrium(pushed).root.moment  # N m
        tensor([0.0000, 0.4991, 0.0000])
    """

    moment: Value | None = leaf(1, default=None, kw_only=True, check=load_value)
    follower: bool = option(boolean, default=False, kw_only=True)
    node: Place = field()
    force: Value | None = leaf(1, default=None, check=load_value)
    offset: Value | None = leaf(1, default=None, kw_only=True, size=3)

    conservative = property(_conservative)

    def __post_init__(self) -> None:
        at_offset(self)
        one_of(self, "force", "moment")
        super().__post_init__()

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor | None:
        pull = self.force
        return length * torch.linalg.vector_norm(pull, dim=-1) if torch.is_tensor(pull) else None

    @property
    def depends(self) -> frozenset[str]:
        lever = self.offset is not None and self.force is not None
        return frozenset({ROTATION}) if lever else _depends(self)

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        wrench = _wrench(self, point, t, inputs)
        return wrench if self.offset is None else point.carried(wrench, self.offset)

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        if self.offset is None:
            return _tangent(self, point, t, inputs)
        return super().tangent(point, t, inputs)

    def value(self, value: LoadValue, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """A force or moment (..., 3) at this instant."""
        return value_at(value, t, inputs, point.R)


@dataclass(frozen=True)
class TipLoad(PointLoad):
    """Force (N) and moment (N m) on the last node.

    Args:
        force, moment, follower, offset: as in `PointLoad`

    Examples:
        >>> pushed = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 1.0))])  # N, keeps its direction
        >>> beck = tb.Scene(
        ...     beam, [tb.TipLoad(force=(-1.0, 0, 0), follower=True)]
        ... )  # turns with the tip
        >>> rising = tb.Scene(
        ...     beam, [tb.TipLoad(force=lambda t: torch.stack((0 * t, 0 * t, 10 * t)))]
        ... )
        >>> tb.equilibrium(pushed).root.force[2]  # N
        tensor(-1.)
    """

    node: Place = field(default=-1, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if type(self.node) is not int or self.node != -1:
            raise ValueError(f"TipLoad with node = {self.node!r} was given; PointLoad takes a node")


@dataclass(frozen=True)
class LineLoad(LoadEffect):
    """Force (N/m) and moment (N) per unit length along the whole beam.

    Args:
        force: (..., 3) N/m: numbers, a function of t, an `Input`, `Along(function)` of s and t, or
            `PerElement(values)`. A dead load keeps its direction in frame a
        moment: (..., 3) N, the same
        follower: whether both turn with their sections
        on: name of a beam of a structure; None = all

    Examples:
        >>> snow = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -1.0))])  # N/m
        >>> tb.equilibrium(snow).root.force[2]  # N
        tensor(1.)
    """

    moment: Value | None = leaf(1, default=None, kw_only=True, check=line_value)
    follower: bool = option(boolean, default=False, kw_only=True)
    force: Value | None = leaf(1, default=None, check=line_value)
    on: str | None = field(default=None, kw_only=True)

    depends, conservative = property(_depends), property(_conservative)
    wrench, tangent = _wrench, _tangent

    def __post_init__(self) -> None:
        one_of(self, "force", "moment")
        super().__post_init__()

    @property
    def by_place(self) -> bool:
        return any(isinstance(value, ByPlace) for value in (self.force, self.moment))

    integrated = by_place

    def at_sites(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> LineLoad | None:
        if not self.by_place:
            return None
        values = dict(force=self.force, moment=self.moment)
        sites = {
            name: AtSites(value_along(value, s, t, inputs, s, elements))
            for name, value in values.items()
            if value is not None
        }
        return with_values(self, **sites)

    def value(self, value: LoadValue, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """A force or moment (..., sites, 3) per length at this instant."""
        return value_along(value, point.s, t, inputs, point.R, point.elements)


def at_offset(effect: Any) -> None:
    """Takes the `node` of an effect with an `offset` apart where it is (name of a body, point in
    its axes), before its fields are checked. Raises ValueError for both, and for what is no node.
    """
    node, point = node_and_point(effect.node)
    check_node("node", node)
    if point is not None and effect.offset is not None:
        raise refusal(f"{effect.called} with an offset and a point of {node!r}", "one of them")
    vars(effect).update(node=node, offset=effect.offset if point is None else point)
