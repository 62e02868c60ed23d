"""Where a framework is cut: at the nodes that joints or ties sit at, and at single ones. What is
left of the chains are runs of nodes that know nothing of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby, pairwise, product
from typing import NamedTuple

from .places import Places, even

# the nodes that each connects, None = the ground
Joints = tuple[tuple[int | None, int | None], ...]
Ties = tuple[tuple[int, ...], ...]  # the nodes of each


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
        """Which of its ends is free: "forward", its first, or both, whence its nodes are eliminated
        onwards; "backward", its last; "between", none.
        """
        if self.before is None:
            return "forward"
        return "backward" if self.after is None else "between"

    @property
    def nodes(self) -> range:
        return range(self.first, self.first + self.count)

    @property
    def inner(self) -> range:
        """The elements between its nodes."""
        return range(self.element + 1, self.element + self.count)


class Line(NamedTuple):
    """Runs of the same manner and length, which are eliminated side by side, towards a node of the
    interface where there is one.

    runs, count     how many, of how many nodes each
    nodes, inner    of all runs: the nodes in order, and the elements between those of a run
    backward        whether from the last node to the first
    towards, back   the places in the interface, one of each run, towards which and from which it
                    goes; () = there are none
    before, after   the elements between these and a run's first and last node
    """

    runs: int
    count: int
    nodes: Places
    inner: Places
    backward: bool
    towards: Places
    back: Places
    before: Places
    after: Places

    @property
    def alone(self) -> bool:
        """Whether it is one run, with no part in the interface."""
        return self.runs == 1 and not self.towards

    @classmethod
    def of(cls, runs: tuple[Run, ...]) -> Line:
        backward, count = runs[0].manner == "backward", runs[0].count
        way = -1 if backward else 1
        ends = [(run.before, run.after)[::way] for run in runs]
        elements = [(run.element, run.element + count)[::way] for run in runs]
        back, towards, before, after = (
            tuple(pair[k] for pair, place in zip(pairs, ends, strict=True) if place[k] is not None)
            for pairs, k in ((ends, 0), (ends, 1), (elements, 0), (elements, 1))
        )
        return cls(
            len(runs),
            count,
            even(node for run in runs for node in run.nodes[::way]),
            even(element for run in runs for element in run.inner[::way]),
            backward,
            towards,
            back,
            even(before),
            even(after),
        )


@dataclass(frozen=True)
class Cut:
    """interface: its nodes; runs: those of the same length together; lines: the same by manner
    too; order: where each node is in the row of all lines' nodes, one after the other, those of the
    interface and one that stands for all that have no unknowns; direct: elements whose nodes
    are both in the interface, with their places there; multipliers: how many rows of these there
    are behind the nodes; ties: of the nodes of each; fixed: places of nodes that supports hold,
    wholly or in part.
    """

    interface: tuple[int, ...]
    runs: tuple[tuple[Run, ...], ...]
    lines: tuple[Line, ...]
    order: Places
    direct: tuple[tuple[int, int, int], ...]
    multipliers: int = 0
    ties: Ties = ()
    fixed: frozenset[int] = frozenset()

    def holds(self, nodes: tuple[int, ...]) -> bool:
        """Whether any of them is in the interface."""
        return bool(nodes and self.interface) and not {*nodes}.isdisjoint(self.interface)

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
def cut(
    chains: tuple[int, ...],
    singles: int,
    joints: Joints,
    ties: Ties = (),
    held: tuple[int, ...] = (),
    fixed: tuple[int, ...] = (),
) -> Cut:
    """Of chains of so many elements of order 1, and single nodes behind them, without nodes at the
    ends of the chains that are held; of others some are `fixed`, at least in part.
    """
    total = sum(N + 1 for N in chains)
    joined = {node for pair in joints for node in pair if node is not None}
    joined |= {node for nodes in ties for node in nodes if node < total + singles}
    interface = tuple(sorted(joined | set(range(total, total + singles))))
    place = {node: k for k, node in enumerate(interface)}
    runs, direct, start = [], [], 0
    for chain, N in enumerate(chains):
        last = start + N
        line_nodes = [node for node in range(start, last + 1) if node in joined or node not in held]
        ends = (
            line_nodes[0] - 1,
            *(node for node in line_nodes if node in joined),
            line_nodes[-1] + 1,
        )
        for before, after in pairwise(ends):
            count, element = after - before - 1, before - chain
            sides = [
                place[node] if line_nodes[0] <= node <= line_nodes[-1] else None
                for node in (before, after)
            ]
            if count:
                runs.append(Run(before + 1, count, *sides, element))
            elif None not in sides:
                direct.append((element, *sides))
        start = last + 1
    by_length = tuple(
        tuple(run for run in runs if run.count == n) for n in sorted({run.count for run in runs})
    )
    lines = tuple(
        Line.of(tuple(same))
        for runs in by_length
        for _, same in groupby(sorted(runs, key=_manner), _manner)
    )
    row = [node for line in lines for node in line.nodes] + [*interface]
    at = {node: k for k, node in enumerate(row)}
    order = even(at.get(node, len(row)) for node in range(total + singles))
    multipliers = max((node + 1 for nodes in ties for node in nodes), default=0) - total - singles
    place |= {total + singles + k: len(interface) + k for k in range(multipliers)}
    tied = tuple(tuple(place[node] for node in nodes) for nodes in ties)
    there = frozenset(place[node] for node in fixed if node in place)
    return Cut(interface, by_length, lines, order, tuple(direct), max(0, multipliers), tied, there)


def _manner(run: Run) -> tuple[bool, bool]:
    return run.before is None, run.after is None
