"""Framework: chains next to each other and single nodes, some of them joined. The nodes of the
chains come one chain after the other, the single ones last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import torch
from torch import Tensor

from .chain import Chain
from .cut import Cut, added, cut, pairs_of, places
from .framework_matrix import FrameworkMatrix
from .framework_unknowns import FrameworkUnknowns
from .protocols import Blocks


@dataclass(frozen=True)
class Framework:
    """See `protocols.Topology`.

    order    of the elements, 1 or 2
    chains   elements of each chain
    singles  how many nodes there are beside the chains
    joints   pairs of nodes that a joint connects; None = the ground. None of them is inside an
             element of order 2
    ties     nodes of which each one's balance depends on all others of the same tie, none of them
             inside an element of order 2 either
    """

    order: int
    chains: tuple[int, ...]
    singles: int = 0
    joints: tuple[tuple[int | None, int | None], ...] = ()
    ties: tuple[tuple[int, ...], ...] = ()

    @property
    def node_count(self) -> int:
        return sum(self.order * N + 1 for N in self.chains) + self.singles

    @property
    def element_count(self) -> int:
        return sum(self.chains)

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """The first node of each chain."""
        return tuple(
            sum(self.order * N + 1 for N in self.chains[:k]) for k in range(len(self.chains))
        )

    @cached_property
    def elements(self) -> tuple[tuple[int, ...], ...]:
        """The first nodes of all elements, the second ones, and so on."""
        firsts = [
            start + self.order * e
            for start, N in zip(self.starts, self.chains, strict=True)
            for e in range(N)
        ]
        return tuple(tuple(first + k for first in firsts) for k in range(self.order + 1))

    @cached_property
    def ends(self) -> tuple[int, ...]:
        """The nodes that are inside no element."""
        middle = set(self.elements[1]) if self.order == 2 else ()
        return tuple(node for node in range(self.node_count) if node not in middle)

    @property
    def cut(self) -> Cut:
        """Of the nodes that are inside no element."""
        ends = self.of_ends
        return cut(ends.chains, ends.singles, ends.joints, ends.ties)

    @cached_property
    def of_ends(self) -> Framework:
        """Of order 1, between these."""
        if self.order == 1:
            return self
        place = {node: k for k, node in enumerate(self.ends)}
        return Framework(
            1,
            self.chains,
            self.singles,
            tuple(tuple(place.get(node) for node in pair) for pair in self.joints),
            tuple(tuple(place[node] for node in nodes) for nodes in self.ties),
        )

    def gather(self, x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
        return tuple(x.index_select(-1 - axes, places(nodes, x.device)) for nodes in self.elements)

    def scatter(self, parts: tuple[Tensor, ...], axes: int = 1) -> Tensor:
        total = None
        for nodes, part in zip(self.elements, parts, strict=True):
            total = added(total, nodes, part, self.node_count, axes)
        return total

    def at_joints(self, x: Tensor) -> Tensor:
        """Nodes (..., nodes, w) -> their values (..., J, 2, w) at both ends of each joint; zeros at
        the ground.
        """
        ends = x.index_select(-2, places(self._joined, x.device)).unflatten(-2, (-1, 2))
        return ends * self._not_ground(x) if self._grounded else ends

    def from_joints(self, push: Tensor, total: Tensor) -> Tensor:
        """total (..., nodes, w) with (..., J, 2, w) of the joints' ends added."""
        push = (push * self._not_ground(push) if self._grounded else push).flatten(-3, -2)
        return added(total, self._joined, push, total.shape[-2], 1)

    @cached_property
    def tie_nodes(self) -> tuple[int, ...]:
        """The nodes of all ties, one tie after the other."""
        return tuple(node for nodes in self.ties for node in nodes)

    @cached_property
    def tied(self) -> tuple[tuple[int, int], ...]:
        """Nodes of rows and columns of the ties' blocks: all pairs of each tie."""
        return pairs_of(self.ties)

    def from_ties(self, push: Tensor, total: Tensor) -> Tensor:
        """total (..., nodes, w) with (..., n, w) at `tie_nodes` added."""
        return added(total, self.tie_nodes, push, total.shape[-2], 1)

    @cached_property
    def _joined(self) -> tuple[int, ...]:
        """The nodes of all joints' ends; 0 for the ground."""
        return tuple(node or 0 for pair in self.joints for node in pair)

    @cached_property
    def _grounded(self) -> bool:
        return any(node is None for pair in self.joints for node in pair)

    def _not_ground(self, like: Tensor) -> Tensor:
        """(J, 2, 1)"""
        return like.new_tensor(
            [[float(node is not None) for node in pair] for pair in self.joints]
        )[..., None]

    def arclength(self, length: Tensor) -> Tensor:
        """Each chain's own; 0 of single nodes."""
        sizes = [self.order * N for N in self.chains]
        parts = [
            Chain(self.order, N).arclength(part)
            for N, part in zip(self.chains, length.split(sizes, -1), strict=True)
        ]
        return torch.cat((*parts, length.new_zeros(*length.shape[:-1], self.singles)), -1)

    def unknowns(self, moving: Tensor, like: Tensor) -> FrameworkUnknowns:
        return FrameworkUnknowns(moving, None if bool(moving.all()) else moving.to(like))

    def diagonal(self, blocks: Tensor) -> FrameworkMatrix:
        return FrameworkMatrix(self, blocks)

    def matrix(self, blocks: Blocks) -> FrameworkMatrix:
        own = self.scatter(tuple(blocks[k][k] for k in range(self.order + 1)), 2)
        return FrameworkMatrix(
            self, own, tuple(blocks[i][j] for i, j in permutations(range(self.order + 1), 2))
        )
