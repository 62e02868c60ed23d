"""Modes of a spinning rotor: which is which at the next speed, how they whirl, and their names."""

from __future__ import annotations

from collections import Counter

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
NEAR = 0.2  # of a frequency: a change from speed to speed that halves the likeness of two modes


def tracked(speed: Tensor, value: Tensor, shape: Tensor, relaxed: Tensor, count: int) -> Tensor:
    """(n, ..., count) places among eigenvalues (n, ..., m h) with shapes (n, ..., m h, channels),
    of m motions by each of h harmonics, value (n, ..., m, h): the slowest at the last speed, by
    their first harmonic, those that relax there, `relaxed` (..., m) bool, behind the others; and at
    each speed before those most like them, by modal assurance and frequency; in order of their mean
    frequencies. Where a frequency passes zero the other one of its pair goes on.
    """
    h, value = value.shape[-1], value.flatten(-2)
    first = value[-1, ..., ::h]
    first = first.imag.abs() - SAME * first.real  # of those as fast the growing ones
    chosen = torch.where(relaxed, BEHIND + first, first).argsort(dim=-1, stable=True)[..., :count]
    index = [h * chosen]
    for k in range(len(value) - 2, -1, -1):
        last = _taken(shape[k + 1], index[-1])
        before = value[k + 1].gather(-1, index[-1])[..., :, None]
        size, likeness = NEAR * before.abs() + (speed[k + 1] - speed[k]), []
        for at, there in ((value[k], shape[k]), (value[k].conj(), shape[k].conj())):
            off = (at[..., None, :] - before).abs() / size
            likeness.append(modal_assurance(last, there) / (1 + off**2))
        best, harmonic = torch.maximum(*likeness).unflatten(-1, (-1, h)).max(-1)
        motion = pairs(best)
        index.append(h * motion + harmonic.gather(-1, motion[..., None])[..., 0])
    index = torch.stack(index[::-1])
    mean = value.gather(-1, index).imag.abs().mean(0)
    mean = torch.where(relaxed.gather(-1, chosen), BEHIND + mean, mean)
    order = mean.argsort(dim=-1, stable=True)
    return index.gather(-1, order.expand(index.shape))


def _taken(shape: Tensor, index: Tensor) -> Tensor:
    return shape.gather(-2, index[..., None].expand(*index.shape, shape.shape[-1]))


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
