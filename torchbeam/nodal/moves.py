"""Moves: small changes of a state in the space's coordinates, to first order.

A move has 2 w (N+1) + Z numbers: displacement and turn of each node, frame a; the changes of its
absolute velocity and of its absolute spin, frame a; the changes of internal states.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..state.state import State
from .coordinates.spatial import Spatial


def moved(space: Spatial, state: State, move: Tensor) -> State:
    """The state after a move (..., 2 w (N+1) + Z); exact to first order."""
    (displacement, turn), (velocity, spin), internal = _parts(space, state, move)
    rate = space.rotation_rate(state.rotation, space.to_section(state.rotation, turn))
    rotation = state.rotation + rate
    spin = space.to_section(rotation, space.to_frame(state.rotation, state.spin) + spin)
    return replace(
        state,
        position=state.position + displacement,
        rotation=rotation,
        velocity=state.velocity + velocity,
        spin=spin,
        internal=None if state.internal is None else state.internal + internal,
    )


def move_between(space: Spatial, start: State, end: State) -> Tensor:
    """(..., 2 w (N+1) + Z): the move from one state to another one; exact to first order."""
    turn = space.logarithm(space.multiply(end.rotation, space.inverse(start.rotation)))
    turn = turn if space.turns else space.to_frame(start.rotation, turn)
    spins = (space.to_frame(x.rotation, x.spin) for x in (end, start))
    pose = torch.cat((end.position - start.position, turn), -1)
    rate = torch.cat((end.velocity - start.velocity, next(spins) - next(spins)), -1)
    internal = () if start.internal is None else (end.internal - start.internal,)
    return torch.cat((pose.flatten(-2), rate.flatten(-2), *internal), -1)


def _parts(space: Spatial, state: State, move: Tensor) -> tuple[list[Tensor], list[Tensor], Tensor]:
    """Displacement and turn, velocity and spin (..., N+1, .), internal states."""
    w = space.unknowns * state.position.shape[-2]
    pose, rate, internal = move.split((w, w, move.shape[-1] - 2 * w), -1)
    split = [
        x.unflatten(-1, (-1, space.unknowns)).split((space.dims.position, space.dims.spin), -1)
        for x in (pose, rate)
    ]
    return *split, internal
