"""Whether a state that was given is one of the nodal form, of a scene's mesh; with what else the
scene wants of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import broadcast, refusal
from ..core.warning import warn
from ..scene.prescribed_motion import orientation, turning
from .instant import READINGS
from .rest_shape import RestShape
from .state import State, no_memory, no_motion, nothing_crept, supported, with_tendons


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


def with_optional_fields(state: State, scene: Any) -> State:
    """With an orientation of frame a and internal states of loads, where the scene wants them and
    the state has none; with the reactions of the scene's supports, zero where the state has those
    of others. Warns where it is of a beam of another rest shape. Raises ValueError where it has
    other orientations or internal states.
    """
    nodes, known = supported(scene), state.supports
    state = _of_this_beam(state, scene.beam)
    if state.reaction.shape[-2] != len(nodes) or known not in (None, nodes):
        none = state.reaction.new_zeros(*state.reaction.shape[:-2], len(nodes), 6)
        state = replace(state, reaction=none)
    state = state if known == nodes else replace(state, supports=nodes)
    if (state.parts, state.joined) != (scene.beam.parts, scene.beam.joined):
        state = replace(state, parts=scene.beam.parts, joined=scene.beam.joined)
    if state.frame is not None and not turning(scene):
        raise ValueError(
            "a state whose frame has turned was given for a scene whose frame does not turn; one "
            "of a scene with such a frame is wanted"
        )
    if turning(scene) and state.frame is None:
        state = replace(state, frame=orientation(scene, state.batch_shape, state.t)).broadcast()
    sizes = sum(scene.internal_states)
    if state.internal is not None and state.internal.shape[-1] != sizes:
        raise ValueError(
            f"a state with {state.internal.shape[-1]} internal states was given; the scene's "
            f"loads have {sizes}"
        )
    if sizes and state.internal is None:
        state = replace(state, internal=state.position.new_zeros(*state.batch_shape, sizes))
    if scene.joints and state.joints is None:
        state = replace(state, **no_motion(scene, state.position.new_zeros(state.batch_shape)))
    if scene.joints and (more := READINGS + scene.joint_memory - state.joints.shape[-1]):
        state = replace(state, joints=pad(state.joints, (0, more)))  # of a scene with other laws
    kept = None if state.memory is None else tuple(state.memory.shape[-2:])
    if scene.memory[1] and kept != scene.memory:
        memory = no_memory(scene, state.position.new_zeros(state.batch_shape))
        state = replace(state, memory=memory)
    state = _with_crept(state, scene)
    count = 0 if state.tendons is None else state.tendons.shape[-2]
    return state if count == len(scene.tendons) else with_tendons(state, scene)


def _with_crept(state: State, scene: Any) -> State:
    """With strains that arms have crept by: zero where the state is of a scene without them."""
    if not scene.arms:
        return state if state.inelastic is None else replace(state, inelastic=None)
    if state.inelastic is None:
        none = nothing_crept(scene, state.position.new_zeros(state.batch_shape))
        return replace(state, inelastic=none)
    if state.inelastic.shape[-1] != 6 * scene.arms:
        raise ValueError(
            f"a state of {state.inelastic.shape[-1] // 6} arms that relax was given; the scene's "
            f"Viscoelastic has {scene.arms}"
        )
    if (rows := state.inelastic.shape[-2]) != (wanted := scene.beam.station_count):
        raise ValueError(
            f"a state whose inelastic has {rows} rows was given; the beam has {wanted} stations"
        )
    return state


def _of_this_beam(state: State, beam: Any) -> State:
    of_beam, shape = RestShape.of(beam), state.rest_shape
    if shape is of_beam:
        return state
    off = None if of_beam is None or shape is None else shape.differs(of_beam)
    if off is not None:
        warn(
            "a state of another beam was given to start from, whose shape at rest differs from "
            f"this one's {off}, so that it starts strained; State.from_nodes bends this beam into "
            "a curve",
            UserWarning,
        )
    return replace(state, rest_shape=of_beam)
