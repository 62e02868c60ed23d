"""Modes of a spinning rotor at each of its speeds: eigenvalues where multiblade coordinates have
constant coefficients, Floquet's exponents of others.

Overdamped motions, and those of internal states of a rotor in air or of blades that relax, decay
without oscillating, many in axes that turn with their harmonic: eigenvalue - i W harmonic is real.
Those come last, see `whirl.relaxing`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.validation import concrete, refusal
from ..math.eigen_derivatives import attach
from ..math.quadratic_eigen import Pairs, slowest
from .multiblade import SpinningModel
from .periodic import HARMONICS, NONE, ORDER, UNSEEN, Exponents, exponents, fastest
from .whirl import grows, relaxing

SPARE = 4  # modes beyond those asked for, so that none is lost where they cross
# of an eigenvalue: what the azimuth changes of it where blades are equal
EQUAL = 1e-7
ROUNDING = 4  # of the sum of what cancels in a coupling of two modes, in units of the last place
UNBALANCED = 0.1  # of the terms of M, D and K of a motion: a remainder beyond rounding
ORBIT_STEPS = 4  # midpoint steps of an orbit by steps of Floquet's
ROOM = 20_000_000  # numbers of maps over a turn that are held at once


Orbit = Callable[[int, int, int, Tensor], Exponents]


class SpinningModes(NamedTuple):
    """Of m motions by the largest h of their harmonics: eigenvalue (n, ..., m, h) 1/s, shape
    (n, ..., m, h, k) of coordinates that do not spin, error (n, ..., m, h) 1/s of the steps; about
    (n, ..., l): the slowest eigenvalues of constant coefficients; growth (n, ...) 1/s of the motion
    of all that grows fastest, 0 where none does.
    """

    eigenvalue: Tensor
    shape: Tensor
    error: Tensor
    about: Tensor
    growth: Tensor


def constant_modes(spinning: SpinningModel, count: int) -> tuple[Pairs, float, Tensor]:
    """Eigenpairs of constant coefficients, `count` and some to spare, without derivatives; the most
    that coefficients that change with the azimuth would move one, or couple two, of an eigenvalue;
    and the growth (...) of all.
    """
    M, D, K = spinning.constant()
    derivatives = wants_gradient(M, D, K)
    with no_derivatives():
        pairs = slowest(M, D, K, 2 * M.shape[-1], False, derivatives, spinning.states)
        none = (pairs.eigenvalue.imag < 0) | _infinite((M, D, K), pairs)
        value = torch.where(none, NONE, pairs.eigenvalue)
        growth = _growth(value, spinning.speed)
        at, swings = _swinging(spinning, value, pairs.right, count + SPARE)
        several = max(count, min(count + SPARE, int(concrete(swings.sum(-1)).min())))
        pairs = _taken(pairs._replace(eigenvalue=value), at[..., : several + SPARE])
        pairs = _known(pairs, count)
        first = pairs.eigenvalue[..., :several], pairs.right[..., :several, :]
        change = _periodic(spinning, *first)
    return pairs, concrete(change).max().item(), growth


def _infinite(matrices: tuple[Tensor, Tensor, Tensor], pairs: Pairs) -> Tensor:
    """(..., m) bool: what seems to grow, and is the rounding of an infinite eigenvalue: its terms
    of M, D and K leave a remainder as large as they are.
    """
    by, v = pairs.eigenvalue[..., None, :], pairs.right.mT
    M, D, K = (torch.complex(A @ v.real, A @ v.imag) for A in matrices)
    terms = torch.stack((by**2 * M, by * D, K))
    left, whole = (torch.linalg.vector_norm(x, dim=-2) for x in (terms.sum(0), terms))
    fast = (pairs.eigenvalue.real > 0) & (whole[2] < whole.amax(0))
    return fast & ~(left < UNBALANCED * whole.sum(0))


def _growth(value: Tensor, speed: Tensor, error: Tensor | float = 0.0) -> Tensor:
    """(...) 1/s of the eigenvalue of (..., m) that grows fastest, 0 where none does."""
    growing = grows(value, speed[..., None], error) & torch.isfinite(value)
    return torch.where(growing, value.real, 0.0).amax(-1).detach()


def multiblade_modes(spinning: SpinningModel, pairs: Pairs, growth: Tensor) -> SpinningModes:
    M, D, K = spinning.constant()
    value, shape = pairs.eigenvalue, pairs.right
    if wants_gradient(M, D, K):
        value, shape = attach(M, D, K, pairs)
    error = torch.zeros_like(value.real)[..., None]
    return SpinningModes(value[..., None], shape[..., None, :], error, pairs.eigenvalue, growth)


def _swinging(
    spinning: SpinningModel, value: Tensor, shape: Tensor, several: int
) -> tuple[Tensor, Tensor]:
    """Places (..., m) of eigenvalues (..., m), with shapes (..., m, n): first `several` of motions
    that do not relax, the slowest first, then those that do, which may not at other speeds, then
    the others, NONE last; before all, what grows fastest. And which do not relax (..., m) bool.
    """
    known = value.abs() < abs(NONE) / 2
    swings = ~relaxing(spinning, value, shape) & known
    if spinning.states:
        moves = shape[..., : -spinning.states]
        seen = moves.abs().square().sum(-1) > UNSEEN * shape.abs().square().sum(-1)
        swings = swings & seen
    order = value.abs().nan_to_num(torch.inf).argsort(dim=-1, stable=True)
    first, none = swings.gather(-1, order), ~known.gather(-1, order)
    late = torch.where(first, 2 * (first.cumsum(-1) > several), torch.where(none, 3, 1))
    growth = _growth(value, spinning.speed)[..., None]
    fastest = (value.real == growth) & (growth > 0)
    late = torch.where(fastest.gather(-1, order), -1, late)
    return order.gather(-1, late.argsort(dim=-1, stable=True)), swings


def _taken(pairs: Pairs, at: Tensor) -> Pairs:
    def of(x: Tensor | None, *more: int) -> Tensor | None:
        index = at.reshape(*at.shape, *(1 for _ in more)).expand(*at.shape, *more)
        return None if x is None else x.gather(at.ndim - 1, index)

    n = pairs.right.shape[-1]
    value, right, left, *rest = pairs
    return Pairs(of(value), of(right, n), of(left, n), *map(of, rest))


def _known(pairs: Pairs, count: int) -> Pairs:
    """Those that all speeds and samples have: coordinates without inertia have none. ValueError
    where they are less than `count`.
    """
    known = int((concrete(pairs.eigenvalue).abs() < abs(NONE) / 2).sum(-1).min())
    if count > known:
        raise refusal(f"count = {count}", f"at most {known}, all modes of the scene,")
    parts = (x if x is None else x[..., :known] for x in pairs[3:])
    rows = (x if x is None else x[..., :known, :] for x in pairs[1:3])
    return Pairs(pairs.eigenvalue[..., :known], *rows, *parts)


def _periodic(spinning: SpinningModel, value: Tensor, right: Tensor) -> Tensor:
    """(...) of an eigenvalue: the most that coefficients that change with the azimuth would move
    one, or couple two, beyond their rounding.
    """
    (M, D, K), W = spinning.constant(), spinning.speed[..., None, None]
    v, by = right.mT, value[..., None, :]
    a, b = v.abs(), by.abs()
    summed = a.mT @ (K.abs() @ a + b * (D.abs() @ a) + b**2 * (M.abs() @ a))
    rounding = ROUNDING * torch.finfo(K.dtype).eps * summed
    slope = ((v.conj() * (2 * by * (M.to(v.dtype) @ v) + D.to(v.dtype) @ v)).sum(-2)).abs()
    size = (slope[..., :, None] * slope[..., None, :]).sqrt()
    most = torch.zeros_like(value.real[..., 0])
    at = torch.tensor((0.7, 1.9), dtype=most.dtype, device=most.device)
    change = (A - B for A, B in zip(spinning.periodic(at), spinning.constant(), strict=True))
    for M, D, K in zip(*change, strict=True):
        M, D, K = (A.to(v.dtype) for A in (M, D, K))
        coupling = (v.mH @ (K @ v + by * (D @ v) + by**2 * (M @ v))).abs()
        share = (coupling - rounding).clamp(min=0) / size / torch.maximum(by.abs(), W)
        share = torch.where(torch.isfinite(share), share, 0.0)
        most = torch.maximum(most, share.amax((-1, -2)))
    return most


def orbit_steps(steps: int) -> int:
    """How many midpoint steps a turn of an orbit has, by steps of Floquet's. They are odd: each
    changes the sign of motions much faster than it, which come back as they were after an even
    number, and are part of no other orbit after an odd one.
    """
    return ORBIT_STEPS * steps + 1


def floquet_modes(
    spinning: SpinningModel,
    pairs: Pairs,
    growth: Tensor,
    steps: int,
    count: int,
    done: Callable[[int], None],
    orbit: Orbit | None = None,
) -> SpinningModes:
    """Exponents by so many steps a turn; pairs, growth (n, ...): those where nothing turns. `done`
    is called with how many speeds more are. orbit(k, steps, count, limit): those of a motion that
    changes over the turn, at the k-th speed, by steps of second order.
    """
    free = spinning.mechanical.M.shape[-1]
    several = min(count + SPARE, 2 * free)
    first = int((concrete(spinning.speed.flatten())[:1] == 0).sum())  # speeds rise
    results = [(*_at_rest(pairs, several, first), growth[:first])] if first else []
    size = spinning.speed[0].numel() * steps * 4 * spinning.M.shape[-1] ** 2
    at_once = max(1, ROOM // size) if orbit is None else 1
    for k in range(first, len(spinning.speed), at_once):
        some = spinning.at(slice(k, k + at_once))
        limit = fastest(some.speed, steps)

        def by(steps: int, k: int = k, some: SpinningModel = some, limit: Tensor = limit) -> Any:
            if orbit is not None:
                return (x[None] for x in orbit(k, steps, several, limit[0]))
            return exponents(some.periodic, some.speed, steps, several, limit, spinning.states)

        value, shape = by(steps)
        with no_derivatives():
            coarse = next(iter(by(steps // 2))).flatten(-2)
            coarse = torch.cat((coarse, coarse.conj()), -1)  # either one of a pair may be known
            apart = coarse[..., None, :] - value[..., :1]
            apart = apart.gather(-1, apart.abs().argmin(-1, keepdim=True))
            share = 2**ORDER - 1
            if orbit is not None:
                share = (orbit_steps(steps) / orbit_steps(steps // 2)) ** 2 - 1
            error = (apart.abs() / share).expand(value.shape)
        if orbit is not None:
            value = torch.where(value == NONE, NONE, value - apart / share)
        growing = _growth(value[..., 0], some.speed, error[..., 0])
        value, shape, error = _swinging_exponents(some, value, shape, error, several, count)
        results.append((value, shape, error, growing))
        done(len(value))
    *parts, growth = map(torch.cat, zip(*results, strict=True))
    return SpinningModes(*parts, pairs.eigenvalue, growth)


def _swinging_exponents(
    spinning: SpinningModel, value: Tensor, shape: Tensor, error: Tensor, several: int, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """`several` of exponents (..., m, h), shapes and errors; NONE for those behind the first
    `count` that do not oscillate.
    """
    with no_derivatives():
        at, swings = _swinging(spinning, value[..., 0], shape[..., 0, :], several)
        at = at[..., :several, None].expand(*at.shape[:-1], several, HARMONICS)
        none = ~swings.gather(-1, at[..., 0]) & (torch.arange(several, device=at.device) >= count)
    value = torch.where(none[..., None], NONE, value.gather(-2, at))
    shape = shape.gather(-3, at[..., None].expand(*at.shape, shape.shape[-1]))
    return value, shape, error.gather(-2, at)


def _at_rest(pairs: Pairs, several: int, first: int) -> tuple[Tensor, Tensor, Tensor]:
    """Of the first speeds, in the shape of exponents."""
    value, shape = pairs.eigenvalue[:first, ..., :several], pairs.right[:first, ..., :several, :]
    more = several - value.shape[-1]
    none = torch.full_like(value[..., :1], NONE).expand(*value.shape[:-1], more)
    value = torch.cat((value, none), -1)[..., None]
    shape = pad(shape, (0, 0, 0, more))[..., None, :]
    value = value.expand(*value.shape[:-1], HARMONICS)
    return value, shape.repeat_interleave(HARMONICS, -2), torch.zeros_like(value.real)
