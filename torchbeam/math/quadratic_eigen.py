"""Eigenvalues of M a'' + D a' + K a = 0 next to zero, with the right and left null vectors of
Q(lambda) = K + lambda D + lambda^2 M. Three ways to them: `dense` of anything; `symmetric` of an
undamped beam under conservative loads; `subspace` of the same on long chains, O(N) an iteration
(Bathe 1971). Their derivatives are in `eigen_derivatives`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .block_tridiagonal import BlockChain
from .concrete import concrete
from .dense import inverse_unchecked, solve
from .subspace import nearest, subspace

EXTRA = 2  # vectors of a block beyond those asked for
DENSE = 96  # unknowns up to which the dense way is the shorter
STRAIGHT = 1e-6  # |imaginary part| over |eigenvalue| up to which a motion does not oscillate
DISTINCT = 1e-7  # of an eigenvalue: nearer ones are the same
DOUBT = 0.01  # of an eigenvalue: by so much rounding may move one that is known
NEUTRAL = 1e-6  # of the slowest square that is known: less is next to nothing
SURE = 10.0  # times what rounding is taken to leave of a motion that nothing resists
TINY = 1e-31  # of a matrix: rounding of rounding, whose balancing (LAPACK) would spoil vectors
RAISE, RAISED = 100.0, 5  # a shift that does not make a matrix positive definite, and how often


class Pairs(NamedTuple):
    """eigenvalue (..., count) complex 1/s; right and left (..., count, n), left None where it is
    the right one; repeated (..., count) bool; doubt (..., count): what rounding of K may make of
    the eigenvalue, relative; apart (..., count) bool: whether what it makes of its square is next
    to nothing beside the slowest that is known, however many are asked for. Growth that rounding
    may have made is none.
    """

    eigenvalue: Tensor
    right: Tensor
    left: Tensor | None
    repeated: Tensor
    doubt: Tensor
    apart: Tensor

    @property
    def known(self) -> Tensor:
        """(..., count) bool: finite, and no other one's conjugate, which stand for what is not."""
        value = self.eigenvalue
        return torch.isfinite(value) & (value.imag >= -STRAIGHT * value.abs())


def slowest(
    M: Tensor,
    D: Tensor | None,
    K: Tensor,
    count: int,
    symmetric: bool,
    derivatives: bool,
    lags: int = 0,
) -> Pairs:
    """The `count` slowest, one of each conjugate pair, by their imaginary part, those that decay
    without oscillating last, see `slow_first`; constants.

    symmetric    whether K is, and nothing turns with it;  derivatives: whether `left` is wanted
    lags         how many of the last unknowns are internal states of loads
    """
    M, K = M.detach(), K.detach()
    D = None if D is None else D.detach()
    pairs = None
    if D is None and symmetric:
        M, K = torch.broadcast_tensors(M, K)
        half = (M + M.mT) / 2, (K + K.mT) / 2
        pairs = _symmetric(*half, count, definite, lambda *of: lowest(*of[:-1], M.shape[-1]))
    return _dense(M, D, K, count, derivatives, lags) if pairs is None else pairs


def slowest_of_chain(M: BlockChain, K: BlockChain, count: int) -> Pairs | None:
    """The same of long matrices, undamped; None where the slowest do not converge, or a sample is
    unstable beyond what a shift covers.
    """
    return _symmetric(M, K, count, BlockChain.positive_definite, subspace)


def definite(K: Tensor) -> Tensor:
    """(...) bool"""
    return torch.linalg.cholesky_ex(K).info == 0


def _diagonal(A: Tensor | BlockChain) -> Tensor:
    """(..., n)"""
    return A.diagonal(dim1=-2, dim2=-1) if isinstance(A, Tensor) else A.entries


def _shift(M: Any, K: Any) -> Tensor:
    """(...) of the square of an eigenvalue: the usual ratio of stiffness to mass on the diagonal,
    in any units, by the root of rounding; where there is no stiffness at all any number does.
    """
    mass, stiffness = torch.broadcast_tensors(_diagonal(M), _diagonal(K).abs())
    least = SURE * torch.finfo(mass.dtype).eps * mass.amax(-1, keepdim=True)  # rounding
    both = (mass > least) & (stiffness > 0)
    usual = torch.where(both, stiffness / torch.where(both, mass, 1.0), torch.nan)
    usual = usual.nanmedian(-1).values
    return torch.finfo(usual.dtype).eps ** 0.5 * torch.where(usual > 0, usual, 1.0)


def rounding(M: Any, K: Any, x: Tensor) -> Tensor:
    """(..., count) what rounding of K makes of the squares of eigenvalues with the vectors x
    (..., n, count), in any units: eps sum_i |K_ii| |x_i|^2 / |x^H M x|.
    """
    return _rounded(K, x) / _form(M, x).abs()


def _of_shift(shift: Tensor) -> Tensor:
    """(..., 1) what is left of an eigenvalue 0, or its square, once a shift is taken off again: all
    that rounding makes where there is no stiffness at all.
    """
    return SURE * torch.finfo(shift.dtype).eps * shift[..., None]


def error(M: Any, D: Tensor | None, K: Any, value: Tensor, x: Tensor, times: Any = 1.0) -> Tensor:
    """(..., m) 1/s what that, so many times, makes of eigenvalues (..., m): by |x^H (D + 2 lambda
    M) x|; at most by its root, where this vanishes, as two eigenvalues meet.
    """
    slope, rounded = 2 * value * _form(M, x), times * _rounded(K, x)
    slope = slope if D is None else slope + _form(D, x)
    return torch.minimum(rounded / slope.abs(), (rounded / _form(M, x).abs()).sqrt())


def _apart(stiffness: Tensor, unknown: Tensor) -> Tensor:
    """(..., m) bool, see `Pairs`, of motions with |x^H K x| / |x^H M x|, 0 of those that do not
    oscillate, and their `rounding`.
    """
    known = torch.where(unknown < DOUBT * stiffness, stiffness, torch.inf).amin(-1, keepdim=True)
    return (unknown < NEUTRAL * known) & torch.isfinite(known)


def _form(A: Any, x: Tensor) -> Tensor:
    """(..., count) x^H A x."""
    return (x.conj() * _product(A, x)).sum(-2)


def _rounded(K: Any, x: Tensor) -> Tensor:
    """(..., count) of x^H K x."""
    size = _diagonal(K).abs()[..., None] * x.abs().square()
    return torch.finfo(size.dtype).eps * size.sum(-2)


def _product(A: Any, x: Tensor) -> Tensor:
    """A x for x (..., n, count), real or complex, A real."""
    if x.is_complex():
        return torch.complex(_product(A, x.real), _product(A, x.imag))
    if isinstance(A, Tensor):
        return A @ x
    return A.times(x.unflatten(-2, A.diagonal.shape[-3:-1])).flatten(-3, -2)


def plus(K: Any, factor: Tensor, M: Any) -> Any:
    """K + factor M for matrices (..., n, n), or chains, and a factor (...)."""
    return K + factor[..., None, None] * M if isinstance(K, Tensor) else K.plus(factor, M)


def covering(M: Any, K: Any, definite: Callable[[Any], Tensor] = definite) -> Tensor | None:
    """(...) a shift that makes K + shift M positive definite, K symmetric: nothing may hold a rigid
    motion, and what rounding leaves of K there would be a pivot. None where no shift does.
    """
    shift = _shift(M, K)
    for _ in range(RAISED):
        covered = definite(plus(K, shift, M))
        if concrete(covered).all():
            return shift
        shift = torch.where(covered, shift, RAISE * shift)
    return None


def _symmetric(
    M: Any, K: Any, count: int, definite: Callable[[Any], Tensor], solve: Callable
) -> Pairs | None:
    """By `solve`, with a `covering` shift; None where there is none, or they do not converge."""
    shift = covering(M, K, definite)
    found = None if shift is None else solve(M, K, shift, count + 1)
    if found is None:
        return None
    square, vectors, unknown = found
    none, unknown, apart = unresisted(square, unknown, shift)
    square = torch.where(none, 0.0, square)
    gap = (square[..., 1:] - square[..., :-1]).abs()
    near = gap <= DISTINCT * square[..., :-1].abs()
    near = torch.nn.functional.pad(near, (1, 0)) | torch.nn.functional.pad(near, (0, 1))
    eigenvalue = _upper(torch.complex(-square, torch.zeros_like(square)).sqrt())
    vectors = vectors.mT[..., :count, :]
    return Pairs(
        eigenvalue[..., :count],
        torch.complex(vectors, torch.zeros_like(vectors)),
        None,
        near[..., :count],
        (unknown / (2 * square.abs()))[..., :count],
        apart[..., :count],
    )


def unresisted(square: Tensor, unknown: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of squares (..., m) of eigenvalues by a `covering` shift, and their `rounding`: which are
    zero but for rounding, (..., m) bool; their rounding with the shift's; and `Pairs.apart`.
    """
    unknown = unknown + _of_shift(shift)
    apart = _apart(square.clamp(min=0), unknown)
    none = (square.abs() < unknown) | apart & (square < 0) & (-square <= SURE * unknown)
    return none, unknown, apart


def _upper(value: Tensor) -> Tensor:
    """The one of each pair +-value with a positive imaginary part."""
    return torch.where(value.imag < 0, -value, value)


def lowest(M: Tensor, K: Tensor, shift: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """As `subspace`, dense; differentiable where they are distinct."""
    root = torch.linalg.cholesky(plus(K, shift, M))
    flexible = torch.linalg.solve_triangular(
        root, torch.linalg.solve_triangular(root, M, upper=False).mT, upper=False
    )
    value, vectors = torch.linalg.eigh((flexible + flexible.mT) / 2)
    vectors = torch.linalg.solve_triangular(root.mT, vectors.flip(-1)[..., :count], upper=True)
    # Rayleigh's quotient, of which rounding counts by its square: of little inertia beside much
    inertia, most = _form(M, vectors), value[..., -1:]
    unknown = SURE * M.shape[-1] * torch.finfo(value.dtype).eps
    square = torch.where(inertia < unknown**2 * most, torch.inf, 1 / inertia - shift[..., None])
    square, at = square.sort(dim=-1, stable=True)
    vectors = vectors.gather(-1, at[..., None, :].expand(vectors.shape))
    return square, vectors, rounding(M, K, vectors)


def spectrum(M: Tensor, D: Tensor | None, K: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """All eigenvalues (..., n), or their squares where there is no damping, the vectors (..., n, n)
    as columns, and the matrix that was inverted for them: Q at a small shift, for M may be
    singular, and K where nothing holds a rigid motion, or next to a point of buckling, would spoil
    the others. Raises ValueError for a motion without stiffness and inertia.
    """
    square = _shift(M, K)
    if D is None:
        K = plus(K, square, M)
        eigenvalues, vectors = torch.linalg.eig(-_inverted(K, M))
        size, least = _inertia(eigenvalues)
        return torch.where(size < least, torch.inf, 1 / eigenvalues) + square[..., None], vectors, K
    M, D = (
        torch.where(A.abs() > TINY * A.abs().amax((-1, -2), keepdim=True), A, 0) for A in (M, D)
    )
    shift = square.sqrt()
    K, D = plus(plus(K, shift, D), square, M), plus(D, 2 * shift, M)
    flexible = _inverted(K, torch.cat((D, M), -1))
    eye = torch.eye(M.shape[-1], dtype=M.dtype, device=M.device).expand_as(M)
    eigenvalues, vectors = torch.linalg.eig(
        torch.cat((-flexible, torch.cat((eye, torch.zeros_like(M)), -1)), -2)
    )
    # what has no inertia has none, and what decays does not oscillate, but for rounding
    (size, least), turning = _inertia(eigenvalues), eigenvalues.imag
    turning = torch.where(turning.abs() < least, 0.0, turning)
    eigenvalues = torch.where(size < least, torch.inf, 1 / torch.complex(eigenvalues.real, turning))
    return eigenvalues + shift[..., None], vectors, K


def _inertia(value: Tensor) -> tuple[Tensor, Tensor]:
    """Sizes (..., n) of the eigenvalues of an inverse, and (..., 1) below which one is rounding:
    that motion has no inertia.
    """
    size = value.abs()
    rounded = SURE * size.shape[-1] * torch.finfo(size.dtype).eps
    return size, rounded * size.amax(-1, keepdim=True)


def slow_values(M: Any, D: Tensor | None, K: Any, count: int) -> tuple[Tensor, Tensor]:
    """Eigenvalues (..., m), or their squares where there is no damping, among them the `count`
    slowest, and their vectors (..., n, m): all of dense matrices; of chains, which have no damping,
    those of a subspace, O(n), or all where they do not converge there.
    """
    if isinstance(K, Tensor):
        value, vectors, _ = spectrum(M, D, K)
        return value, vectors[..., : K.shape[-1], :]
    found = _slow_of_chain(M, K, count)
    return spectrum(M.dense(), D, K.dense())[:2] if found is None else found


def _slow_of_chain(M: BlockChain, K: BlockChain, count: int) -> tuple[Tensor, Tensor] | None:
    """Those of the matrix that `spectrum` inverts for."""
    shift, nodes, like = _shift(M, K), K.diagonal.shape[-3:-1], K.diagonal
    factors = K.plus(shift, M).factored()
    at = torch.arange(K.size, dtype=like.dtype, device=like.device)[:, None]
    start = torch.cos(at * (1 + at[: count + EXTRA, 0]) * 0.7 + 0.3)
    found = nearest(
        lambda x: factors.solve(M.times(x.unflatten(-2, nodes))).flatten(-3, -2),
        start,
        lambda mu: slow_first(mu + shift[..., None], count, False),
    )
    return None if found is None else (found[0] + shift[..., None], found[1])


def _inverted(K: Tensor, right: Tensor) -> Tensor:
    try:
        return solve(K, right)
    except torch.linalg.LinAlgError:
        raise ValueError(
            "a motion that neither stiffness nor inertia resists was given, as the turn about its "
            "axis of a pinned beam without rotary inertia; a support, or an inertia, is wanted"
        ) from None


def relaxes(value: Tensor, states: bool = False) -> Tensor:
    """(..., n) bool: which eigenvalues decay without oscillating. What is zero is a rigid motion
    and does not decay, but where there are internal states it may be one of theirs.
    """
    decays = value.real <= 0 if states else value.real < 0
    return (value.imag.abs() <= STRAIGHT * value.abs()) & decays


def slow_first(value: Tensor, count: int, damped: bool, states: bool = False) -> Tensor:
    """Places (..., count) of the slowest among eigenvalues (..., n), one of each conjugate pair,
    the slowest first; `damped`: behind all others those that decay without oscillating, which may
    be many and slow. Of two that are as slow, one growing and one decaying, the growing one is
    first.
    """
    size = value.abs()
    grows = (value.imag.abs() <= STRAIGHT * size) & (value.real > 0)
    size = torch.where(grows, (1 - STRAIGHT) * size, size)
    # two that are equal and real may come as a pair, by rounding
    size = torch.where((value.imag < -STRAIGHT * size) | ~torch.isfinite(size), torch.inf, size)
    order = size.argsort(dim=-1, stable=True)
    if damped:
        last = torch.isinf(size) | relaxes(value, states)
        order = order.gather(-1, last.gather(-1, order).to(torch.int8).argsort(dim=-1, stable=True))
    return order[..., :count]


def _dense(
    M: Tensor, D: Tensor | None, K: Tensor, count: int, derivatives: bool, lags: int
) -> Pairs:
    n = K.shape[-1]
    eigenvalues, vectors, inverted = spectrum(M, D, K)
    # of the moves alone
    m, d, k = (None if A is None else A[..., : n - lags, : n - lags] for A in (M, D, K))
    moves = vectors[..., : n - lags, :]
    left_over = _of_shift(_shift(M, K) if D is None else _shift(M, K).sqrt())
    unknown, value = rounding(m, k, moves), eigenvalues
    if D is None:
        unknown = unknown + left_over
        value = _upper(torch.where(value.abs() < unknown, 0.0, value).sqrt())
    stiffness = _form(k, moves).abs() / _form(m, moves).abs()
    swings = value.imag.abs() > STRAIGHT * value.abs()
    apart = _apart(torch.where(swings, stiffness, 0.0), unknown)
    least = error(m, d, k, value, moves, torch.where(apart, SURE, 1.0))
    least = least if D is None else least + left_over
    grown = (value.real > 0) & (value.real <= least)
    value = torch.complex(torch.where(grown, 0.0, value.real), value.imag)
    value = torch.where(value.abs() <= least, 0.0, value)  # of a motion that nothing resists
    slow = slow_first(value, count, D is not None, lags > 0)
    key = torch.where(relaxes(value, lags > 0), torch.inf, value.imag).gather(-1, slow)
    slow = slow.gather(-1, key.argsort(dim=-1, stable=True))
    rows, left = slow[..., None].expand(*slow.shape, vectors.shape[-1]), None
    if derivatives:
        inverse = inverse_unchecked(vectors).gather(-2, rows)[..., :n]
        left = solve(inverted.mT.to(inverse.dtype), inverse.mT).mT
    chosen = eigenvalues.gather(-1, slow)
    near = (
        (chosen[..., :, None] - eigenvalues[..., None, :]).abs()
        <= DISTINCT * chosen.abs()[..., :, None]
    ).sum(-1) > 1
    return Pairs(
        value.gather(-1, slow),
        vectors.mT.gather(-2, rows)[..., :n],
        left,
        near,
        (error(m, d, k, value, moves) / value.abs()).gather(-1, slow),
        apart.gather(-1, slow),
    )
