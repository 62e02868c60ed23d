"""A topology that the library does not have: chains that meet in one node, each eliminated from its
far end towards it.

It is written against `topology.protocols` alone; whatever runs with it knows of who touches whom by
that.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from torchbeam.math.block_tridiagonal import in_unit


@dataclass(frozen=True)
class Star:
    """legs: each one's nodes, from its foot to the joint, which is the last of all; ends: the two
    nodes of each element, in the beam's direction; s (nodes,) m their arclength.
    """

    legs: tuple[tuple[int, ...], ...]
    ends: tuple[tuple[int, int], ...]
    s: Tensor

    @property
    def node_count(self):
        return len(self.s)

    @property
    def element_count(self):
        return len(self.ends)

    def gather(self, x, axes=1):
        return tuple(
            x.index_select(-1 - axes, torch.tensor(side)) for side in zip(*self.ends, strict=True)
        )

    def scatter(self, parts, axes=1):
        shape = list(torch.broadcast_shapes(*(part.shape for part in parts)))
        shape[-1 - axes] = self.node_count
        found = parts[0].new_zeros(shape)
        for side, part in zip(zip(*self.ends, strict=True), parts, strict=True):
            found = found.index_add(
                -1 - axes,
                torch.tensor(side),
                part.expand(*shape[: -1 - axes], *part.shape[-1 - axes :]),
            )
        return found

    def arclength(self, length):
        return self.s.expand(*length.shape[:-1], -1)

    def unknowns(self, moving, like):
        return Unknowns(moving, moving.to(like))

    def diagonal(self, blocks):
        return Matrix(self, blocks)

    def matrix(self, blocks):
        (ii, ij), (ji, jj) = blocks
        return Matrix(self, self.scatter((ii, jj), 2), (ij, ji))


@dataclass(frozen=True)
class Unknowns:
    moving: Tensor
    free: Tensor

    def select(self, x):
        return x * self.free


@dataclass(frozen=True)
class Matrix:
    """couplings: of each element's first node by its second, and back."""

    star: Star
    diagonal: Tensor
    couplings: tuple[Tensor, ...] = ()

    @property
    def tensors(self):
        return self.diagonal, *self.couplings

    def __add__(self, other):
        both = self.couplings and other.couplings
        couplings = (
            tuple(map(torch.add, self.couplings, other.couplings))
            if both
            else self.couplings or other.couplings
        )
        return Matrix(self.star, self.diagonal + other.diagonal, couplings)

    def plus(self, blocks):
        return Matrix(self.star, self.diagonal + blocks, self.couplings)

    def minus(self, blocks):
        return self.plus(-blocks)

    def each(self, function):
        return Matrix(self.star, function(self.diagonal), tuple(map(function, self.couplings)))

    def between(self, function, rows, columns):
        i, j = (
            (self.star.gather(rows, 2), self.star.gather(columns, 2)[::-1])
            if self.couplings
            else ((), ())
        )
        return Matrix(
            self.star,
            function(self.diagonal, rows, columns),
            tuple(map(function, self.couplings, i, j)),
        )

    def times(self, x):
        found = (self.diagonal @ x[..., None])[..., 0]
        parts = tuple(
            (A @ v[..., None])[..., 0]
            for A, v in zip(self.couplings, self.star.gather(x)[::-1], strict=False)
        )
        return found + self.star.scatter(parts) if parts else found

    def dense(self):
        nodes, w = self.diagonal.shape[-3:-1]
        columns = [self.times(e.view(nodes, w)) for e in torch.eye(nodes * w).to(self.diagonal)]
        return torch.stack([c.flatten(-2) for c in columns], -1)

    def rows(self, nodes):
        return Rows(self, list(nodes))

    def grouped(self, unknowns, held):
        return None

    def restricted(self, unknowns):
        free = unknowns.free
        masked = self.between(lambda A, row, column: A * row * column.mT, *(free[..., None],) * 2)
        return System(masked.plus(torch.diag_embed(1 - free)), unknowns)

    def detach(self):
        return self.each(torch.detach)


@dataclass(frozen=True)
class Rows:
    matrix: Matrix
    nodes: list[int]

    def times(self, x):
        return self.matrix.times(x)[..., self.nodes, :]

    def detach(self):
        return Rows(self.matrix.detach(), self.nodes)


@dataclass(frozen=True)
class System:
    matrix: Matrix
    unknowns: Unknowns

    def detach(self):
        return System(self.matrix.detach(), self.unknowns)

    def _towards_the_joint(self, b):
        """Pivots, what leads back, and right-hand sides, of all nodes; steps (node, next one) in
        the order of elimination.
        """
        star = self.matrix.star
        between = {}
        for e, (i, j) in enumerate(star.ends):
            between |= {
                pair: A[..., e, :, :]
                for pair, A in zip(((i, j), (j, i)), self.matrix.couplings, strict=True)
            }
        pivot, right = list(self.matrix.diagonal.unbind(-3)), list(b[..., None].unbind(-3))
        back, steps = {}, [(k, to) for leg in star.legs for k, to in pairwise(leg)]
        for k, to in steps:
            shape = torch.broadcast_shapes(
                *(x.shape[:-2] for x in (pivot[k], between[k, to], right[k]))
            )
            both = torch.cat(
                [x.expand(*shape, *x.shape[-2:]) for x in (between[k, to], right[k])], -1
            )
            solved = torch.linalg.solve(pivot[k].expand(*shape, *pivot[k].shape[-2:]), both)
            back[k], right[k] = solved[..., :-1], solved[..., -1:]
            pivot[to], right[to] = (
                pivot[to] - between[to, k] @ back[k],
                right[to] - between[to, k] @ right[k],
            )
        return pivot, back, right, steps

    def solve(self, b, constant=True):
        pivot, back, x, steps = self._towards_the_joint(self.unknowns.select(b))
        x[-1] = torch.linalg.solve(pivot[-1], x[-1])
        for k, to in reversed(steps):
            x[k] = x[k] - back[k] @ x[to]
        return torch.stack(torch.broadcast_tensors(*x), -3)[..., 0]

    def pivots(self, unit=None):
        pivot = self._towards_the_joint(torch.zeros_like(self.matrix.diagonal[..., 0]))[0]
        blocks = torch.stack(torch.broadcast_tensors(*pivot), -3)
        return in_unit(blocks, unit), torch.isfinite(blocks).all(-1).all(-1).all(-1)

    def positive_definite(self):
        blocks = self.pivots()[0]
        return (torch.linalg.cholesky_ex(blocks + blocks.mT).info == 0).all(-1)
