"""Reduced states: in the coordinates in which they were solved for, public as far as asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.entry_point import entry_point
from ..core.leaves import with_values
from ..math.shapes import broadcast_shapes
from .instant import Point, Reaction

AT_NODES = ("position", "rotation", "velocity", "spin")
REMEMBERED = (
    "internal",
    "joints",
    "tendons",
    "memory",
    "inelastic",
)  # beside motion, None = there is none


@entry_point
class ReducedStates:
    """A state, and parts of the trajectory from there on, one after the other, in the coordinates
    of a space (see `torchbeam.nodal.coordinates`): of a plane they are half the numbers, and of the
    tip a few.
    """

    def __init__(self, begun: Any, parts: Sequence[Any], space: Any) -> None:
        self._begun, self._parts = begun, tuple(part for part in parts if len(part.t))
        self.space = space

    @property
    def parts(self) -> tuple[Any, ...]:
        """All of them, the first instant as a part too."""
        if self._begun is not None:
            first = self._begun.map(lambda x: x[None])
            self._begun, self._parts = None, (first, *self._parts)
        return self._parts

    @property
    def followers(self) -> tuple[int, tuple[Any, ...]]:
        """Parts without the first instant, where it stands by itself; how many are left out."""
        return (0 if self._begun is None else 1), self._parts

    @property
    def one(self) -> Any:
        """A state, or some, by which all of them are known."""
        return self._parts[0] if self._begun is None else self._begun

    def whole(self) -> Any:
        """All of them, in these coordinates."""
        parts = self.parts
        whole = whole_of(parts)
        recorded = torch.is_grad_enabled() and torch._C._is_fwd_grad_enabled()
        if recorded or not any(part.position.requires_grad for part in parts):
            self._parts = (whole,)  # the memory of the others is free
        return whole

    def public(self) -> Any:
        """All of them."""
        return self.space.to_public(self.whole())

    def some(self, index: Any) -> Any:
        """Those at some instants."""
        return self.space.to_public(self.whole()[index])

    def node(self, index: int) -> Point:
        """As `State.node`."""
        nodes = self.one.position.shape[-2]
        at = slice(index % nodes, index % nodes + 1)
        return Point(
            lambda: self.space.public_position(self._field("position", index)),
            lambda: self.space.public_vector(self._field("velocity", index)),
            lambda: self._of({"rotation": at}, at).axes[..., 0, :, :],
            lambda: self._of(dict.fromkeys(AT_NODES, at), at).row(0).spin,
        )

    @property
    def nodes(self) -> Tensor:
        """(..., N+1, 3) m, frame a."""
        return self.space.public_position(self._field("position", slice(None)))

    @property
    def root(self) -> Reaction:
        """As `State.root`."""
        return self._of({"reaction": slice(None)}).root

    @property
    def status(self) -> Tensor:
        return self._joined(lambda part: part.status)

    def _field(self, name: str, nodes: slice | int) -> Tensor:
        """Of these nodes alone, (time, ..., *)."""
        return self._joined(lambda part: getattr(part, name)[..., nodes, :])

    def _joined(self, of: Callable[[Any], Tensor]) -> Tensor:
        first = () if self._begun is None else (of(self._begun)[None],)
        return joined(*first, *map(of, self._parts))

    def _of(self, rows: dict[str, slice], nodes: slice = slice(0)) -> Any:
        """With these rows of these fields, and none of the others."""
        names, cut = (*AT_NODES, "stress", "reaction"), []
        for part in self.parts:
            part_fields = {
                name: getattr(part, name)[..., rows.get(name, slice(0)), :] for name in names
            }
            cut.append(with_values(part, **part_fields))
        return self.space.of_nodes(nodes).to_public(whole_of(cut))


def whole_of(parts: Sequence[Any]) -> Any:
    """Parts of a trajectory as one."""
    return parts[0].map(joined, *parts[1:])


def joined(*parts: Tensor) -> Tensor:
    """Parts of a series, one after the other, of common batch axes."""
    if len(parts) == 1:
        return parts[0]
    shape = broadcast_shapes(*(x.shape[1:] for x in parts))
    news = [(None,) * (len(shape) + 1 - x.ndim) for x in parts]
    pairs = zip(parts, news, strict=True)
    return torch.cat([x[(slice(None), *new)].expand(len(x), *shape) for x, new in pairs])
