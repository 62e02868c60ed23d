"""Instant: what the states of all forms have in common; points and reactions read from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.entry_point import entry_point
from ..core.leaves import Tree, batch_shapes, map_leaves, sent
from ..core.summary import kind, lines, point, span, statuses
from ..core.validation import broadcast, refusal, shown

Made = Tensor | Callable[[], Tensor]


@entry_point
class Point:
    """One node. All in frame a: position (..., 3) m, velocity (..., 3) m/s, rotation (..., 3, 3)
    section axes -> a, spin (..., 3) rad/s. Each may be given by a function, which is called where
    it is asked for.
    """

    def __init__(self, position: Made, velocity: Made, rotation: Made, spin: Made) -> None:
        self._made = position, velocity, rotation, spin

    @cached
    def position(self) -> Tensor:
        return self._taken(0)

    @cached
    def velocity(self) -> Tensor:
        return self._taken(1)

    @cached
    def rotation(self) -> Tensor:
        return self._taken(2)

    @cached
    def spin(self) -> Tensor:
        return self._taken(3)

    def _taken(self, k: int) -> Tensor:
        tensor = self._made[k]
        return tensor() if callable(tensor) else tensor

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.position, self.velocity, self.rotation, self.spin))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(self)

    def __repr__(self) -> str:
        return (
            f"Point(position={self.position}, velocity={self.velocity}, "
            f"rotation={self.rotation}, spin={self.spin})"
        )


class Reaction(NamedTuple):
    """Load of a support on the beam, frame a: force (..., 3) N, moment (..., 3) N m."""

    force: Tensor
    moment: Tensor


READINGS = 12  # numbers of a joint in a state; what it remembers comes behind


class JointReading(NamedTuple):
    """A joint: its coordinate, rad of an angle counted over turns or m of a travel, of two
    (..., 2) in their order, zero as drawn; of a `Ball` (..., 3) the rotation vector, as seen from
    its first part; None = it has none; the rate, of a `Ball` the spin of the second part against
    the first, likewise; force (..., 3) N and moment (..., 3) N m of the joint on its second part,
    at its point there, frame a (after an implicit step their mean over it); memory (..., 2) of a
    law with memory: its hysteretic variable (of `ElastoPlastic` the plastic part of the coordinate,
    of `BoucWen` z), and the energy J that it has lost; None where no joint has such a law.
    """

    coordinate: Tensor | None
    rate: Tensor | None
    force: Tensor
    moment: Tensor
    memory: Tensor | None = None

    @classmethod
    def of(cls, row: Tensor, coordinates: tuple[int, ...]) -> JointReading:
        """row (..., 12 or more): coordinates, rates, force, moment; coordinates: which it has."""

        def own(first: int) -> Tensor | None:
            if not coordinates:
                return None
            if len(coordinates) == 1:
                return row[..., first + coordinates[0]]
            return row[..., first : first + len(coordinates)]

        memory = row[..., READINGS : READINGS + 2] if row.shape[-1] > READINGS else None
        return cls(own(0), own(3), row[..., 6:9], row[..., 9:READINGS], memory)


def where(parts: tuple[Any, ...], nodes: Tensor) -> list[str]:
    """Where the beam's tip is (..., nodes, 3) m, or which parts there are, in words."""
    if parts:
        return ["parts " + ", ".join(repr(part.name) for part in parts)]
    return [f"tip at {point(nodes[..., -1, :])} m"]


class Instant(Tree):
    """Views common to the states of all forms: nodes, tip, load of the support; and operations on
    all fields alike.
    """

    parts: ClassVar[tuple[Any, ...]] = ()

    @property
    def summary(self) -> dict[str, str]:
        """Description in words, by headings."""
        return {
            "time": f"t = {span(self.t)} s",
            "nodes": f"{self.nodes.shape[-2]} nodes",
            "end": "; ".join(where(self.parts, self.nodes)),
            "status": statuses(self.status),
            "batch": kind(self.batch_shape, self.nodes),
        }

    def __repr__(self) -> str:
        return lines(type(self).__name__, *self.summary.values())

    @property
    def tip(self) -> Point:
        return self.node(-1)

    @property
    def nodes(self) -> Tensor:
        """(..., N+1, 3) m, frame a."""
        return self.position

    @property
    def root(self) -> Reaction:
        """Of the clamp at node 0."""
        return Reaction(self.reaction[..., :3], self.reaction[..., 3:])

    def map(self, function: Any, *others: Any) -> Any:
        """The same kind of object with `function` applied field by field."""
        return map_leaves(lambda value, axes, *theirs: function(value, *theirs), self, *others)

    def __getitem__(self, index: Any) -> Any:
        """Index the leading axes of every field: `states[-1]` of a trajectory is its last state,
        `states[..., 0]` the first sample of a batch. Raises IndexError where there is none such.
        """
        parts = index if isinstance(index, tuple) else (index,)
        open_ = any(part is ... for part in parts)  # counts from the end: a field's own axes stay
        try:
            return map_leaves(
                lambda x, axes: x[(*parts, *(slice(None),) * axes)] if open_ else x[index], self
            )
        except (IndexError, TypeError, RuntimeError, ValueError):
            axes = " and ".join(str(tuple(shape)) for shape in dict.fromkeys(batch_shapes(self)))
            raise IndexError(
                f"{type(self).__name__}[{shown(index)}] was asked for; its leading axes are {axes}"
            ) from None

    def where(self, mask: Tensor, other: Any) -> Any:
        """Fields of this one where mask (...) holds, of `other` elsewhere."""
        return map_leaves(
            lambda a, axes, b: torch.where(mask[(...,) + (None,) * axes], a, b), self, other
        )

    def clone(self) -> Any:
        return self.map(torch.clone)

    def detach(self) -> Any:
        return self.map(torch.detach)

    def to(self, *args: Any, **kwargs: Any) -> Any:
        """On another device, or in another floating dtype: a status stays a whole number."""
        return sent(self, *args, **kwargs)

    @classmethod
    def stack(cls, states: list) -> Any:
        """States in time order -> one object whose fields have time as their first axis. Raises
        ValueError for what is no sequence of them.
        """
        if not isinstance(states, (list, tuple)) or not all(isinstance(s, cls) for s in states[:]):
            raise refusal(f"states = {shown(states)}", "a list of states")
        if not states:
            raise refusal("states = []", "one or more", are=True)
        broadcast("states", *(state.nodes.shape[:-1] for state in states))
        return states[0].map(lambda *x: torch.stack(torch.broadcast_tensors(*x)), *states[1:])
