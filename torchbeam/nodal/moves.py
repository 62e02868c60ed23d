"""Moves: small changes of a state in the space's coordinates, to first order.

A move has 2 w (N+1) + Z numbers: displacement and turn of each node, frame a; the changes of its
absolute velocity and of its absolute spin, frame a; the changes of what it remembers: internal
states of loads, and what elements have crept by.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..math.shapes import stacked
from ..state.state import State
from .coordinates.spatial import Spatial


def remembered(state: State) -> Tensor | None:
    """(..., Z): internal states of loads and what elements have crept by; None = nothing."""
    parts = [] if state.internal is None else [state.internal]
    parts += [] if state.inelastic is None else [state.inelastic.flatten(-2)]
    if len(parts) < 2:
        return parts[0] if parts else None
    return stacked(*parts, axis=-1)


def remembered_count(state: State) -> int:
    """Z, how many numbers a state remembers beside its motion."""
    more = remembered(state)
    return 0 if more is None else more.shape[-1]


def remembering(state: State, more: Tensor) -> dict[str, Tensor | None]:
    """Fields of a state that remembers `more` (..., Z) on top of this one."""
    z = 0 if state.internal is None else state.internal.shape[-1]
    internal = inelastic = None
    if state.internal is not None:
        internal = state.internal + more[..., :z]
    if state.inelastic is not None:
        inelastic = state.inelastic + more[..., z:].unflatten(-1, state.inelastic.shape[-2:])
    return {"internal": internal, "inelastic": inelastic}


def moved(space: Spatial, state: State, move: Tensor) -> State:
    """The state after a move (..., 2 w (N+1) + Z); exact to first order."""
    (displacement, turn), (velocity, spin), more = _parts(space, state, move)
    rate = space.rotation_rate(state.rotation, space.to_section(state.rotation, turn))
    rotation = state.rotation + rate
    spin = space.to_section(rotation, space.to_frame(state.rotation, state.spin) + spin)
    return replace(
        state,
        position=state.position + displacement,
        rotation=rotation,
        velocity=state.velocity + velocity,
        spin=spin,
        **remembering(state, more),
    )


def move_between(space: Spatial, start: State, end: State) -> Tensor:
    """(..., 2 w (N+1) + Z): the move from one state to another one; exact to first order."""
    turn = space.logarithm(space.multiply(end.rotation, space.inverse(start.rotation)))
    turn = turn if space.turns else space.to_frame(start.rotation, turn)
    spins = (space.to_frame(x.rotation, x.spin) for x in (end, start))
    pose = torch.cat((end.position - start.position, turn), -1)
    rate = torch.cat((end.velocity - start.velocity, next(spins) - next(spins)), -1)
    before = remembered(start)
    more = () if before is None else (remembered(end) - before,)
    return torch.cat((pose.flatten(-2), rate.flatten(-2), *more), -1)


def _parts(space: Spatial, state: State, move: Tensor) -> tuple[list[Tensor], list[Tensor], Tensor]:
    """Displacement and turn, velocity and spin (..., N+1, .), what is remembered."""
    w = space.unknowns * state.position.shape[-2]
    pose, rate, more = move.split((w, w, move.shape[-1] - 2 * w), -1)
    split = [
        x.unflatten(-1, (-1, space.unknowns)).split((space.dims.position, space.dims.spin), -1)
        for x in (pose, rate)
    ]
    return *split, more
