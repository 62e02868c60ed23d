"""Operations of torch on whole arrays of nodes: what moves elements about, products, inverses.

`STRUCTURAL` ones torch itself does to nodes, as it does them to numbers; node 0 is the number 0,
which they fill up with. `OTHER` are written here. Arrays are of NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import torch
from torch import Tensor

from ...math.dense import IN_ORDER
from ...math.shapes import broadcast_shapes
from .elementwise import ELEMENTWISE, REDUCTIONS, array, elementwise, reduction
from .graph import Graph

UNKNOWN = -1  # in the place of a node: depends on inputs, and nothing says how

# Name -> which arguments hold elements; the others are indices and sizes.
# fmt: off
STRUCTURAL: dict[str, tuple[int, ...]] = {
    "cat": (0,), "stack": (0,), "clone": (0,), "index": (0,), "index_select": (0,), "flip": (0,),
    "roll": (0,), "repeat": (0,),
    "_unsafe_view": (0,), "_reshape_copy": (0,), "slice_backward": (0,), "select_backward": (0,),
    "diagonal_backward": (0,),
    "diag_embed": (0,), "tril": (0,), "triu": (0,), "slice_scatter": (0, 1),
    "select_scatter": (0, 1),
    "diagonal_scatter": (0, 1), "index_put": (0, 2), "block_diag": (0,), "take": (0,),
    "gather": (0,),
}
# fmt: on


def accumulated(
    g: Graph, x: np.ndarray, places: list[Tensor | None], values: np.ndarray
) -> np.ndarray:
    """x with values added at places, of which one may come several times: `index_put` that
    accumulates.
    """
    at = torch.arange(x.size).reshape(x.shape)[
        tuple(slice(None) if p is None else p for p in places)
    ]
    sums = x.ravel().tolist()
    values = np.broadcast_to(values, at.shape)
    for place, value in zip(at.flatten().tolist(), values.ravel().tolist(), strict=True):
        sums[place] = g.make("add", sums[place], value)
    return array(sums, x.shape)


def _matrices(x: np.ndarray, lead: Sequence[int]) -> list[list[list[int]]]:
    """(*lead, m, n) of what broadcasts to that, one matrix after the other."""
    m, n = x.shape[-2:]
    x = x if x.shape[:-2] == tuple(lead) else np.broadcast_to(x, (*lead, m, n))
    return x.reshape(-1, m, n).tolist()


def _matrix_product(g: Graph, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(..., m, k), (..., k, n) -> (..., m, n)"""
    lead = broadcast_shapes(a.shape[:-2], b.shape[:-2])
    m, n = a.shape[-2], b.shape[-1]
    rows = _matrices(a, lead)
    columns = _matrices(b.swapaxes(-1, -2), lead)
    products = [
        g.dot(row, column)
        for one, other in zip(rows, columns, strict=True)
        for row, column in product(one, other)
    ]
    return array(products, (*lead, m, n))


def _plus(
    g: Graph, x: np.ndarray, term: np.ndarray, beta: float = 1, alpha: float = 1
) -> np.ndarray:
    return elementwise(
        g,
        lambda g, a, b: g.make(
            "add", g.make("mul", g.const(float(beta)), a), g.make("mul", g.const(float(alpha)), b)
        ),
        x,
        term,
    )


def _cross(g: Graph, a: np.ndarray, b: np.ndarray, dim: int = -1) -> np.ndarray:
    (a0, a1, a2), (b0, b1, b2) = (np.moveaxis(x, dim, 0) for x in np.broadcast_arrays(a, b))

    def minor(g: Graph, a: int, b: int, c: int, d: int) -> int:
        return g.make("sub", g.make("mul", a, d), g.make("mul", c, b))

    parts = (a1, b1, a2, b2), (a2, b2, a0, b0), (a0, b0, a1, b1)
    return np.stack([elementwise(g, minor, *xs) for xs in parts], dim)


def _vector_norm(
    g: Graph, x: np.ndarray, ord: float = 2, dim: object = None, keepdim: bool = False, **_: object
) -> np.ndarray:
    rules = {
        1: lambda g, xs: g.total(g.make("abs", x) for x in xs),
        2: lambda g, xs: g.make("norm", g.dot(xs, xs)),
        math.inf: lambda g, xs: g.make("max", *(g.make("abs", x) for x in xs)),
    }
    if ord not in rules:
        return NotImplemented
    return reduction(g, rules[ord], x, dim, keepdim)


def _solved(g: Graph, A: list[list[int]], B: list[list[int]]) -> list[list[int]]:
    """A^-1 B by elimination with exchange of rows; in `solve_in_order` without, from 4 rows on."""
    n, mul, sub = len(A), lambda x, y: g.make("mul", x, y), lambda x, y: g.make("sub", x, y)
    rows = [[*a, *b] for a, b in zip(A, B, strict=True)]
    pivots, in_order = [], IN_ORDER.get() and n > 3
    for k in range(n):
        if not in_order:
            for i in range(k + 1, n):
                rows[k], rows[i] = _largest_first(g, rows[k], rows[i], k)
        pivots.append(g.make("div", g.one, rows[k][k]))
        for i in range(k + 1, n):
            factor = mul(rows[i][k], pivots[k])
            left = zip(rows[i][k + 1 :], rows[k][k + 1 :], strict=True)
            rows[i] = [g.zero] * (k + 1) + [sub(x, mul(factor, y)) for x, y in left]
    solution = [row[n:] for row in rows]
    for k in reversed(range(n)):
        for c in range(len(solution[k])):
            known = g.dot(rows[k][k + 1 : n], [solution[i][c] for i in range(k + 1, n)])
            solution[k][c] = mul(sub(solution[k][c], known), pivots[k])
    return solution


def _largest_first(
    g: Graph, first: list[int], other: list[int], column: int
) -> tuple[list[int], list[int]]:
    """Two rows, the one with the larger number in that column first."""
    swap = g.make("lt", g.make("abs", first[column]), g.make("abs", other[column]))
    pairs = list(zip(first, other, strict=True))
    return [g.make("select", swap, b, a) for a, b in pairs], [
        g.make("select", swap, a, b) for a, b in pairs
    ]


def _factors_of_transpose() -> bool:
    """Whether this torch factors the transpose of a matrix whose rows are contiguous, and remembers
    that in its derivatives (as 2.10 does).
    """
    factors = torch.ops.aten._linalg_solve_ex(torch.tensor([[1.0, 0], [1, 1]]), torch.eye(2))[1]
    return factors[0, 1].item() == 1


FACTORS_OF_TRANSPOSE = _factors_of_transpose()


def _solve(
    g: Graph,
    A: np.ndarray,
    B: np.ndarray,
    *,
    left: bool = True,
    transposed: bool = False,
    **_: object,
) -> tuple[np.ndarray, ...]:
    if not left or A.ndim == 0:
        raise NotImplementedError("a solve from the right")
    vector = B.ndim == A.ndim - 1 and B.shape == A.shape[:-1]
    columns = B[..., None] if vector else B
    lead = broadcast_shapes(A.shape[:-2], columns.shape[:-2])
    pairs = zip(_matrices(A, lead), _matrices(columns, lead), strict=True)
    solutions = array([_solved(g, a, b) for a, b in pairs], (*lead, *columns.shape[-2:]))
    factors = elementwise(g, _factor, A.swapaxes(-1, -2) if transposed else A)
    return solutions[..., 0] if vector else solutions, factors, *[array([UNKNOWN], ())] * 2


def _solve_again(
    g: Graph, factors: np.ndarray, B: np.ndarray, *, left: bool = True, adjoint: bool = False
) -> np.ndarray:
    """By the factors of a matrix, which stand for it. B (..., n, m)."""
    if not all(g.ops[x] == "factor" for x in factors.ravel().tolist()):
        raise NotImplementedError("factors that no solve has left")
    A = elementwise(g, lambda g, x: g.args[x][0], factors)
    if left:
        return _solve(g, A.swapaxes(-1, -2) if adjoint else A, B)[0]
    A = A if adjoint else A.swapaxes(-1, -2)
    return _solve(g, A, B.swapaxes(-1, -2))[0].swapaxes(-1, -2)


def _log_determinant(g: Graph, A: np.ndarray, **_: object) -> tuple[np.ndarray, ...]:
    """Of a small matrix, with its sign."""
    n = A.shape[-1]
    if n > 5:
        raise NotImplementedError("a determinant of more than 5 rows")

    def of(rows: list[list[int]]) -> int:
        if not rows:
            return g.one
        terms = [
            g.make("mul", x, of([[*row[:k], *row[k + 1 :]] for row in rows[1:]]))
            for k, x in enumerate(rows[0])
        ]
        return g.total(g.make("neg", x) if k % 2 else x for k, x in enumerate(terms))

    values = array([of(a) for a in A.reshape(-1, n, n).tolist()], A.shape[:-2])
    size = elementwise(g, lambda g, x: g.make("log", g.make("abs", x)), values)
    return (
        elementwise(g, ELEMENTWISE["sign"], values),
        size,
        elementwise(g, _factor, A),
        array([UNKNOWN], ()),
    )


def _factor(g: Graph, a: int) -> int:
    return g.make("factor", a)


def _extreme(which: str) -> Callable[..., np.ndarray | tuple[np.ndarray, ...]]:
    """The largest ("max") or smallest ("min") number; along an axis, and where it is."""
    value, place = REDUCTIONS[f"a{which}"], REDUCTIONS[f"arg{which}"]

    def extreme(
        g: Graph, x: np.ndarray, dim: int | None = None, keepdim: bool = False
    ) -> np.ndarray | tuple[np.ndarray, ...]:
        found = reduction(g, value, x, dim, keepdim)
        return found if dim is None else (found, reduction(g, place, x, dim, keepdim))

    return extreme


def _inverse(g: Graph, A: np.ndarray, **_: object) -> tuple[np.ndarray, ...]:
    eye = np.where(np.eye(A.shape[-1], dtype=bool), g.one, g.zero)
    return _solve(g, A, np.broadcast_to(eye, A.shape))[0], array([UNKNOWN], ())


def _gathered(g: Graph, x: np.ndarray, dim: int, at: np.ndarray, **_: object) -> np.ndarray:
    """By places that depend on inputs: a choice among all; of a place that there is not, the
    nearest.
    """
    rows, lead = (np.moveaxis(y, dim, -1) if y.ndim else y[None] for y in (x, at))
    rows = rows[tuple(slice(n) for n in lead.shape[:-1])][..., None, :]
    rows = np.broadcast_to(rows, (*lead.shape, rows.shape[-1]))

    def choice(g: Graph, place: int, *xs: int) -> int:
        if g.truths[xs[0]]:
            chosen = xs[-1]
            for k in reversed(range(len(xs) - 1)):
                chosen = g.make("select", g.make("eq", place, g.const(float(k))), xs[k], chosen)
            return chosen
        last = g.const(len(xs) - 1.0)
        place = g.make("select", g.make("le", g.zero, place), place, g.zero)  # 0 of NaN
        return g.make("pick", g.make("select", g.make("lt", last, place), last, place), *xs)

    chosen = elementwise(g, choice, lead, *np.moveaxis(rows, -1, 0))
    return np.moveaxis(chosen, -1, dim) if at.ndim else chosen[0]


def _padded(g: Graph, x: np.ndarray, pads: list[int], value: float = 0) -> np.ndarray:
    return torch.constant_pad_nd(torch.from_numpy(x), pads, g.const(float(value))).numpy()


def _cumulative(g: Graph, x: np.ndarray, dim: int, **_: object) -> np.ndarray:
    rows = list(np.moveaxis(x, dim, 0)) if x.ndim else [x]
    for k in range(1, len(rows)):
        rows[k] = elementwise(g, ELEMENTWISE["add"], rows[k - 1], rows[k])
    return np.stack(rows, dim) if x.ndim else x


OTHER: dict[str, Callable[..., np.ndarray | tuple[np.ndarray, ...]]] = {
    "mm": _matrix_product,
    "bmm": _matrix_product,
    "mv": lambda g, a, x: _matrix_product(g, a, x[:, None])[:, 0],
    "dot": lambda g, x, y: _matrix_product(g, x[None], y[:, None])[0, 0],
    "addmm": lambda g, x, a, b, **k: _plus(g, x, _matrix_product(g, a, b), **k),
    "baddbmm": lambda g, x, a, b, **k: _plus(g, x, _matrix_product(g, a, b), **k),
    "linalg_cross": _cross,
    "linalg_vector_norm": _vector_norm,
    "_linalg_solve_ex": _solve,
    "linalg_lu_solve": _solve_again,
    "linalg_inv_ex": _inverse,
    "_linalg_slogdet": _log_determinant,
    "max": _extreme("max"),
    "min": _extreme("min"),
    "gather": _gathered,
    "constant_pad_nd": _padded,
    "cumsum": _cumulative,
    "zero": lambda g, x: np.full(x.shape, g.zero),
    "fill": lambda g, x, value: np.broadcast_to(value, x.shape),
    "copy": lambda g, x, other, **_: np.broadcast_to(other, x.shape),
}
