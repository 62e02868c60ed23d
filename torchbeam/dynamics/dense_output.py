"""Dense output: states between those of a step, and states extrapolated to steps of no length."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..math import quaternions as quat
from ..scene.prescribed_motion import PrescribedMotion
from ..state.reduced import REMEMBERED
from ..state.state import State
from ..state.supported_nodes import frame_motion

# fields between two states on a straight line, as the stress and the reaction
LINEAR = ("work", "defect", *REMEMBERED)
ADDED = ("position", "velocity", "spin", *LINEAR)


def extrapolated(coarse: State, fine: State, order: int) -> State:
    """States of the limit, from those made by steps of twice the length and these (Richardson
    1911): the error of a symmetric method of this order has even powers of the step alone, so that
    the limit is two orders better; of first order it is one. Rotations along the shortest one from
    the coarse to the fine; stress and reaction, which are means over a step, are the fine ones.
    """
    more = 1 / (2**order - 1)
    fields = {
        name: x + more * (x - getattr(coarse, name))
        for name in ADDED
        if (x := getattr(fine, name)) is not None
    }

    def turned(a: Tensor, b: Tensor) -> Tensor:
        return quat.normalize(quat.multiply(b, quat.exponential(more * _turn(a, b))))

    frame = None if fine.frame is None else turned(coarse.frame, fine.frame)
    return replace(fine, **fields, rotation=turned(coarse.rotation, fine.rotation), frame=frame)


def between(a: State, b: State, t: Tensor, motion: PrescribedMotion) -> State:
    """The state at the times t (...) between those of two.

    Positions are the cubic of both positions and velocities (Hermite), rotations R_a exp(phi) with
    the cubic phi of the relative rotation vector and the spins; velocities and spins are their
    rates. Everything is relative to frame a, which may move: fourth order in the step, third for
    velocities. What a state holds beside its motion lies on a straight line.
    """
    h = (b.t - a.t)[..., None, None]
    h = torch.where(h > 0, h, torch.ones_like(h))
    s = (t - a.t)[..., None, None] / h
    va, vb, wa, wb = a.velocity, b.velocity, a.spin, b.spin
    moves = motion.scene.frame is not None
    if moves:
        (fa, ga), (fb, gb) = frame_motion(a, motion), frame_motion(b, motion)
        va, vb, wa, wb = va - fa, vb - fb, wa - ga, wb - gb
    position, velocity = _cubic(torch.zeros_like(va), b.position - a.position, va, vb, s, h)
    phi = _turn(a.rotation, b.rotation)
    zero = torch.zeros_like(phi)
    vector, rate = _cubic(zero, phi, wa, _rate_of_vector(phi, wb), s, h)
    rotation = quat.normalize(quat.multiply(a.rotation, quat.exponential(vector)))
    spin = quat.rotate(quat.conjugate(quat.exponential(vector)), quat.spin_of_vector(vector, rate))
    fields = {}
    for name in (*LINEAR, "stress", "reaction"):
        x, y = getattr(a, name), getattr(b, name)
        if x is not None:
            share = s.reshape((*s.shape[:-2], *(1,) * (x.ndim - s.ndim + 2)))
            fields[name] = x + share * (y - x)
    frame = None
    if a.frame is not None:
        frame = quat.normalize(
            quat.multiply(a.frame, quat.exponential(s[..., 0] * _turn(a.frame, b.frame)))
        )
    state = replace(
        a,
        **fields,
        position=a.position + position,
        rotation=rotation,
        velocity=velocity,
        spin=spin,
        frame=frame,
        t=torch.zeros_like(a.t) + t,
        status=b.status,
    )
    if moves:
        f, g = frame_motion(state, motion)
        state = replace(state, velocity=state.velocity + f, spin=state.spin + g)
    return state


def with_means(
    state: State, first: State, second: State, share: Tensor, place: Tensor | float
) -> State:
    """`state` with stress and reaction on the straight line through those of the halves of a step,
    at a share (...) of that step; `first` and `second` are the states after the halves. A reaction
    is the mean over its half, a stress at `place` (...) in it, a share of the half, see
    `Method.stress_at`.
    """
    s, r = ((2 * share - at)[..., None, None] for at in (place, 0.5))
    return replace(
        state,
        stress=first.stress + s * (second.stress - first.stress),
        reaction=first.reaction + r * (second.reaction - first.reaction),
    )


def _cubic(
    x: Tensor, y: Tensor, vx: Tensor, vy: Tensor, s: Tensor, h: Tensor
) -> tuple[Tensor, Tensor]:
    """The cubic from x to y over h with these rates at its ends, at the share s, and its rate."""
    rise = y - x - h * vx
    bend = h * (vy - vx)
    c, d = 3 * rise - bend, bend - 2 * rise
    return x + s * (h * vx + s * (c + s * d)), vx + s * (2 * c + 3 * s * d) / h


def _turn(a: Tensor, b: Tensor) -> Tensor:
    """Rotation vector (..., 3) from quaternion a to b, section axes."""
    return quat.logarithm(quat.multiply(quat.conjugate(a), b))


def _rate_of_vector(phi: Tensor, spin: Tensor) -> Tensor:
    """phi' (..., 3) of R = exp(phi), of the spin in section axes: w + phi x w / 2 + c phi x
    (phi x w), with x = |phi| and c = 1/x^2 - (1 + cos x)/(2 x sin x) (the inverse of
    `quaternions.spin_of_vector`, from the right).
    """
    square = (phi * phi).sum(-1, keepdim=True)
    small = square < 1e-4
    x2 = torch.where(small, torch.ones_like(square), square)
    half = x2.sqrt() / 2
    c = torch.where(
        small, 1 / 12 + square / 720 + square**2 / 30240, (1 - half / torch.tan(half)) / x2
    )
    once = torch.linalg.cross(phi, spin)
    return spin + once / 2 + c * torch.linalg.cross(phi, once)
