"""Operations of torch by simpler ones, where torch itself has no such form, or none that can be
traced: `DECOMPOSED`, by name.

They take what the operation takes. Values, and derivatives where the operation has kinks, are
torch's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

# entries of a table that is looked up at places that depend on inputs: all of them are looked at
TABLE = 256


def _vector_norm(
    x: Tensor, ord: float = 2, dim: Any = None, keepdim: bool = False, **_: Any
) -> Tensor:
    dims = tuple(range(x.ndim)) if dim is None else dim
    return (x.abs() ** ord).sum(dims, keepdim) ** (1 / ord)


def _variance(
    x: Tensor,
    dim: Any = None,
    unbiased: bool | float | None = None,
    *,
    correction: float | None = None,
    keepdim: bool = False,
    **_: Any,
) -> Tensor:
    """unbiased: whether it is, or as torch's own decompositions have it, the correction."""
    if unbiased is not None:
        correction = float(unbiased)
    dims = tuple(range(x.ndim)) if dim is None else (dim,) if isinstance(dim, int) else tuple(dim)
    count = math.prod(x.shape[d] for d in dims) - (1 if correction is None else correction)
    return (x - x.mean(dims, True)).square().sum(dims, keepdim) / count


def _batch_norm(
    x: Tensor,
    weight: Tensor | None,
    bias: Tensor | None,
    mean: Tensor | None,
    variance: Tensor | None,
    training: bool,
    momentum: float,
    eps: float,
) -> tuple[Tensor, Tensor, Tensor]:
    if training or mean is None or variance is None:
        raise NotImplementedError(
            "it mixes the samples of a batch, and counts them; the module in eval mode is wanted"
        )
    shape = (-1, *(1,) * (x.ndim - 2))
    out = (x - mean.reshape(shape)) / (variance.reshape(shape) + eps).sqrt()
    out = out if weight is None else out * weight.reshape(shape)
    return out if bias is None else out + bias.reshape(shape), mean.new_zeros(0), mean.new_zeros(0)


def _searchsorted(
    sequence: Tensor,
    x: Tensor | float,
    *,
    out_int32: bool = False,
    right: bool = False,
    side: str | None = None,
    sorter: Tensor | None = None,
) -> Tensor:
    if sorter is not None or sequence.shape[-1] > TABLE:
        raise NotImplementedError(f"a sorted table of at most {TABLE} numbers is wanted")
    x = torch.as_tensor(x, dtype=sequence.dtype)[..., None]
    sequence = sequence if sequence.ndim == 1 else sequence[..., None, :]
    below = (sequence <= x) if right or side == "right" else (sequence < x)
    return below.sum(-1)


def _index(x: Tensor, places: list[Tensor | None]) -> Tensor:
    """x[places] at places that depend on inputs: neighbouring axes as one."""
    axes = [k for k, place in enumerate(places) if place is not None]
    first, last = axes[0], axes[-1] + 1
    if len(axes) != last - first or any(places[k].dtype == torch.bool for k in axes):
        raise NotImplementedError("places on axes beside each other are wanted")
    sizes = x.shape[first:last]
    at = 0
    for k, size in zip(axes, sizes, strict=True):
        at = at * size + torch.where(places[k] < 0, places[k] + size, places[k])
    count = sizes.numel()
    if count > TABLE:
        raise NotImplementedError(f"a table of {count} entries; at most {TABLE} are wanted")
    rows = x.reshape(*x.shape[:first], count, *x.shape[last:]).movedim(first, -1)
    lead = (*rows.shape[:-1], *at.shape)
    rows = rows.reshape(*rows.shape[:-1], *(1,) * at.ndim, count).expand(*lead, count)
    chosen = torch.gather(rows, -1, at.expand(lead)[..., None])[..., 0]
    behind = x.ndim - last
    return (
        chosen.movedim(tuple(range(first, first + behind)), tuple(range(-behind, 0)))
        if behind
        else chosen
    )


def _index_put(
    x: Tensor, places: list[Tensor | None], values: Tensor, accumulate: bool = False
) -> Tensor:
    """One entry, or several one after the other, of one axis."""
    axes = [k for k, place in enumerate(places) if place is not None]
    if len(axes) != 1 or places[axes[0]].dtype == torch.bool:
        raise NotImplementedError("places on one axis are wanted")
    axis, at = axes[0], places[axes[0]]
    here = torch.arange(x.shape[axis]).reshape(-1, *(1,) * (x.ndim - axis - 1))
    values = values.expand(*x.shape[:axis], *at.shape, *x.shape[axis + 1 :]).flatten(
        axis, axis + at.ndim - 1
    )
    for k, place in enumerate(at.flatten().unbind()):
        value = values.narrow(axis, k, 1)
        x = torch.where(here == place, x + value if accumulate else value, x)
    return x


def _scatter(x: Tensor, dim: int, at: Tensor, source: Tensor | float) -> Tensor:
    dim = dim % max(x.ndim, 1)
    if x.ndim == 0:
        return source.reshape(()) if isinstance(source, Tensor) else torch.full_like(x, source)
    shape = [1] * x.ndim
    shape[dim] = -1
    here = torch.arange(x.shape[dim]).reshape(shape)
    for k in range(at.shape[dim]):
        value = source.narrow(dim, k, 1) if isinstance(source, Tensor) else source
        x = torch.where(here == at.narrow(dim, k, 1), value, x)
    return x


def _scatter_add(x: Tensor, dim: int, at: Tensor, source: Tensor) -> Tensor:
    for k in range(at.shape[dim]):
        x = x + _scatter(torch.zeros_like(x), dim, at.narrow(dim, k, 1), source.narrow(dim, k, 1))
    return x


def _index_add(x: Tensor, dim: int, at: Tensor, source: Tensor, *, alpha: float = 1) -> Tensor:
    places = [None] * (dim % max(x.ndim, 1)) + [at]
    return torch.ops.aten.index_put(x, places, source if alpha == 1 else alpha * source, True)


def _bounded(x: Tensor, low: float = -1, high: float = 1) -> Tensor:
    """As clamp, but flat at its bounds."""
    return torch.where(x <= low, low, torch.where(x >= high, high, x))


def determinant(A: Tensor) -> Tensor:
    """By minors of the first row, of small matrices: torch differentiates its own by what a graph
    does not have.
    """
    n = A.shape[-1]
    if n > 5:
        raise NotImplementedError("a determinant of more than 5 rows")
    if n == 1:
        return A[..., 0, 0]
    minors = (determinant(torch.cat((A[..., 1:, :k], A[..., 1:, k + 1 :]), -1)) for k in range(n))
    return sum((-1) ** k * A[..., 0, k] * minor for k, minor in enumerate(minors))


def _shrink_backward(soft: bool) -> Callable[..., Tensor]:
    return lambda grad, x, bound: torch.where((x >= -bound) & (x <= bound), 0.0, grad)


def _sinc(x: Tensor) -> Tensor:
    none = x == 0
    turns = torch.where(none, torch.ones_like(x), x * torch.pi)
    return torch.where(none, torch.ones_like(x), turns.sin() / turns)


def _signed(size: Tensor, sign: Tensor | float) -> Tensor:
    minus = torch.as_tensor(sign) < 0
    return torch.where(minus, -size.abs(), size.abs())


def _extreme(larger: bool) -> Callable[[Tensor, Tensor], Tensor]:
    """The number where the other is none."""

    def extreme(a: Tensor, b: Tensor) -> Tensor:
        first = ((a >= b) if larger else (a <= b)) | b.isnan()
        return torch.where(first, a, b)

    return extreme


DECOMPOSED: dict[str, Callable[..., Any]] = {
    "linalg_vector_norm": _vector_norm,
    "var": _variance,
    "sinc": _sinc,
    "copysign": _signed,
    "std": lambda *args, **settings: _variance(*args, **settings).sqrt(),
    "native_batch_norm": _batch_norm,
    "_native_batch_norm_legit": _batch_norm,
    "_native_batch_norm_legit_no_training": lambda x, w, b, mean, var, momentum, eps: _batch_norm(
        x, w, b, mean, var, False, momentum, eps
    ),
    "searchsorted": _searchsorted,
    "bucketize": lambda x, edges, **settings: _searchsorted(edges, x, **settings),
    "index": _index,
    "_unsafe_index": _index,
    "scatter": _scatter,
    "index_put": _index_put,
    "embedding": lambda table, at, *_, **__: table[at],
    "softshrink_backward": _shrink_backward(True),
    "hardshrink_backward": _shrink_backward(False),
    "hardtanh": _bounded,
    "scatter_add": _scatter_add,
    "index_add": _index_add,
    "hardswish": lambda x: torch.where(x <= -3, 0.0, torch.where(x < 3, x * (x + 3) / 6, x)),
    "fmax": _extreme(True),
    "fmin": _extreme(False),
}
# in the place of torch's own
FUNCTIONS = dict.fromkeys((torch.det, torch.linalg.det, Tensor.det), determinant)
# fmt: off
INSTEAD = {  # name of an operation -> what to write
    "sort": "comparisons by torch.maximum and torch.minimum are",
    "topk": "torch.amax or torch.amin is",
    "median": "torch.maximum and torch.minimum are", "convolution": "a matrix product is",
    "_linalg_eigh": "a closed form of a small matrix is",
    "_linalg_svd": "torch.linalg.vector_norm, or a closed form, is",
    "_linalg_eigvals": "a closed form of a small matrix is",
    "linalg_eig": "a closed form of a small matrix is",
    "linalg_matrix_exp": "the closed form of a rotation, by sin and cos, is",
    "linalg_lstsq": "torch.linalg.solve is",
    "linalg_cholesky_ex": "torch.linalg.solve is", "linalg_pinv": "torch.linalg.solve of A^T A is",
    "_fft_c2c": "sums of sin and cos are", "_fft_r2c": "sums of sin and cos are",
    **dict.fromkeys(("lgamma", "digamma", "erf_inv", "erfinv", "bessel_i0", "bessel_j0", "erfcx",
                     "i0", "polygamma"),
                    "a polynomial, or a table with torch.searchsorted, is"),
    "complex": "real numbers by sin and cos are", "imag": "real numbers by sin and cos are",
    "real": "real numbers by sin and cos are", "view_as_real": "real numbers by sin and cos are",
    "view_as_complex": "real numbers by sin and cos are",
    **dict.fromkeys(("grid_sampler_2d", "grid_sampler_2d_backward", "grid_sampler_3d",
                     "grid_sampler_3d_backward"), "a table by whole places (torch.floor) is"),
    "_cdist_forward": "torch.linalg.vector_norm of the differences is",
    "_trilinear": "torch.einsum is",
    "masked_select": "torch.where is", "nonzero": "torch.where is", "_unique2": "torch.where is",
}
# fmt: on
