"""Where a framework is cut: at the nodes that joints or ties sit at, and at single ones. What is
left of the chains are runs of nodes that know nothing of these.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor

from ..math.shapes import broadcast_shapes

# the nodes that each connects, None = the ground
Joints = tuple[tuple[int | None, int | None], ...]
Ties = tuple[tuple[int, ...], ...]  # the nodes of each


MANNERS = ("backward", "bordered", "forward")  # how runs are eliminated


class Run(NamedTuple):
    """Nodes between two of the interface: the first of them, how many, the places in the interface
    of the nodes before and after them (None = the chain ends there), and the element before the
    first one.
    """

    first: int
    count: int
    before: int | None
    after: int | None
    element: int

    @property
    def manner(self) -> str:
        """From which end its nodes are eliminated: "forward", from its first; "backward", from its
        last, where that alone is free; "bordered", where both are next to the interface.
        """
        if self.before is None:
            return "forward"
        return "backward" if self.after is None else "bordered"

    @property
    def nodes(self) -> range:
        return range(self.first, self.first + self.count)

    @property
    def inner(self) -> range:
        """The elements between its nodes."""
        return range(self.element + 1, self.element + self.count)


class Cut(NamedTuple):
    """interface: its nodes; runs: those of the same length together; direct: elements whose nodes
    are both in the interface, with their places there; joints: places of what each connects;
    ties: of the nodes of each.
    """

    interface: tuple[int, ...]
    runs: tuple[tuple[Run, ...], ...]
    direct: tuple[tuple[int, int, int], ...]
    joints: Joints
    ties: Ties = ()

    @property
    def tied(self) -> tuple[tuple[int, int], ...]:
        """Places of rows and columns of the ties' blocks, see `Framework.tied`."""
        return pairs_of(self.ties)

    @property
    def tied_back(self) -> tuple[int, ...]:
        """Of each of these blocks the number of the one on the other side of the diagonal."""
        back, first = [], 0
        for nodes in self.ties:
            n = len(nodes)
            back += [first + n * j + i for i in range(n) for j in range(n)]
            first += n * n
        return tuple(back)


def pairs_of(ties: Ties) -> tuple[tuple[int, int], ...]:
    """All pairs of the nodes of each tie, one tie after the other."""
    return tuple(pair for nodes in ties for pair in product(nodes, nodes))


@lru_cache(maxsize=64)
def cut(chains: tuple[int, ...], singles: int, joints: Joints, ties: Ties = ()) -> Cut:
    """Of chains of so many elements of order 1, and single nodes behind them."""
    total = sum(N + 1 for N in chains)
    joined = {node for nodes in (*joints, *ties) for node in nodes if node is not None}
    interface = tuple(sorted(joined | set(range(total, total + singles))))
    place = {node: k for k, node in enumerate(interface)}
    runs, direct, start = [], [], 0
    for chain, N in enumerate(chains):
        end = start + N + 1
        for before, after in pairwise(
            (start - 1, *(node for node in interface if start <= node < end), end)
        ):
            count, element = after - before - 1, before - chain
            if count:
                runs.append(
                    Run(
                        before + 1,
                        count,
                        place[before] if before >= start else None,
                        place[after] if after < end else None,
                        element,
                    )
                )
            elif start <= before and after < end:
                direct.append((element, place[before], place[after]))
        start = end
    by_length = tuple(
        tuple(run for run in runs if run.count == n) for n in sorted({run.count for run in runs})
    )
    ends = tuple(tuple(None if node is None else place[node] for node in pair) for pair in joints)
    tied = tuple(tuple(place[node] for node in nodes) for nodes in ties)
    return Cut(interface, by_length, tuple(direct), ends, tied)


@lru_cache(maxsize=256)
def places(nodes: tuple[int, ...], device: torch.device) -> Tensor:
    """As an index."""
    return torch.tensor(nodes, dtype=torch.long, device=device)


def added(
    total: Tensor | None, nodes: tuple[int, ...], part: Tensor, count: int, axes: int
) -> Tensor:
    """total (..., count, *), None = zeros, with part (..., len(nodes), *) added at the nodes."""
    shape = (*part.shape[: -1 - axes], count, *part.shape[part.ndim - axes :])
    if total is None:
        total = part.new_zeros(shape)
    shape = broadcast_shapes(total.shape, shape)
    part = part.expand(*shape[: -1 - axes], len(nodes), *shape[len(shape) - axes :])
    return total.expand(shape).index_add(-1 - axes, places(nodes, part.device), part)
