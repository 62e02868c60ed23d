"""Supported nodes: their places and motions put into a state; the motion of frame a."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..core.functions_of_time import shared
from ..math import quaternions as quat
from ..scene.prescribed_motion import PrescribedMotion
from .instant import Instant

# a state with the nodes' positions, rotations, velocities and spins
Placed = TypeVar("Placed", bound=Instant)


def at_supports(state: Placed, prescribed_motion: PrescribedMotion) -> Placed:
    """A state with what supports hold where they are at its time."""
    position, rotation = state.position, state.rotation
    for support in prescribed_motion.scene.supports:
        if support.displaced:
            place, turn = prescribed_motion.pose(support, shared(state.t))
            position = _put_held(position, support, place)
            rotation = set_node(rotation, support.node, turn)
    return replace(state, position=position, rotation=rotation)


def at_rest(state: Placed, prescribed_motion: PrescribedMotion) -> Placed:
    """A state at rest in frame a, what supports hold with the motion that they have."""
    t = shared(state.t)
    velocity, spin = frame_motion(state, prescribed_motion)
    for support in prescribed_motion.scene.supports:
        if support.moves:
            motion = prescribed_motion.absolute(support, t)
            velocity = _put_held(velocity, support, motion[0])
            spin = spin if support.turn is None else set_node(spin, support.node, motion[1])
    return replace(state, velocity=velocity, spin=spin)


def frame_motion(state: Placed, prescribed_motion: PrescribedMotion) -> tuple[Tensor, Tensor]:
    """Velocity (..., N+1, 3) m/s, frame a, and spin, section axes, of nodes at rest in it."""
    frame = prescribed_motion.frame(shared(state.t))
    v, omega = (None if x is None else x[..., None, :] for x in frame)
    velocity = torch.zeros_like(state.position)
    spin = torch.zeros_like(velocity)
    if omega is not None:
        velocity = velocity + quat.cross(omega, state.position)
        spin = spin + quat.rotate(quat.conjugate(state.rotation), omega)
    return velocity if v is None else velocity + v, spin


def held_rotation(q: Tensor, at: Tensor, support: Any) -> Tensor:
    """The rotation q (..., 4) of a node with what its support holds as in `at` (..., 4)."""
    if not support.rotation:
        return q
    if len(support.rotation) == 3:
        return at.expand_as(q + at)
    free = at.new_tensor([1.0] + [float(not held) for held in support.held[3:]])
    return quat.multiply(quat.normalize(quat.multiply(q, quat.conjugate(at)) * free), at)


def _put_held(x: Tensor, support: Any, value: Tensor) -> Tensor:
    """`set_node`, of the components whose position is held."""
    held, at_node = torch.tensor(support.held[:3], device=x.device), x[..., support.node, :]
    return set_node(x, support.node, torch.where(held, value, at_node))


def set_node(x: Tensor, node: int, value: Tensor) -> Tensor:
    """x (..., N+1, n) with the row of a node replaced by value (..., n)."""
    at = torch.zeros(x.shape[-2], 1, dtype=torch.bool, device=x.device)
    at[node] = True
    return torch.where(at, value[..., None, :], x)
