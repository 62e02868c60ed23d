"""Framework: lines of elements next to each other and single nodes, some of them joined. The nodes
of the lines come one line after the other, the single ones last. A beam is one line.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.element_shapes import SHAPES, X
from .cut import Cut, cut, pairs_of
from .framework_matrix import FrameworkMatrix, dense_of
from .framework_unknowns import FrameworkUnknowns
from .places import Places, added, at_i, at_j, even, interleaved, take
from .protocols import Blocks


@dataclass(frozen=True)
class Framework:
    """See `protocols.Topology`.

    order    of the elements, 1 or 2: those of a line have the nodes 0, 1; 1, 2; ..., or 0, 1, 2;
             2, 3, 4; ... of it
    chains   elements of each line
    singles  how many nodes there are beside the lines
    joints   of each of `Joints` the nodes that it connects; None = the ground. None is inside an
             element of order 2
    ties     rows of which each depends on all others of the same tie: nodes, none of them inside an
             element of order 2 either, and behind them multipliers
    """

    order: int
    chains: tuple[int, ...]
    singles: int = 0
    joints: tuple[tuple[int | None, int | None], ...] = ()
    ties: tuple[tuple[int, ...], ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """What is found from these is found again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def node_count(self) -> int:
        return sum(self.order * N + 1 for N in self.chains) + self.singles

    @cached_property
    def element_count(self) -> int:
        return sum(self.chains)

    @cached_property
    def is_line(self) -> bool:
        """Whether it is one line of nodes."""
        return len(self.chains) == 1 and not self.singles

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """The first node of each line."""
        return tuple(
            sum(self.order * N + 1 for N in self.chains[:k]) for k in range(len(self.chains))
        )

    @cached_property
    def elements(self) -> tuple[Places, ...]:
        """The first nodes of all elements, the second ones, and so on."""
        firsts = [
            start + self.order * e
            for start, N in zip(self.starts, self.chains, strict=True)
            for e in range(N)
        ]
        return tuple(even(first + k for first in firsts) for k in range(self.order + 1))

    @property
    def midside(self) -> bool:
        """Whether elements have a node inside."""
        return SHAPES[self.order].midside

    @cached_property
    def ends(self) -> Places:
        """The nodes that are inside no element."""
        middle = set(self.elements[1]) if self.midside else ()
        return even(node for node in range(self.node_count) if node not in middle)

    @cached_property
    def ends_first(self) -> Places:
        """Where each node is in the row of those inside no element, then those inside one."""
        row = {node: k for k, node in enumerate((*self.ends, *self.elements[1]))}
        return even(row[node] for node in range(self.node_count))

    @cached_property
    def links(self) -> Framework:
        """Of order 1: from each node of an element to the next one."""
        if not self.midside:
            return self
        return Framework(1, tuple(self.order * N for N in self.chains), self.singles)

    @property
    def cut(self) -> Cut:
        """Of the nodes that are inside no element."""
        return self.cut_without((), ())

    def cut_without(self, held: tuple[int, ...], fixed: tuple[int, ...]) -> Cut:
        """The same without some that have no unknowns, at the ends of the lines; of these nodes
        supports hold some, at least in part, which are `fixed`.
        """
        ends = self.of_ends
        return cut(ends.chains, ends.singles, ends.joints, ends.ties, held, fixed)

    @cached_property
    def of_ends(self) -> Framework:
        """Of order 1, between these."""
        if not self.midside:
            return self
        place = {node: k for k, node in enumerate(self.ends)}
        behind = sorted({node for nodes in self.ties for node in nodes if node >= self.node_count})
        place |= {node: node - self.node_count + len(self.ends) for node in behind}
        return Framework(
            1,
            self.chains,
            self.singles,
            tuple(tuple(place.get(node) for node in pair) for pair in self.joints),
            tuple(tuple(place[node] for node in nodes) for nodes in self.ties),
        )

    def gather(self, x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
        return tuple([take(x, nodes, axes) for nodes in self.elements])

    def scatter(self, parts: tuple[Tensor, ...], axes: int = 1) -> Tensor:
        if self.is_line:
            i, *middle, j = parts
            if middle:
                i, j = interleaved(i, *middle, axes), interleaved(torch.zeros_like(j), j, axes)
            return at_i(i, axes) + at_j(j, axes)
        total = None
        for nodes, part in zip(self.elements, parts, strict=True):
            total = added(total, nodes, part, self.node_count, axes)
        return total

    def without(self, total: Tensor, parts: tuple[Tensor, Tensor], axes: int = 1) -> Tensor:
        """Of order 1, nodes (..., nodes, *) less what elements give them, see `scatter`."""
        if self.is_line:
            return total - at_i(parts[0], axes) - at_j(parts[1], axes)
        return total - self.scatter(parts, axes)

    def coupled(self, x: Tensor, axes: int = 1) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Nodes (..., nodes, *) -> their values at the rows and at the columns of the couplings of
        a matrix, see `FrameworkMatrix`.
        """
        rows = tuple([take(x, at, axes) for at, _ in self.pairs[::2]])
        columns = tuple([take(x, at, axes) for _, at in self.pairs[::2]])
        i, j, *far = (x for pair in zip(rows, columns, strict=True) for x in pair)
        return (i, j, *far), (j, i, *far[::-1])

    @cached_property
    def pairs(self) -> tuple[tuple[Places, Places], ...]:
        """The nodes of the rows and of the columns of a matrix's couplings."""
        i, j = self.links.elements
        far = (self.elements[::2], self.elements[::-2]) if self.midside else ()
        return (i, j), (j, i), *far

    def at_joints(self, x: Tensor) -> Tensor:
        """Nodes (..., nodes, w) -> values (..., J, 2, w) at joints' ends; 0 at the ground."""
        ends = take(x, self._joined).unflatten(-2, (-1, 2))
        return ends * self._not_ground(x) if self._grounded else ends

    def from_joints(self, push: Tensor, total: Tensor) -> Tensor:
        """total (..., nodes, w) with (..., J, 2, w) of the joints' ends added."""
        push = (push * self._not_ground(push) if self._grounded else push).flatten(-3, -2)
        return added(total, self._joined, push, total.shape[-2], 1)

    @cached_property
    def joint_ties(self) -> tuple[tuple[int, ...], ...]:
        """Rows of joints: of each its nodes, and that of its multipliers."""
        rows = [(*pair, self.node_count + k) for k, pair in enumerate(self.joints)]
        return tuple(tuple(row for row in tie if row is not None) for tie in rows)

    def of_ties(self, blocks: Tensor) -> Tensor:
        """Blocks (..., J, n, n, w, w) of joints, or of ends -> (..., m, w, w) of their ties."""
        n, blocks = blocks.shape[-3], blocks.flatten(-5, -3)
        if not self._grounded:
            return blocks
        there = [[node is not None for node in (*pair, 0)[:n]] for pair in self.joints]
        both = (a and b for tie in there for a, b in product(tie, tie))
        return take(blocks, tuple(k for k, is_there in enumerate(both) if is_there), 2)

    def by_nodes(self, blocks: Tensor) -> Tensor:
        """(..., J w, nodes w): rows of joints by the moves of their ends (..., J, 2, w, w)."""
        there = [
            (2 * k + i, k, node)
            for k, pair in enumerate(self.joints)
            for i, node in enumerate(pair)
            if node is not None
        ]
        at, rows, columns = zip(*there, strict=True)
        part = take(blocks.flatten(-4, -3), at, 2), rows, columns
        return dense_of(len(self.joints), self.node_count, [part])

    @cached_property
    def tied(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Nodes of the rows and of the columns of the ties' blocks: of all pairs of each tie."""
        rows, columns = zip(*pairs_of(self.ties), strict=True)
        return rows, columns

    @cached_property
    def _joined(self) -> tuple[int, ...]:
        """The nodes of all joints' ends; 0 for the ground."""
        return tuple(node or 0 for pair in self.joints for node in pair)

    @cached_property
    def _grounded(self) -> bool:
        return any(node is None for pair in self.joints for node in pair)

    def _not_ground(self, like: Tensor) -> Tensor:
        """(J, 2, 1)"""
        return _there(self.joints, like.dtype, like.device)

    def arclength(self, length: Tensor) -> Tensor:
        """Each line's own; 0 of single nodes."""
        parts = []
        for part in length.split([self.order * N for N in self.chains], -1):
            midside = self.midside
            ends = within_elements(part, (0.0, 1.0)).flatten(-2) if midside else part.cumsum(-1)
            parts.append(pad(ends, (1, 0)))
        return torch.cat((*parts, length.new_zeros(*length.shape[:-1], self.singles)), -1)

    def unknowns(self, moving: Tensor, like: Tensor) -> FrameworkUnknowns:
        return FrameworkUnknowns.of(self, moving, like)

    def diagonal(self, blocks: Tensor) -> FrameworkMatrix:
        return FrameworkMatrix(self, blocks)

    def matrix(self, blocks: Blocks) -> FrameworkMatrix:
        diagonal = self.scatter(tuple([blocks[k][k] for k in range(self.order + 1)]), 2)
        if not self.midside:
            return FrameworkMatrix(self, diagonal, (blocks[0][1], blocks[1][0]))
        (_, im, ij), (mi, _, mj), (ji, jm, _) = blocks
        near = interleaved(im, mj, 2), interleaved(mi, jm, 2)
        return FrameworkMatrix(self, diagonal, (*near, ij, ji))


@lru_cache(maxsize=64)
def _there(
    joints: tuple[tuple[int | None, int | None], ...], dtype: torch.dtype, device: torch.device
) -> Tensor:
    """(J, 2, 1) 1 where an end of joints is a node, 0 where it is the ground."""
    there = [[[float(node is not None)] for node in pair] for pair in joints]
    return torch.tensor(there, dtype=dtype, device=device)


def within_elements(length: Tensor, x: tuple[float, ...]) -> Tensor:
    """Arc length (..., N, len(x)) m at places x in [-1, 1] of elements of order 2, of the lengths
    (..., 2 N) m that their stations stand for. With ds/dx = J + J' x, which is that length,
    s = s_0 + J (1 + x) + J' (x^2 - 1)/2: a midside node need not be in the middle.
    """
    first, second = length.unflatten(-1, (-1, 2))[..., None].unbind(-2)
    mean, slope, x = (first + second) / 2, (second - first) / (2 * X), length.new_tensor(x)
    whole = first + second
    return whole.cumsum(-2) - whole + mean * (1 + x) + slope * (x * x - 1) / 2
