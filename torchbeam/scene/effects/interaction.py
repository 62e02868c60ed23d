"""Interactions: what acts between several nodes, declared as a load is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from ...core.arguments import listed
from ...core.leaves import with_values
from ...math.quaternions import skew
from ..parts import Place
from .load_point import INERTIAL, MOTION, ROTATION, LoadEffect, LoadPoint, jacobians, together
from .values import Inputs

MOST = 6  # nodes


@dataclass(frozen=True)
class Interaction(LoadEffect):
    """Base of what acts between nodes. A class of one's own says what it pushes them by; its
    tangent, its gradients, batches, equilibria, modes and native code follow.

    Args:
        nodes: two to six nodes, each as wherever a node is meant; not those inside of elements of
            order 2

    Its `wrench(point, t, inputs)` gives force and moment (..., n, 3) on the n nodes: N and N m,
    frame a, None = absent. The fields of `point` that it `depends` on have an axis of the nodes
    (position (..., n, 3), R (..., n, 3, 3); velocity, spin, absolute, frame a), its own leaves have
    not. In equilibria it is raised with the loads.

    Raises:
        ValueError: for fewer than two nodes, or more than six, one twice, or one that is not there.
        TypeError: when the class is defined, for one that depends on an acceleration.

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

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if isinstance(cls.depends, frozenset) and cls.depends.intersection(INERTIAL):
            raise TypeError(
                f"{cls.__name__} depends on an acceleration; an interaction may on "
                "POSITION, ROTATION, VELOCITY, SPIN"
            )

    def __post_init__(self) -> None:
        nodes = tuple(listed(self.nodes))
        if not 2 <= len(nodes) <= MOST:
            raise ValueError(
                f"{self.called} between {len(nodes)} nodes was given; two to {MOST} are wanted"
            )
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

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., n, 6, n, 3) of the nodes' wrenches by name, see `LoadEffect.tangent`."""
        names, n = [name for name in MOTION if name in self.depends], point.R.shape[-3]
        nothing = point.R.new_zeros(*point.R.shape[:-1])  # of a turn
        at = [nothing if name == ROTATION else getattr(point, name) for name in names]

        def wrenches(*motions: Tensor) -> Tensor:
            moved = {
                ("R" if name == ROTATION else name): x.unflatten(-1, (n, 3))
                for name, x in zip(names, motions, strict=True)
            }
            if "R" in moved:
                moved["R"] = point.R + skew(moved["R"]) @ point.R
            wrench = self.wrench(replace(point, **moved), t, inputs)
            return together(wrench, point.R).flatten(-2)

        blocks = jacobians(wrenches, *(x.flatten(-2) for x in at))
        return {
            name: block.unflatten(-1, (n, 3)).unflatten(-3, (n, 6))
            for name, block in zip(names, blocks, strict=True)
        }
