"""Bent beam: a state from a curve of nodes, its section axes carried along, and velocities."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import Tensor

from ..core.arguments import function as check_function
from ..core.functions_of_time import rate_along
from ..core.validation import Value, as_tensor, axis_last, finite, refusal
from ..math import quaternions as quat
from ..scene.curve import axes_of_nodes, carried_axes, orthonormal
from ..scene.prescribed_motion import PrescribedMotion
from ..scene.scene import Scene
from .supported_nodes import Placed, at_rest, frame_motion, held_rotation, set_node


def bent(
    still: Placed,
    scene: Scene,
    nodes: Value,
    frames: Value | None,
    twist: Any,
    velocity: Value | None,
    spin: Value | None,
) -> Placed:
    """The state `still` of the beam at rest, bent; arguments as of `State.from_nodes`."""
    beam = scene.beam

    def given(name: str, value: Value) -> Tensor:
        value = finite(name, axis_last(name, as_tensor(value, scene.dtype, scene.device), 3))
        if value.ndim < 2 or value.shape[-2] != beam.node_count:
            raise refusal(
                f"{name} of shape {tuple(value.shape)}", f"(..., {beam.node_count}, 3)", were=True
            )
        return value

    nodes = given("nodes", nodes)
    if frames is not None:
        if twist is not None:
            raise refusal("frames and a twist", "one of them", were=True)
        frames = as_tensor(frames, scene.dtype, scene.device)
        frames = quat.from_matrix(orthonormal(frames, beam.node_count, beam.station_count))
        rotation = frames if frames.shape[-2] == beam.node_count else axes_of_nodes(frames)
    elif beam.parts:
        raise refusal(
            "nodes of a structure without frames", "frames of all of its nodes", were=True, are=True
        )
    else:
        s = beam.topology.arclength(beam.length)
        if callable(twist):
            twist = as_tensor(check_function("twist", twist, "s")(s), scene.dtype, scene.device)
            if twist.shape[-1:] != s.shape[-1:]:
                raise refusal(f"a twist of shape {tuple(twist.shape)}", f"(..., {beam.node_count})")
        elif twist is not None:
            twist = as_tensor(twist, scene.dtype, scene.device)[..., None] * s / s[..., -1:]

        def axes(nodes: Tensor) -> Tensor:
            q = carried_axes(beam.frames, beam.nodes, nodes, s.diff(dim=-1), twist)
            for support in scene.supports:
                at_support, held = (x[..., support.node, :] for x in (q, still.rotation))
                q = set_node(q, support.node, held_rotation(at_support, held, support))
            return q

        rotation = axes(nodes)
    prescribed_motion = PrescribedMotion(scene)
    state = replace(still, position=nodes, rotation=rotation).broadcast()
    state = at_rest(state, prescribed_motion).broadcast()
    if velocity is not None:
        velocity = given("velocity", velocity)
        if spin is None and frames is None:
            relative = velocity - frame_motion(state, prescribed_motion)[0]
            q, rate = rate_along(axes, (nodes + 0 * relative,), (relative + 0 * nodes,))
            turn = 2 * quat.multiply(quat.conjugate(q), rate)[..., 1:]
            state = replace(state, spin=state.spin + turn)
        state = replace(state, velocity=velocity)
    return (state if spin is None else replace(state, spin=given("spin", spin))).broadcast()
