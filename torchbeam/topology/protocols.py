"""What a topology, its unknowns and its matrices must be able to do: all that the nodal form, the
equations and the solvers know of who touches whom.

Values of nodes are tensors (..., nodes, *), those of elements (..., elements, *), with `axes` axes
of their own; w is the number of unknowns of a node. A block (..., w, w) is the derivative of one
node's balance by the move of another one, or its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from torch import Tensor

# of elements (..., elements, w, w): rows and columns are an element's nodes, in order
Blocks = tuple[tuple[Tensor, ...], ...]


class Topology(Protocol):
    """Which nodes each element lies between."""

    @property
    def node_count(self) -> int: ...

    @property
    def element_count(self) -> int: ...

    def gather(self, x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
        """Nodes (..., nodes, *) -> their values (..., elements, *) at the first, the second ...
        node of each element.
        """
        ...

    def scatter(self, parts: tuple[Tensor, ...], axes: int = 1) -> Tensor:
        """What elements give their first, their second ... node (..., elements, *), summed at nodes
        (..., nodes, *): the transpose of `gather`.
        """
        ...

    def arclength(self, length: Tensor) -> Tensor:
        """(..., nodes) m along the beam, from the lengths (..., stations) m that the elements'
        stations stand for.
        """
        ...

    def unknowns(self, moving: Tensor, like: Tensor) -> Unknowns:
        """Those of all nodes' moves that nothing holds, a mask (nodes, w); `like`: a tensor of the
        scene's dtype and device.
        """
        ...

    def diagonal(self, blocks: Tensor) -> Matrix:
        """The matrix of what nodes do by themselves (..., nodes, w, w); of some alone too."""
        ...

    def matrix(self, blocks: Blocks) -> Matrix:
        """The matrix that the elements' blocks add up to."""
        ...


class Unknowns(Protocol):
    """The moves that nothing holds, of some or of all nodes."""

    @property
    def moving(self) -> Tensor:
        """(n, w) bool: what is free, of the nodes that there are."""
        ...

    def select(self, x: Tensor) -> Tensor:
        """All nodes (..., nodes, w) -> those with unknowns, zero where held."""
        ...


class Matrix(Protocol):
    """A linear map of all nodes' moves to all nodes' balances; it keeps gradients."""

    @property
    def diagonal(self) -> Tensor:
        """(..., nodes, w, w): each node's balance by its own move."""
        ...

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """All that it holds."""
        ...

    def __add__(self, other: Any) -> Matrix: ...

    def plus(self, blocks: Tensor) -> Matrix:
        """With (..., nodes, w, w) more on the diagonal."""
        ...

    def minus(self, blocks: Tensor) -> Matrix:
        """With so much less."""
        ...

    def each(self, function: Callable[[Tensor], Tensor]) -> Matrix:
        """With function(block) in the place of each block."""
        ...

    def between(self, function: Callable[..., Tensor], rows: Tensor, columns: Tensor) -> Matrix:
        """With function(block, value of its row's node, value of its column's node) in the place of
        each block, of values (..., nodes, m, n).
        """
        ...

    def times(self, x: Tensor) -> Tensor:
        """The product with moves (..., nodes, w)."""
        ...

    def dense(self) -> Tensor:
        """(..., w nodes, w nodes)."""
        ...

    def rows(self, nodes: tuple[int, ...]) -> MatrixRows:
        """Those of some nodes."""
        ...

    def grouped(self, unknowns: Any, held: float) -> Any | None:
        """Of the unknowns, as a chain that multiplies and solves blocks of vectors, see
        `BlockChain`, with `held` times the largest number of the diagonal on it where a move
        is held; None where there is none. `unknowns.grouped` says which of a vector's numbers are
        free moves.
        """
        ...

    def restricted(self, unknowns: Any) -> System:
        """To the unknowns: with a 1 on the diagonal and nothing beside it where a move is held."""
        ...


class MatrixRows(Protocol):
    """Some nodes of a matrix."""

    def times(self, x: Tensor) -> Tensor:
        """The product (..., K, w) with moves (..., nodes, w)."""
        ...

    def detach(self) -> MatrixRows: ...


class System(Protocol):
    """A matrix of the unknowns alone, that solves."""

    def solve(self, b: Tensor, constant: bool = True) -> Tensor:
        """Moves (..., nodes, w), zero where held, for right-hand sides (..., nodes, w), whose
        values there do not count. constant: the matrix has no gradient; what b has is taken once,
        backward by a solve with the transposed matrix.
        """
        ...

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Pivot blocks (..., n, w, w) of the elimination, zeros after a singular one, by moves
        measured in `unit` (..., w), None = as they are; (...) bool: whether all are finite.
        """
        ...

    def positive_definite(self) -> Tensor:
        """(...) bool: whether the matrix, where it is symmetric, is."""
        ...

    def detach(self) -> System: ...


def total(*matrices: Matrix | None) -> Matrix | None:
    """The sum of those that are there; None where none is."""
    there = [matrix for matrix in matrices if matrix is not None]
    return sum(there[1:], there[0]) if there else None
