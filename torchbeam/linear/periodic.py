"""Floquet's exponents of a linear model whose coefficients have the period of a turn,

    M(psi) g'' + D(psi) g' + K(psi) g = 0        psi = W t

Its motions are g = u(psi) exp(lambda t), u of the same period: exp(lambda T) is an eigenvalue of
the map of g, g' over a turn of T = 2 pi/W, which tells lambda up to multiples i k W. The one is
taken by which the largest harmonic of u is constant: the frequency that is seen most.

A turn is made by Gauss's collocation with three stages (sixth order; it adds and takes no energy:
Hairer, Lubich, Wanner 2006, II.1.3), in second-order form, which takes coordinates without inertia.
Motions much faster than a step come out wrong, and are told by how fast they are on average, |u'| /
|u|, which stays: they are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete
from ..math.dense import solve

ROOT = math.sqrt(15.0)
NODES = (0.5 - ROOT / 10, 0.5, 0.5 + ROOT / 10)
WEIGHTS = (5 / 18, 4 / 9, 5 / 18)
STAGES = (
    (5 / 36, 2 / 9 - ROOT / 15, 5 / 36 - ROOT / 30),
    (5 / 36 + ROOT / 24, 2 / 9, 5 / 36 - ROOT / 24),
    (5 / 36 + ROOT / 30, 2 / 9 + ROOT / 15, 5 / 36),
)
ORDER = 6
NONE = 1e30j  # 1/s, in place of an exponent
HARMONICS = 3  # of each motion that are kept: which is largest may change with the speed
RESOLVED = 1.5  # rad a step
UNSEEN = 1e-16  # of a motion's squares: moves beside internal states that are rounding
FADED = 1e-4  # of a motion, after a turn: which harmonics lags that decay so have is rounding
LEAST_SEEN = 1e-2  # of the energy of the largest: those below are not seen, as rounding is not

Matrices = Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]


class Exponents(NamedTuple):
    """exponent (..., m) complex 1/s and shape (..., m, n), the largest harmonic of u, in order of
    how fast they are on average.
    """

    exponent: Tensor
    shape: Tensor


def fastest(speed: Tensor, steps: int) -> Tensor:
    """(...) rad/s up to which half as many steps of a turn tell a motion too: half a turn of it a
    step, nearly; with all steps a frequency errs by (omega dt)^6/100800, 1e-4 then.
    """
    return RESOLVED * steps / (2 * math.pi) * speed.abs()


def exponents(
    matrices: Matrices, speed: Tensor, steps: int, count: int, limit: Tensor, states: int = 0
) -> Exponents:
    """Of M, D, K (s, ..., n, n) = matrices(psi), psi (s,), at speeds (...), all, one of each pair,
    `count` at least, NONE where there are no more below a limit (...) rad/s. The last `states`
    coordinates have no inertia.
    """
    maps = _maps(matrices, speed, steps, states)
    n = (maps.shape[-1] + states) // 2
    M = matrices(torch.zeros_like(speed.flatten()[:1]))[0][0]
    moved, rates = maps[:-1, ..., :n, :], maps[:-1, ..., n:, :]
    return of_turn(maps[-1], moved, rates, M, speed, count, limit, states)


def of_turn(
    turn: Tensor,
    g: Tensor,
    rate: Tensor,
    M: Tensor,
    speed: Tensor,
    count: int,
    limit: Tensor,
    states: int,
) -> Exponents:
    """The same of the map over a turn (..., m, m), and what that makes of g, with internal states
    behind, and of rates, (steps, ..., n, m) and (steps, ..., r, m) at as many azimuths.
    """
    steps, n = len(g), g.shape[-2]
    multiplier, vectors = torch.linalg.eig(turn)
    lower = multiplier.imag < -1e-12 * multiplier.abs()  # the other one of its pair
    m = max(count, int(concrete((~lower).sum(-1)).max()))
    first = concrete(lower).to(torch.int8).argsort(dim=-1, stable=True)[..., :m]
    lower, multiplier = lower.gather(-1, first), multiplier.gather(-1, first)
    vectors = vectors.gather(-1, first[..., None, :].expand(*vectors.shape[:-1], m))
    period = 2 * math.pi / speed.abs()[..., None]
    principal = torch.log(multiplier) / period
    at = torch.arange(steps, device=speed.device) * (period[..., None] / steps)  # (..., 1, steps)
    decay = torch.exp(-principal[..., None] * at).movedim(-1, 0)[..., None, :]
    parts = vectors.real, vectors.imag
    g, rate = (torch.complex(*(X @ v for v in parts)) * decay for X in (g, rate))  # (steps, n, m)
    harmonics = torch.fft.fft(g.detach(), dim=0) / steps
    moves, of_moves = g[..., : n - states, :], harmonics[..., : n - states, :]
    M = M[..., : n - states, : n - states].detach()
    size = sum((x * (M @ x)).sum(-2) for x in (of_moves.real, of_moves.imag))  # (steps, ..., m)
    most, k = size.topk(HARMONICS, dim=0)
    shape = harmonics.gather(0, k[..., None, :].expand(*k.shape[:-1], n, k.shape[-1]))
    order = torch.where(k > steps // 2, k - steps, k)
    exponent = principal + 1j * order * speed.abs()[..., None]
    of_rates, of_moves, of_all = (x.detach().abs().square().sum((0, -2)) for x in (rate, moves, g))
    fast = (of_rates / of_moves).sqrt()
    lower = lower | ~(fast <= limit[..., None]) | (of_moves <= UNSEEN * of_all)
    if states:
        lower = lower | (multiplier.abs() < FADED)
    exponent = torch.where(lower | (most < LEAST_SEEN * most[:1]), NONE, exponent)
    chosen = torch.where(lower, torch.inf, fast).argsort(dim=-1, stable=True)
    exponent, shape = exponent.movedim(0, -1), shape.movedim(0, -1).movedim(-3, -1)
    at = chosen[..., None].expand(*chosen.shape, HARMONICS)
    return Exponents(exponent.gather(-2, at), shape.gather(-3, at[..., None].expand(*at.shape, n)))


def _maps(matrices: Matrices, speed: Tensor, steps: int, states: int) -> Tensor:
    """(steps + 1, ..., 2 n - Z, 2 n - Z): g, g' at the azimuths of the steps by those at psi = 0,
    without the rates of Z internal states, which follow.
    """
    angle, maps = 2 * math.pi / steps, []
    dt = (angle / speed.abs())[..., None, None]
    nodes = torch.tensor(NODES, dtype=speed.dtype, device=speed.device)
    for step in range(steps):
        at = matrices(angle * (step + nodes))
        if not step:
            size = 2 * at[0].shape[-1] - states
            eye = torch.eye(size, dtype=speed.dtype, device=speed.device)
            maps.append(eye.expand(*at[0].shape[1:-2], *eye.shape))
        maps.append(_step(at, pad(maps[-1], (0, 0, 0, states)), dt)[..., :size, :])
    return torch.stack(maps)


def _step(at: tuple[Tensor, Tensor, Tensor], X: Tensor, dt: Tensor) -> Tensor:
    """g, g' a step later, with M, D, K (3, ..., n, n) at its stages: the accelerations there solve
    M_i a_i + D_i v_i + K_i g_i = 0.
    """
    n = X.shape[-2] // 2
    g, v = X[..., :n, :], X[..., n:, :]
    rows, right = [], []
    twice = [
        [sum(STAGES[i][k] * STAGES[k][j] for k in range(3)) for j in range(3)] for i in range(3)
    ]
    for i, (M, D, K) in enumerate(zip(*at, strict=True)):
        blocks = [dt * STAGES[i][j] * D + dt**2 * twice[i][j] * K for j in range(3)]
        blocks[i] = blocks[i] + M
        rows.append(torch.cat(torch.broadcast_tensors(*blocks), -1))
        right.append(-(D @ v + K @ (g + NODES[i] * dt * v)))
    a = solve(torch.cat(rows, -2), torch.cat(right, -2)).unflatten(-2, (3, n)).unbind(-3)
    # of a mean acceleration the place takes what comes before the end of the step
    last = [sum(WEIGHTS[i] * STAGES[i][j] for i in range(3)) for j in range(3)]
    g = g + dt * v + dt**2 * sum(b * x for b, x in zip(last, a, strict=True))
    v = v + dt * sum(b * x for b, x in zip(WEIGHTS, a, strict=True))
    return torch.cat((g, v), -2)
