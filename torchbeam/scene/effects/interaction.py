"""Interactions: what acts between several nodes, declared as a load is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import listed
from ...core.leaves import with_values
from ...core.validation import refusal
from ...math.quaternions import skew
from ..parts import Place
from .load_point import (
    INERTIAL,
    MOTION,
    OWN,
    POSITION,
    ROTATION,
    LoadEffect,
    LoadPoint,
    Wrench,
    jacobians,
    together,
)
from .values import Inputs

MOST, MOST_UNKNOWNS = 6, 6  # nodes, and unknowns


@dataclass(frozen=True)
class Interaction(LoadEffect):
    """Base of forces between nodes.

    A class of your own returns the forces; tangent, gradients, batches, equilibria, modes and
    native code follow.

    Args:
        nodes: two to six nodes, each as elsewhere in a scene; not nodes inside elements of order 2

    **Forces.** `wrench(point, t, inputs)` returns force and moment (..., n, 3) on the n nodes: N
    and N m, frame a, None = absent. The fields of `point` named in `depends` have an axis of the
    nodes: position (..., n, 3), R (..., n, 3, 3); velocity, spin, absolute, frame a. The class's
    own leaves have not. Equilibria raise it with the loads; a path does, unless the class has
    `resists = True`.

    **Unknowns.** A class has `unknowns` numbers of its own, one to six (in a plane three). Its
    `residual(point, t, inputs)` (..., unknowns), m or rad, is zero at the end of a step. It gets
    position, R and `own` (..., unknowns) of the `point` there. By default the wrench is the
    constraint force of residual = 0: `own`, N or N m, pulls against growth of the residual. A class
    may write another wrench. It acts whatever the loads are, and does work only by the curvature of
    the constraint in a step.

    **Memory.** A class keeps `memory` numbers in `State.memory`. At the end of a step, and in an
    equilibrium, `remember(point, t, inputs)` returns them, (..., memory). Its point has the numbers
    at the start of the step (`internal`) and its length `dt`. They are 0 at first. In an
    equilibrium they are those of `initial`, along a path those of the point before. Places and
    turns are at the end of the step, velocities and own unknowns act during it. The wrench gets
    `internal`, too.

    Raises:
        ValueError: for fewer than two nodes, more than six, one twice, or a missing one.
        TypeError: when the class is defined: if it depends on an acceleration, has unknowns without
            a residual or more than six, or a memory without `remember`.

    Examples:
        >>> @dataclass(frozen=True)
        ... class Tie(extend.Interaction):  # a linear spring between two nodes
        ...     stiffness: extend.Value = extend.leaf(0, positive=True)  # N/m
        ...     depends = frozenset({extend.POSITION})
        ...     conservative = True
        ...
        ...     def wrench(self, point, t, inputs):
        ...         d = self.stiffness[..., None, None] * point.position.diff(dim=-2)
        ...         return torch.cat((d, -d), -2), None
        >>> section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
        >>> beam = tb.Beam.straight(1.0, 4, section)
        >>> tied = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 1.0)), Tie((-1, 0), stiffness=5.0)])
        >>> tb.equilibrium(tied).tip.position
        tensor([0.8898, 0.0000, 0.4046])
    """

    nodes: Iterable[Place] = field()

    kind = "interaction"
    unknowns = 0  # how many it has of its own
    memory = 0  # how many numbers it remembers

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if isinstance(cls.depends, frozenset) and cls.depends.intersection(INERTIAL):
            raise TypeError(
                f"{cls.__name__} depends on an acceleration; an interaction may on "
                "POSITION, ROTATION, VELOCITY, SPIN"
            )
        if cls.memory and cls.remember is Interaction.remember:
            raise TypeError(
                f"{cls.__name__} with a memory was given; a `remember` that fills it is wanted"
            )
        if cls.unknowns and (
            cls.residual is Interaction.residual or not 0 < cls.unknowns <= MOST_UNKNOWNS
        ):
            raise TypeError(
                f"{cls.__name__} with {cls.unknowns} unknowns was given; one to {MOST_UNKNOWNS}, "
                "and a residual that determines them, are wanted"
            )

    def __post_init__(self) -> None:
        nodes = tuple(listed(self.nodes))
        if not 2 <= len(nodes) <= MOST:
            raise refusal(f"{self.called} between {len(nodes)} nodes", f"two to {MOST}", are=True)
        object.__setattr__(self, "nodes", nodes)
        super().__post_init__()

    def placed(self, beam: Any) -> Interaction:
        """Itself, at the rows of its nodes."""
        rows = tuple(int(beam.row(node, f"a node of {self.called}")) for node in self.nodes)
        rows = tuple(row % beam.node_count for row in rows)
        if len({*rows}) < len(rows):
            raise ValueError(f"{self.called} with one node twice was given; others are wanted")
        for row in rows:
            if row not in beam.topology.ends:
                raise ValueError(
                    f"{self.called} at a node inside of an element of order 2 was given; one at "
                    "the end of an element is wanted"
                )
        return with_values(self, nodes=rows)

    def residual(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """Residual (..., unknowns) m or rad of a class with unknowns, zero at the end of a step."""
        raise NotImplementedError

    def remember(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """(..., memory) at the end of a step, of a class with a memory."""
        raise NotImplementedError

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        """Force and moment of the constraint that the residual is zero."""
        by = self.residual_tangent(point, t, inputs)
        return tuple(
            -torch.einsum("...u,...unk->...nk", point.own, by[name]) if name in by else None
            for name in (POSITION, ROTATION)
        )

    def residual_tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., unknowns, n, 3) of the residual by position, and by rotation;
        (..., unknowns, unknowns) by own unknowns.
        """
        names = [name for name in (POSITION, ROTATION) if name in self.depends]
        return self._by_motions(names, point, lambda at: self.residual(at, t, inputs))

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., n, 6, n, 3) of the nodes' wrenches by name, see `LoadEffect.tangent`;
        (..., n, 6, unknowns) by own unknowns.
        """

        def wrenches(at: LoadPoint) -> Tensor:
            return together(self.wrench(at, t, inputs), point.R).flatten(-2)

        names, n = [name for name in MOTION if name in self.depends], point.R.shape[-3]
        by = self._by_motions(names, point, wrenches)
        return {
            name: block.unflatten(-2 if name == OWN else -3, (n, 6)) for name, block in by.items()
        }

    def _by_motions(
        self, names: list[str], point: LoadPoint, function: Callable[[LoadPoint], Tensor]
    ) -> dict[str, Tensor]:
        """Derivative of a function (..., m) of the point by motions (..., m, n, 3), and by own
        unknowns (..., m, unknowns), where there are some.
        """
        nothing = point.R.new_zeros(*point.R.shape[:-1])  # of a turn
        n, names = point.R.shape[-3], [*names, *[OWN] * bool(self.unknowns)]
        at = {name: nothing if name == ROTATION else getattr(point, name) for name in names}

        def of(*motions: Tensor) -> Tensor:
            moved = {
                name: x if name == OWN else x.unflatten(-1, (n, 3))
                for name, x in zip(names, motions, strict=True)
            }
            if ROTATION in moved:
                moved["R"] = point.R + skew(moved.pop(ROTATION)) @ point.R
            return function(replace(point, **moved))

        blocks = jacobians(of, *(x if name == OWN else x.flatten(-2) for name, x in at.items()))
        return {
            name: block if name == OWN else block.unflatten(-1, (n, 3))
            for name, block in zip(names, blocks, strict=True)
        }
