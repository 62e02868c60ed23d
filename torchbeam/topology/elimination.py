"""Elimination: the lines of nodes between those of the interface, then the system of its moves and
the multipliers.

A line is eliminated node by node towards an interface node r, so that each one's moves follow from
the next one's: x_i = y_i - A_i x_{i+1}, of the last one with x_r in the place of x_{i+1}. Where it
begins at another interface node l, y_i has columns f_i of x_l too, and the row of l goes along,
with its block g_i at the line's first node that is left: g_{i+1} = -g_i A_i. What is left of the
last row and of g goes into the rows of r and l. A line with one end in the interface begins at the
other, one with none is a chain by itself; lines alike are eliminated side by side.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_tridiagonal import backward, broadcast_matrices, forward
from ..math.first_derivative import first_only
from .cut import Cut, Line
from .interface import Interface
from .places import Places, take

Rows = tuple[list[Tensor], list[Tensor]]  # of each node of a line, see `forward`


class FrameworkSolve(torch.autograd.Function):
    """`solve` with a matrix that is a constant: forward mode and backward (the transposed system)
    in the right-hand side.

    The matrix carries no gradient: this is the linear solve of the implicit function theorem, where
    the residual in b carries it all. Second derivatives through it would be wrong and are refused.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(how: Cut, b: Tensor, *parts: Tensor) -> Tensor:
        return solve(how, b, *parts)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        how, b, *parts = inputs
        ctx.how = how
        ctx.save_for_backward(b, *parts)
        ctx.save_for_forward(b, *parts)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:
        b, *parts = ctx.saved_tensors
        # backward may be called where autocast is on
        with torch.no_grad(), torch.autocast(grad.device.type, enabled=False):
            g = solve(ctx.how, grad, *transposed(ctx.how, *parts)).sum_to_size(b.shape)
        return None, first_only(g, grad, b), *(None for _ in parts)

    @staticmethod
    def jvp(ctx: Any, _how: None, b_t: Tensor, *_: Any) -> Tensor:
        b, *parts = ctx.saved_tensors
        return first_only(solve(ctx.how, b_t, *parts), b_t, b)


def transposed(
    how: Cut,
    D: Tensor,
    U: Tensor,
    L: Tensor,
    tied: Tensor | None = None,
    held: Tensor | None = None,
) -> tuple[Tensor | None, ...]:
    """The parts of the transposed matrix."""
    if tied is not None:
        tied = take(tied, how.tied_back, 2).mT
    return D.mT, L.mT, U.mT, tied, held


def solve(how: Cut, b: Tensor, *parts: Tensor) -> Tensor:
    """The solution (..., n + J, w), zero in nodes without unknowns."""
    system, rows = condense(how, b, *parts)
    inner = None if system is None else system.solution()
    x = [restored(line, line_rows, inner) for line, line_rows in zip(how.lines, rows, strict=True)]
    interface, last = len(how.interface), how.lines[-1] if how.lines else None
    if system is None and len(x) == 1 and last.alone:
        first, rest = last.nodes[0], len(how.order) - 1 - last.nodes[-1]
        return pad(x[0], (0, 0, first, rest)) if first or rest else x[0]
    if inner is not None:
        x.append(inner[..., :interface, :])
    if max(how.order, default=0) == sum(part.shape[-2] for part in x):
        x.append(torch.zeros_like(x[0][..., :1, :]))
    found = take(torch.cat(broadcast_matrices(*x), -2), how.order)
    return found if not how.multipliers else torch.cat((found, inner[..., interface:, :]), -2)


def condense(
    how: Cut,
    b: Tensor,
    D: Tensor,
    U: Tensor,
    L: Tensor,
    tied: Tensor | None = None,
    held: Tensor | None = None,
) -> tuple[Interface | None, list[Rows]]:
    """The interface's system, None where there is none, and the rows of each line."""
    n, J, interface = D.shape[-3], how.multipliers, how.interface
    system = Interface(how, D.shape[-1]) if interface or J else None
    if system is not None:
        places = range(len(interface))
        system.add(take(D, interface, 2), places, places)
        system.load(take(b, interface), places)
        if how.direct:
            elements, i, j = zip(*how.direct, strict=True)
            system.add(take(U, elements, 2), i, j)
            system.add(take(L, elements, 2), j, i)
        if tied is not None:
            system.add(tied, *zip(*how.tied, strict=True))
        if J:
            system.load(b[..., n:, :] * held, range(len(interface), system.count))
    return system, [eliminate(line, system, b, D, U, L) for line in how.lines]


def blocks(line: Line, D: Tensor, U: Tensor, L: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """D, L, U of a line, in the order of its elimination (..., runs, n, w, w); of one run that has
    no part in the interface (..., n, w, w).
    """
    A, U, L = take(D, line.nodes, 2), take(U, line.inner, 2), take(L, line.inner, 2)
    if not line.alone:
        A = A.unflatten(-3, (line.runs, line.count))
        L, U = (x.unflatten(-3, (line.runs, line.count - 1)) for x in (L, U))
    return (A, U, L) if line.backward else (A, L, U)


def eliminate(
    line: Line, system: Interface | None, b: Tensor, D: Tensor, U: Tensor, L: Tensor
) -> Rows:
    """A line's rows; what they leave goes into the interface's system."""
    A, below, above = blocks(line, D, U, L)
    y = take(b, line.nodes)
    y = (y if line.alone else y.unflatten(-2, (line.runs, line.count)))[..., None]
    if not line.towards:
        return forward(A, below, above, y)
    U, L = (L, U) if line.backward else (U, L)
    above, r = _joined(above, take(U, line.after, 2)), take(L, line.after, 2)
    if line.back:
        c = pad(take(L, line.before, 2)[..., None, :, :], (0, 0, 0, 0, 0, line.count - 1))
        y = torch.cat(broadcast_matrices(y, c), -1)
    ahead, right = forward(A, below, above, y)
    system.add(-(r @ ahead[-1]), line.towards, line.towards)
    _push(system, -(r @ right[-1]), line.towards, line.back)
    if line.back:
        g = take(U, line.before, 2)
        for row, columns in zip(ahead, right, strict=True):
            _push(system, -(g @ columns), line.back, line.back)
            g = -(g @ row)
        system.add(g, line.back, line.towards)
    return ahead, right


def _push(system: Interface, push: Tensor, rows: Places, columns: Places) -> None:
    """Right-hand sides, and behind them blocks if there are columns (..., runs, w, 1 + w)."""
    system.load(push[..., 0], rows)
    if columns:
        system.add(push[..., 1:], rows, columns)


def _joined(line: Tensor, last: Tensor) -> Tensor:
    """(..., runs, n - 1, w, w) and (..., runs, w, w) behind."""
    last = last[..., None, :, :]
    return last if not line.shape[-3] else torch.cat((line, last), -3)


def restored(line: Line, rows: Rows, interface: Tensor | None) -> Tensor:
    """x (..., runs n, w) of a line's nodes, by its rows and the interface's (..., count, w)."""
    ahead, y = rows
    after = None
    if line.towards:
        after = take(interface, line.towards)[..., None]
        if line.back:
            back = take(interface, line.back)[..., None]
            y = [right[..., :1] - right[..., 1:] @ back for right in y]
    x = torch.broadcast_tensors(*backward(ahead, y, after))
    x = torch.cat(x, -1).mT
    return x if line.alone else x.flatten(-3, -2)
