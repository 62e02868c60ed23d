"""Operations of torch on arrays of nodes: what each does to the scalars.

An array of nodes is an int64 tensor. `ELEMENTWISE` are functions of scalars, broadcast; `REDUCTIONS` functions of several
scalars, over axes; `STRUCTURAL` move elements about, so that torch itself does to nodes what it does to numbers; `OTHER` are
products, inverses and what reads more than that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product

import torch
from torch import Tensor

from .graph import Graph

UNKNOWN = -1  # in the place of a node: depends on inputs, and nothing says how


def _arithmetic(op: str) -> Callable[..., int]:
    return lambda g, *xs: g.make(op, *(g.number(x) for x in xs))


def _scaled(op: str) -> Callable[..., int]:
    return lambda g, a, b, *, alpha=1: g.make(op, g.number(a), g.make("mul", g.const(float(alpha)), g.number(b)))


def _logical(op: str) -> Callable[..., int]:
    return lambda g, *xs: g.make(op, *(g.truth(x) for x in xs))


def _compared(op: str, swapped: bool = False, negated: bool = False) -> Callable[..., int]:
    def compared(g: Graph, a: int, b: int) -> int:
        a, b = g.number(a), g.number(b)
        found = g.make(op, b, a) if swapped else g.make(op, a, b)
        return g.make("not", found) if negated else found
    return compared


def _where(g: Graph, truth: int, a: int, b: int) -> int:
    same = g.truths[a] and g.truths[b]
    return g.make("select", g.truth(truth), *((a, b) if same else (g.number(a), g.number(b))))


def _clamp(g: Graph, x: int, low: int | None = None, high: int | None = None) -> int:
    x = g.number(x)
    if low is not None:
        x = g.make("select", g.make("lt", x, low), low, x)
    return x if high is None else g.make("select", g.make("lt", high, x), high, x)


def _power(g: Graph, x: int, exponent: int) -> int:
    if not g.is_const(exponent) or (2 * g.values[exponent]) % 1:
        raise NotImplementedError("a power that is not a whole or half number")
    power, x = float(g.values[exponent]), g.number(x)
    result, square, n = g.make("sqrt", x) if power % 1 else g.one, x, int(abs(power))
    while n:
        result = g.make("mul", result, square) if n & 1 else result
        n, square = n >> 1, g.make("mul", square, square) if n > 1 else square
    return result if power >= 0 else g.make("div", g.one, result)


def _sign(g: Graph, x: int) -> int:
    minus = g.make("select", g.make("lt", x, g.zero), g.const(-1.0), g.zero)
    return g.make("select", g.make("lt", g.zero, x), g.one, minus)


def _arcsine(g: Graph, x: int, cosine: bool = False) -> int:
    other = g.make("sqrt", g.make("mul", g.make("sub", g.one, x), g.make("add", g.one, x)))
    return g.make("atan2", *((other, x) if cosine else (x, other)))


def _sigmoid(g: Graph, x: int) -> int:
    return g.make("div", g.one, g.make("add", g.one, g.make("exp", g.make("neg", x))))


def _finite(g: Graph, x: int) -> int:
    return g.make("eq", g.make("sub", x, x), g.zero)


def _unlike(op: str) -> Callable[..., int]:
    """Of numbers an arithmetic operation, of truth values a logical one."""
    names = {"mul": "and", "add": "or", "max": "or", "min": "and"}
    return lambda g, a, b: g.make(names[op], a, b) if g.truths[a] and g.truths[b] else _arithmetic(op)(g, a, b)


ELEMENTWISE: dict[str, Callable[..., int]] = {
    "add": _scaled("add"), "sub": _scaled("sub"), "rsub": lambda g, a, b: _scaled("sub")(g, b, a),
    "mul": _unlike("mul"), "div": _arithmetic("div"), "true_divide": _arithmetic("div"),
    **{name: _arithmetic(name) for name in ("neg", "sqrt", "sin", "cos", "atan2", "exp", "log", "abs", "floor", "round")},
    "maximum": _unlike("max"), "minimum": _unlike("min"),
    "reciprocal": lambda g, x: g.make("div", g.one, x), "rsqrt": lambda g, x: g.make("div", g.one, g.make("sqrt", x)),
    "square": lambda g, x: g.make("mul", x, x), "tan": lambda g, x: g.make("div", g.make("sin", x), g.make("cos", x)),
    "ceil": lambda g, x: g.make("neg", g.make("floor", g.make("neg", x))),
    "atan": lambda g, x: g.make("atan2", x, g.one), "asin": _arcsine, "acos": lambda g, x: _arcsine(g, x, True),
    "hypot": lambda g, a, b: g.make("sqrt", g.dot((a, b), (a, b))), "sigmoid": _sigmoid,
    "sign": lambda g, x: _sign(g, g.number(x)), "sgn": lambda g, x: _sign(g, g.number(x)), "pow": _power,
    "clamp": _clamp, "clamp_min": _clamp, "clamp_max": lambda g, x, high: _clamp(g, x, None, high),
    "relu": lambda g, x: _clamp(g, x, g.zero), "where": _where,
    "masked_fill": lambda g, x, mask, value: _where(g, mask, value, x),
    "lerp": lambda g, a, b, w: g.make("add", a, g.make("mul", w, g.make("sub", b, a))),
    "addcmul": lambda g, x, a, b, *, value=1: _scaled("add")(g, x, g.make("mul", a, b), alpha=value),
    "addcdiv": lambda g, x, a, b, *, value=1: _scaled("add")(g, x, g.make("div", a, b), alpha=value),
    "lt": _compared("lt"), "le": _compared("le"), "gt": _compared("lt", swapped=True), "ge": _compared("le", swapped=True),
    "eq": _compared("eq"), "ne": _compared("eq", negated=True), "isnan": lambda g, x: g.make("not", g.make("eq", x, x)),
    "isfinite": _finite, "isinf": lambda g, x: g.make("eq", g.make("abs", x), g.const(math.inf)),
    "logical_and": _logical("and"), "logical_or": _logical("or"), "logical_not": _logical("not"),
    "bitwise_and": _logical("and"), "bitwise_or": _logical("or"), "bitwise_not": _logical("not"),
    "logical_xor": lambda g, a, b: _where(g, a, g.make("not", g.truth(b)), g.truth(b)),
}


def elementwise(g: Graph, rule: Callable[..., int], *args: Tensor | None, **settings: float) -> Tensor:
    shape = torch.broadcast_shapes(*(x.shape for x in args if x is not None))
    count = math.prod(shape)
    lists = [[None] * count if x is None else x.expand(shape).flatten().tolist() for x in args]
    return torch.tensor([rule(g, *xs, **settings) for xs in zip(*lists, strict=True)], dtype=torch.long).reshape(shape)


def _mean(g: Graph, xs: Sequence[int]) -> int:
    return g.make("div", g.total(xs), g.const(float(len(xs))))


def _chained(op: str, start: bool | float) -> Callable[[Graph, Sequence[int]], int]:
    def chained(g: Graph, xs: Sequence[int]) -> int:
        result = g.const(start)
        for x in xs:
            result = g.make(op, result, g.truth(x) if isinstance(start, bool) else g.number(x))
        return result
    return chained


def _extreme(op: str) -> Callable[[Graph, Sequence[int]], int]:
    logical = {"max": _chained("or", False), "min": _chained("and", True)}[op]
    return lambda g, xs: logical(g, xs) if g.truths[xs[0]] else g.make(op, *xs)


def _position_of_largest(g: Graph, xs: Sequence[int]) -> int:
    largest, found = g.make("max", *xs), g.const(float(len(xs) - 1))
    for k in reversed(range(len(xs) - 1)):
        found = g.make("select", g.make("eq", xs[k], largest), g.const(float(k)), found)
    return found


REDUCTIONS: dict[str, Callable[[Graph, Sequence[int]], int]] = {
    "sum": lambda g, xs: g.total(g.number(x) for x in xs), "mean": _mean, "prod": _chained("mul", 1.0),
    "amax": _extreme("max"), "amin": _extreme("min"), "max": _extreme("max"), "min": _extreme("min"),
    "any": _chained("or", False), "all": _chained("and", True), "argmax": _position_of_largest,
}


def reduction(g: Graph, rule: Callable[[Graph, Sequence[int]], int], x: Tensor, dim: int | Sequence[int] | None = None,
              keepdim: bool = False, **_: object) -> Tensor:
    dims = range(x.ndim) if dim is None or (not isinstance(dim, int) and not dim) else [dim] if isinstance(dim, int) else dim
    dims = [d % x.ndim for d in dims] if x.ndim else []
    kept = [d for d in range(x.ndim) if d not in dims]
    rows = x.permute(*kept, *dims).reshape(math.prod(x.shape[d] for d in kept), -1).tolist()
    shape = [1 if d in dims else n for d, n in enumerate(x.shape)] if keepdim else [x.shape[d] for d in kept]
    return torch.tensor([rule(g, row) for row in rows], dtype=torch.long).reshape(shape)


# Name -> which arguments hold elements; the others are indices and sizes.
STRUCTURAL: dict[str, tuple[int, ...]] = {
    "cat": (0,), "stack": (0,), "clone": (0,), "index": (0,), "index_select": (0,), "flip": (0,), "roll": (0,), "repeat": (0,),
    "_unsafe_view": (0,), "_reshape_copy": (0,), "slice_backward": (0,), "select_backward": (0,), "diagonal_backward": (0,),
    "diag_embed": (0,), "tril": (0,), "triu": (0,), "slice_scatter": (0, 1), "select_scatter": (0, 1),
    "diagonal_scatter": (0, 1), "index_put": (0, 2), "block_diag": (0,), "take": (0,), "gather": (0,),
}


def _matrix_product(g: Graph, a: Tensor, b: Tensor) -> Tensor:
    """(..., m, k), (..., k, n) -> (..., m, n)"""
    lead = torch.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    m, n, k = a.shape[-2], b.shape[-1], a.shape[-1]
    rows = a.expand(*lead, m, k).reshape(-1, m, k).tolist()
    columns = b.mT.expand(*lead, n, k).reshape(-1, n, k).tolist()
    found = [g.dot(row, column) for one, other in zip(rows, columns, strict=True) for row, column in product(one, other)]
    return torch.tensor(found, dtype=torch.long).reshape(*lead, m, n)


def _plus(g: Graph, x: Tensor, found: Tensor, beta: float = 1, alpha: float = 1) -> Tensor:
    return elementwise(g, lambda g, a, b: g.make("add", g.make("mul", g.const(float(beta)), a),
                                                 g.make("mul", g.const(float(alpha)), b)), x, found)


def _cross(g: Graph, a: Tensor, b: Tensor, dim: int = -1) -> Tensor:
    (a0, a1, a2), (b0, b1, b2) = (x.movedim(dim, 0) for x in torch.broadcast_tensors(a, b))

    def minor(g: Graph, a: int, b: int, c: int, d: int) -> int:
        return g.make("sub", g.make("mul", a, d), g.make("mul", c, b))

    parts = (a1, b1, a2, b2), (a2, b2, a0, b0), (a0, b0, a1, b1)
    return torch.stack([elementwise(g, minor, *xs) for xs in parts]).movedim(0, dim)


def _vector_norm(g: Graph, x: Tensor, ord: float = 2, dim: object = None, keepdim: bool = False, **_: object) -> Tensor:
    rules = {1: lambda g, xs: g.total(g.make("abs", x) for x in xs), 2: lambda g, xs: g.make("norm", g.dot(xs, xs)),
             math.inf: lambda g, xs: g.make("max", *(g.make("abs", x) for x in xs))}
    if ord not in rules:
        raise NotImplementedError(f"a norm of order {ord}")
    return reduction(g, rules[ord], x, dim, keepdim)


def _solved(g: Graph, A: list[list[int]], B: list[list[int]]) -> list[list[int]]:
    """A^-1 B: up to 3 by the adjugate, which needs no pivots; from 4 by elimination without exchanging rows, for matrices whose
    leading minors are regular (symmetric positive definite, diagonally dominant).
    """
    n, mul, sub = len(A), lambda x, y: g.make("mul", x, y), lambda x, y: g.make("sub", x, y)
    if n == 1:
        return [[g.make("div", x, A[0][0]) for x in B[0]]]
    if n <= 3:
        if n == 2:
            adjugate = [[A[1][1], g.make("neg", A[0][1])], [g.make("neg", A[1][0]), A[0][0]]]
        else:
            adjugate = [[sub(mul(A[j - 2][i - 2], A[j - 1][i - 1]), mul(A[j - 2][i - 1], A[j - 1][i - 2])) for j in range(3)]
                        for i in range(3)]
        determinant = g.dot(A[0], [row[0] for row in adjugate])
        return [[g.make("div", g.dot(row, column), determinant) for column in zip(*B, strict=True)] for row in adjugate]
    A, B = [list(row) for row in A], [list(row) for row in B]
    for k in range(n):
        for i in range(k + 1, n):
            factor = g.make("div", A[i][k], A[k][k])
            A[i] = [g.zero] * (k + 1) + [sub(x, mul(factor, y)) for x, y in zip(A[i][k + 1:], A[k][k + 1:], strict=True)]
            B[i] = [sub(x, mul(factor, y)) for x, y in zip(B[i], B[k], strict=True)]
    for k in reversed(range(n)):
        for c in range(len(B[k])):
            known = g.dot(A[k][k + 1:], [B[i][c] for i in range(k + 1, n)])
            B[k][c] = g.make("div", sub(B[k][c], known), A[k][k])
    return B


def _solve(g: Graph, A: Tensor, B: Tensor, *, left: bool = True, **_: object) -> tuple[Tensor, ...]:
    if not left or A.ndim == 0:
        raise NotImplementedError("a solve from the right")
    vector = B.ndim == A.ndim - 1 and B.shape == A.shape[:-1]
    columns = B[..., None] if vector else B
    lead, n, m = torch.broadcast_shapes(A.shape[:-2], columns.shape[:-2]), A.shape[-1], columns.shape[-1]
    pairs = zip(A.expand(*lead, n, n).reshape(-1, n, n).tolist(), columns.expand(*lead, n, m).reshape(-1, n, m).tolist(),
                strict=True)
    found = torch.tensor([_solved(g, a, b) for a, b in pairs], dtype=torch.long).reshape(*lead, n, m)
    return found[..., 0] if vector else found, *[torch.full((), UNKNOWN)] * 3


def _inverse(g: Graph, A: Tensor, **_: object) -> tuple[Tensor, ...]:
    eye = torch.tensor([[g.one if i == j else g.zero for j in range(A.shape[-1])] for i in range(A.shape[-1])])
    return _solve(g, A, eye.expand(A.shape))[0], torch.full((), UNKNOWN)


def _gathered(g: Graph, x: Tensor, dim: int, at: Tensor, **_: object) -> Tensor:
    """By places that depend on inputs: a choice among all."""
    rows = x.movedim(dim, -1)
    lead = at.movedim(dim, -1)
    rows = rows[tuple(slice(n) for n in lead.shape[:-1])][..., None, :].expand(*lead.shape, rows.shape[-1])

    def choice(g: Graph, place: int, *xs: int) -> int:
        found = xs[-1]
        for k in reversed(range(len(xs) - 1)):
            found = g.make("select", g.make("eq", place, g.const(float(k))), xs[k], found)
        return found

    return elementwise(g, choice, lead, *rows.unbind(-1)).movedim(-1, dim)


def _padded(g: Graph, x: Tensor, pads: list[int], value: float = 0) -> Tensor:
    return torch.constant_pad_nd(x, pads, g.const(float(value)))


def _cumulative(g: Graph, x: Tensor, dim: int, **_: object) -> Tensor:
    rows = list(x.unbind(dim))
    for k in range(1, len(rows)):
        rows[k] = elementwise(g, ELEMENTWISE["add"], rows[k - 1], rows[k])
    return torch.stack(rows, dim)


OTHER: dict[str, Callable[..., Tensor | tuple[Tensor, ...]]] = {
    "mm": _matrix_product, "bmm": _matrix_product, "mv": lambda g, a, x: _matrix_product(g, a, x[:, None])[:, 0],
    "dot": lambda g, x, y: _matrix_product(g, x[None], y[:, None])[0, 0],
    "addmm": lambda g, x, a, b, **k: _plus(g, x, _matrix_product(g, a, b), **k),
    "baddbmm": lambda g, x, a, b, **k: _plus(g, x, _matrix_product(g, a, b), **k),
    "linalg_cross": _cross, "linalg_vector_norm": _vector_norm, "_linalg_solve_ex": _solve, "linalg_inv_ex": _inverse,
    "gather": _gathered, "constant_pad_nd": _padded, "cumsum": _cumulative,
    "zero": lambda g, x: torch.full(x.shape, g.zero), "fill": lambda g, x, value: value.expand(x.shape),
    "copy": lambda g, x, other, **_: other.expand(x.shape),
}
