"""Speeds between which a rotor is unstable."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..linear.whirl import Motions, grows, next_motion

# of |eigenvalue|, or of the speed: growth of a motion known to grow nearby that is rounding
ROUNDING = 1e-8
ROUNDS = 40
BEYOND = 100.0  # tolerances: how far an end may lie beyond a speed known to be stable
ASIDE = 0.02  # of what is left between two speeds: how far from the estimate the next one is

At = Callable[[Tensor], tuple[Motions, Tensor]]
Ranges = tuple[tuple[float, float], ...]


def unstable_between(
    speed: Tensor, motions: Motions, growing: Tensor, at: At, tolerance: float
) -> Ranges:
    """Ranges (rad/s) of speeds (n,) at which the fastest growing one of motions `growing` (n,)
    bool. Where its growth ends between two speeds is found by motions, and whether they grow, `at`
    others, within a tolerance of the speed; where that is infinite, by a straight line.
    """
    flags, ends, ranges = growing.tolist(), [], []
    for k, unstable in enumerate(flags):
        if unstable and not (k and flags[k - 1]):
            first = k
        if unstable and (k + 1 == len(flags) or not flags[k + 1]):
            ends += [_end(speed, motions, first, -1), _end(speed, motions, k, 1)]
    open_ends = [k for k, end in enumerate(ends) if end[0] != end[1]]
    values = [speed[end[1]].item() for end in ends]
    if open_ends:
        outer, inner, which, f = (
            torch.tensor(x) for x in zip(*(ends[k] for k in open_ends), strict=True)
        )
        of = Motions(motions.value[inner, which], motions.shape[inner, which])
        roots = _zeros(speed[outer], speed[inner], f.to(speed), of, at, tolerance)
        for k, root in zip(open_ends, roots.tolist(), strict=True):
            values[k] = root
    for low, high in zip(values[::2], values[1::2], strict=True):
        if ranges and low <= ranges[-1][1]:
            low, high = ranges[-1][0], max(high, ranges.pop()[1])
        ranges.append((low, high))
    return tuple(ranges)


def _end(speed: Tensor, motions: Motions, k: int, step: int) -> tuple[int, int, int, float]:
    """The next speed in a direction at which the motion that grows fastest at speed k does not
    grow, the one before, its place there, and its growth at the first of them; the same speed twice
    where it grows at all others.
    """
    which = int(motions.value[k].real.argmax())
    while 0 <= k + step < len(speed):
        there = next_motion(speed[k], motions.at(k, which), speed[k + step], motions.at(k + step))
        value = motions.value[k + step, there]
        if not grows(value, speed[k + step], rounding=ROUNDING):
            return k + step, k, which, value.real.item()
        k, which = k + step, int(there)
    return k, k, which, 0.0


def _zeros(
    stable: Tensor, unstable: Tensor, f: Tensor, motion: Motions, at: At, tolerance: float
) -> Tensor:
    """(k,) speeds between stable and unstable ones, with a real part f (k,) at the stable ones of a
    motion (k,) known at the unstable ones: by the secant, whose sides close in in turn, or halves.
    """
    least = tolerance * torch.maximum(stable, unstable)
    for k in range(ROUNDS):
        gap, g = unstable - stable, motion.value.real
        share, most = f / (f - g), (BEYOND * least / gap.abs()).clamp(min=1.0)
        # what grows by less than rounding, at the stable speed, has its zero beyond
        share = share.clamp(0.0, 1.0) if math.isinf(tolerance) else share.clamp(-most, most)
        zero = stable + share * gap
        if bool((gap.abs() <= least).all()):
            break
        x = zero + (-ASIDE, ASIDE, torch.nan)[k % 3] * gap
        inside = (f < 0) & (((x - stable) / gap - 0.5).abs() < 0.5)
        x = torch.where(inside, x, stable + gap / 2)
        motions, others = at(x)
        there = next_motion(unstable, motion, x, motions)
        going = motions.value.gather(-1, there[:, None])[:, 0]
        growing = grows(going, x, rounding=ROUNDING)
        there = torch.where(others & ~growing, motions.value.real.argmax(-1), there)
        value, shape = motions.at(torch.arange(len(x)), there)
        growing = growing | others
        stable, f = torch.where(growing, stable, x), torch.where(growing, f, value.real)
        unstable = torch.where(growing, x, unstable)
        value = torch.where(growing, value, motion.value)
        motion = Motions(value, torch.where(growing[:, None], shape, motion.shape))
    return zero
