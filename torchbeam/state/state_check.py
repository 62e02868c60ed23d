"""Whether a state that was given is one of the nodal form, of a scene's mesh."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from ..core.validation import broadcast, refusal
from .state import State


def check_state(state: Any, scene: Any, name: str = "initial") -> State:
    """`state`, to start from, in the scene's dtype; ValueError where it is none of its mesh."""
    state = of_mesh(state, scene, name)
    broadcast("a scene and an initial state", scene.batch_shape, state.batch_shape)
    return state


def of_mesh(state: Any, like: Any, name: str) -> State:
    """`state`, in the dtype of `like`, a scene or a state; ValueError where it is not one of the
    nodal form, with the nodes and the rows of stress of `like` in each of its fields: native code
    takes them on trust.
    """
    mesh, stresses = getattr(like, "beam", like), like.stress_count
    nodes, dtype = mesh.node_count, mesh.nodes.dtype
    if not isinstance(state, State):
        raise refusal(
            f"{name} of type {type(state).__name__}", "a torchbeam.State, of the nodal form,"
        )
    if state.position.shape[-2] != nodes:
        raise ValueError(
            f"{name} with {state.position.shape[-2]} nodes was given; the beam has {nodes}"
        )
    axes = dict(position=3, rotation=4, velocity=3, spin=3)
    for key, shape in (*((key, (nodes, k)) for key, k in axes.items()), ("stress", (stresses, 6))):
        x = getattr(state, key)
        if x.shape[-2:] != shape:
            raise refusal(
                f"{name} whose {key} is of shape {tuple(x.shape)}", f"(..., {shape[0]}, {shape[1]})"
            )
    held = [x.dtype for x in vars(state).values() if isinstance(x, Tensor)]
    alike = all([kind == dtype or not kind.is_floating_point for kind in held])
    return state if alike else state.to(dtype)
