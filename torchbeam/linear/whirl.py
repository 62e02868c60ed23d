"""Modes of a spinning rotor: which is which at the next speed, how they whirl, and their names."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import torch
from torch import Tensor

from ..math.quadratic_eigen import STRAIGHT, relaxes
from .bearing import Bearing
from .mode_pairing import modal_assurance, pairs
from .multiblade import SpinningModel

SAME = 1e-6  # of a growth, by how much frequencies may differ that are the same
WHIRLS = 0.3  # mean harmonic from which on a mode whirls
BEHIND = 1e20  # rad/s, in order of frequency: before what is none, behind all others
APERIODIC = 0.95  # damping ratio from which on a motion hardly oscillates
# of |eigenvalue|, or of the speed: growth from which on a mode is unstable; where two eigenvalues
# meet, as those of a free turn, rounding counts by its root
GROWING = 1e-5
NEAR = 0.2  # of a frequency: a change from speed to speed that halves the likeness of two modes


def grows(
    value: Tensor, speed: Tensor, error: Tensor | float = 0.0, rounding: float = GROWING
) -> Tensor:
    """(..., m) bool: which eigenvalues (..., m) grow, at speeds (..., 1) rad/s, beyond rounding, of
    the eigenvalue or the speed, and an error (..., m) 1/s.
    """
    least = rounding * torch.maximum(value.abs(), speed)
    return (value.real > least) & (value.real > 10 * error)


class Motions(NamedTuple):
    """Eigenvalue (..., m) 1/s and shape (..., m, channels) of motions by their harmonics."""

    value: Tensor
    shape: Tensor

    def at(self, *k: int) -> Motions:
        return Motions(self.value[k], self.shape[k])

    def taken(self, index: Tensor) -> Motions:
        """Those at places (..., count)."""
        rows = index[..., None].expand(*index.shape, self.shape.shape[-1])
        return Motions(self.value.gather(-1, index), self.shape.gather(-2, rows))


def tracked(speed: Tensor, motions: Motions, h: int, relaxed: Tensor, count: int) -> Tensor:
    """(n, ..., count) places among m h motions (n, ...), m by each of h harmonics: the slowest at
    the last speed, by their first harmonic, those that relax there, `relaxed` (..., m) bool, behind
    the others; and at each speed before those most like them, by modal assurance and frequency; in
    order of their mean frequencies. Where a frequency passes zero the other one of its pair goes
    on. Where one parts into a growing and a decaying motion, which are as fast, the growing one
    goes on.
    """
    value = motions.value
    first = value[-1, ..., ::h]
    first = first.imag.abs() - SAME * first.real  # of those as fast the growing ones
    chosen = torch.where(relaxed, BEHIND + first, first).argsort(dim=-1, stable=True)[..., :count]
    index = [h * chosen]
    for k in range(len(value) - 2, -1, -1):
        last = motions.at(k + 1).taken(index[-1])
        there = motions.at(k)
        best, harmonic = (
            _likeness(speed[k + 1], last, speed[k], there).unflatten(-1, (-1, h)).max(-1)
        )
        motion = pairs(best)
        at = h * motion + harmonic.gather(-1, motion[..., None])[..., 0]
        index.append(_growing(speed[k], there, last, at, h))
    index = torch.stack(index[::-1])
    mean = value.gather(-1, index).imag.abs().mean(0)
    mean = torch.where(relaxed.gather(-1, chosen), BEHIND + mean, mean)
    order = mean.argsort(dim=-1, stable=True)
    return index.gather(-1, order.expand(index.shape))


def next_motion(speed: Tensor, motion: Motions, other: Tensor, there: Motions) -> Tensor:
    """(...) place of a motion (...) at a speed (...) among those (..., m) at another one: the most
    like it, and of those as fast the growing one.
    """
    last = Motions(motion.value[..., None], motion.shape[..., None, :])
    index = _likeness(speed, last, other, there).argmax(-1)
    return _growing(other[..., None], there, last, index, 1)[..., 0]


def _likeness(speed: Tensor, last: Motions, other: Tensor, there: Motions) -> Tensor:
    """(..., count, m) of motions (..., count) at a speed and (..., m) at another one."""
    before, change = last.value[..., None], (other - speed).abs()
    size, likeness = NEAR * before.abs() + change.reshape(*change.shape, 1, 1), []
    for of in (lambda x: x, torch.conj):
        off = (of(there.value)[..., None, :] - before).abs() / size
        likeness.append(modal_assurance(last.shape, of(there.shape)) / (1 + off**2))
    return torch.maximum(*likeness)


def _growing(speed: Tensor, there: Motions, last: Motions, index: Tensor, h: int) -> Tensor:
    """Places (..., count) among motions (..., m h) at a speed, with those that grow, and are not
    among them, in place of those as fast that grow less; the most like the last ones (..., count).
    """
    value = there.value
    here, size = value.gather(-1, index)[..., None], torch.maximum(value.abs(), speed)
    other = torch.arange(value.shape[-1], device=index.device) // h
    other = (other[:, None] != index[..., None, :] // h).all(-1)[..., None, :]
    by, least = value[..., None, :], SAME * size[..., None, :]
    better = other & (by.real > least) & (by.real > here.real + least)
    better = better & ((here.imag.abs() - by.imag.abs()).abs() <= least)
    likeness = torch.where(better, 1 + modal_assurance(last.shape, there.shape), 0)
    best, harmonic = likeness.unflatten(-1, (-1, h)).max(-1)
    motion = pairs(best)[..., None]
    at = h * motion + harmonic.gather(-1, motion)
    return torch.where(best.gather(-1, motion) > 0, at, index[..., None])[..., 0]


def whirl(spinning: SpinningModel, shape: Tensor) -> Tensor:
    """(..., count) mean harmonic of the rotor's motion in shapes (..., count, n) of coordinates
    that do not spin, by kinetic energy: r^H M (-i S) r / r^H M r.
    """
    B, S, M = (A.to(shape.dtype) for A in (spinning.B, spinning.S, spinning.M_r))
    r = B @ shape.mT
    energy = (r.conj() * (M @ r)).sum(-2).real
    turning = (r.conj() * (M @ (-1j * (S @ r)))).sum(-2).real
    return turning / torch.where(energy > 0, energy, 1.0)


def relaxing(spinning: SpinningModel, value: Tensor, shape: Tensor) -> Tensor:
    """(..., m) bool: which eigenvalues (..., m), with shapes (..., m, n), decay without
    oscillating, seen from the ground or in axes that turn with the mean harmonic. There, nearly so,
    where there are internal states; else where inertia hardly counts, or the decay is faster than
    the speed: a whirl that is as fast as the speed stands still there too.
    """
    plain, speed = spinning.mechanical, spinning.speed[..., None]
    moves = shape[..., : plain.M.shape[-1]]
    turning = value - 1j * speed * whirl(plain, moves).round()
    if spinning.states:
        return relaxes(value, True) | (turning.real < -APERIODIC * turning.abs())
    (M, _, K), x = plain.constant(), moves.mT
    inertia, stiffness = ((x.conj() * (A.to(x.dtype) @ x)).sum(-2).real for A in (M, K))
    light = (value.abs().square() * inertia < stiffness / 4) | (-value.real > value.imag.abs())
    still = turning.imag.abs() <= STRAIGHT * torch.maximum(value.abs(), speed)
    return relaxes(value) | light & still & (turning.real < 0)


def names_of(bearing: Bearing, spinning: SpinningModel, shape: Tensor) -> list[str]:
    """Of modes (count, n) at one speed."""
    B, S, M, M_r, moves = (
        A.to(shape.dtype)
        for A in (spinning.B, spinning.S, spinning.M, spinning.M_r, spinning.moves)
    )
    r, space = B @ shape.mT, bearing.model.space
    whole, energy, harmonics = (
        (x.conj() * y).sum(-2).real
        for x, y in ((shape.mT, M @ shape.mT), (r, M_r @ r), (S @ r, M_r @ (S @ r)))
    )
    turning = whirl(spinning, shape)
    place = (moves @ shape.mT).mT.unflatten(-1, (-1, space.unknowns))
    unit = bearing.model.unit.reshape(-1, space.unknowns)[0]
    p, place = space.dims.position, (place / unit)[:, bearing.rotor]
    axis = bearing.direction.reshape(-1, 3)[0]
    along, about = (
        (x @ of.to(x.dtype)).abs().square().sum(-1)
        for x, of in (
            (place[..., :p], space.project_vector(axis)),
            (place[..., p:], space.project_spin(axis)),
        )
    )
    everything = place.abs().square().sum((-1, -2))
    flaps = along > 0.5 * place[..., :p].abs().square().sum((-1, -2))
    names = []
    for k in range(len(shape)):
        words = ["support"] if energy[k] < 0.5 * whole[k] else []
        if not words and spinning.bladed:
            words = ["flap" if flaps[k] else "lag"]
        if abs(turning[k]) > WHIRLS:
            words.append("forward" if turning[k] > 0 else "backward")
        elif spinning.bladed and spinning.order and harmonics[k] < WHIRLS * energy[k]:
            words.append("collective")
        elif not words:
            axial, twists = (x[k] > 0.5 * everything[k] for x in (along, about))
            words.append("axial" if axial else "torsion" if twists else "bending")
        names.append(" ".join(words))
    seen: Counter[str] = Counter()
    for k, name in enumerate(names):
        seen[name] += 1
        names[k] = f"{name} {seen[name]}"
    return names
