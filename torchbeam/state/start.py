"""Initial states: supported nodes have to start on their supports."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..core.warning import warn
from ..math import quaternions as quat
from ..scene.prescribed_motion import PrescribedMotion
from ..scene.supports import AXES, Support
from .state import State
from .supported_nodes import held_rotation, set_node

OFF = {torch.float64: 1e-6, torch.float32: 2e-3}  # of the beam's length, and rad
# rad, of a hinge's axis: an explicit method keeps it to its tolerance
SWUNG = {torch.float64: 1e-4, torch.float32: 2e-3}
MOVING = {torch.float64: 1e-3, torch.float32: 1e-2}  # of the largest velocity, and spin
AT = (
    "; wanted is where the beam has it, displaced and turned as its support is (torchbeam.rest, "
    "equilibrium and State.from_nodes lead there)"
)


def on_supports(state: State, scene: Any, t: Tensor) -> State:
    """`state` with supported components at time t (0-dim) exactly where beam and supports have
    them, derivatives included. A sample that has failed is put there without a check: it stands
    where it stopped.

    Raises ValueError where the state is elsewhere by more than rounding, or moves where nothing
    does.
    """
    if not scene.supports:
        return state
    prescribed_motion, beam = PrescribedMotion(scene), scene.beam
    judged = state.status == 0
    length = beam.extent.detach()
    position, rotation = state.position, state.rotation
    for support in scene.supports:
        node, (place, turn) = support.node, prescribed_motion.pose(support, t)
        holds, turns = (place.new_tensor(part) for part in (support.held[:3], support.held[3:]))
        away = (position[..., node, :] - place).detach() * holds
        off = OFF[length.dtype] * length
        _judge(away, off, judged, support, "position", "m", AT)
        swing = quat.multiply(rotation[..., node, :], quat.conjugate(turn))
        angle = 2 * torch.asin((swing[..., 1:].detach() * turns).clamp(-1, 1))
        limit = OFF if len(support.rotation) == 3 else SWUNG
        off = torch.full_like(length, limit[length.dtype])
        _judge(angle, off, judged, support, "rotation", "rad", AT)
        position = set_node(position, node, torch.where(holds > 0, place, position[..., node, :]))
        rotation = set_node(rotation, node, held_rotation(rotation[..., node, :], turn, support))
    state = replace(state, position=position, rotation=rotation)
    if not scene.has_prescribed_motion:
        _judge_velocities(state, scene, judged)
    return state


def warn_of_kink(state: State, scene: Any) -> None:
    """Warns of an initial state whose nodes stand as drawn but for those of supports: the elements
    beside a support that is elsewhere then start with all of its way.
    """
    beam, moved = scene.beam, [support for support in scene.supports if support.displaced]
    if not moved or not state.stress_count:
        return
    with no_derivatives():
        away = torch.linalg.vector_norm(state.position - beam.nodes, dim=-1)
        swing = quat.multiply(state.rotation, quat.conjugate(beam.frames))
        turn = 2 * torch.asin(torch.linalg.vector_norm(swing[..., 1:], dim=-1).clamp(max=1))
        free = [k for k in range(beam.node_count) if k not in {s.node for s in scene.supports}]
        limit = OFF[away.dtype] * beam.extent.detach()[..., None]
        drawn = ((away <= limit) & (turn <= OFF[away.dtype]))[..., free].all(-1)
        ways = (("displaced by", away > limit, away, "m"), ("turned by", turn > limit, turn, "rad"))
        for support in moved if len(free) > 0 else ():
            for words, far, way, unit in ways:
                kinked = concrete(far[..., support.node] & drawn & (state.status == 0))
                if not kinked.any() or _alone(beam, support.node):
                    continue
                most = concrete(way[..., support.node])[kinked].max().item()
                warn(
                    f"the support of node {support.node} is {words} {most:.3g} {unit}, and the "
                    "beam starts undeformed beside it: a kink and a blow. A start from "
                    "initial=torchbeam.equilibrium(scene) is wanted (relax=True of a slack rope), "
                    "or a motion of the support that begins at zero",
                    UserWarning,
                )
                return


def _alone(beam: Any, node: int) -> bool:
    """Whether a node is that of a body without joints."""
    return bool(beam.parts) and beam.part_at(node).body and not any(node in x for x in beam.joined)


def _judge_velocities(state: State, scene: Any, judged: Tensor) -> None:
    spin = quat.rotate(state.rotation, state.spin)
    motions = (("velocity", state.velocity, "m/s", 0), ("spin", spin, "rad/s", 3))
    for name, x, unit, letters in motions:
        x, wanted = x.detach(), "; its support does not move"
        limit = MOVING[x.dtype] * torch.linalg.vector_norm(x, dim=-1).amax(-1)
        for support in scene.supports:
            held = x.new_tensor(support.held[letters : letters + 3])
            _judge(x[..., support.node, :] * held, limit, judged, support, name, unit, wanted)


def _judge(
    off: Tensor, limit: Tensor, judged: Tensor, support: Support, what: str, unit: str, wanted: str
) -> None:
    """ValueError where off (..., 3) is larger than limit (...)."""
    bad = (off.abs() > limit[..., None]).any(-1) & judged
    wrong = concrete(bad)
    if not wrong.any():
        return
    off = concrete(torch.where(bad[..., None], off.abs(), 0.0))[wrong][0]
    axis = int(off.argmax())
    which = f" of sample {wrong.nonzero()[0].tolist()}" if wrong.ndim else ""
    raise ValueError(
        f"initial{which} was given with the {what} {AXES[axis]} of node {support.node}, which "
        f"is held, {off[axis].item():.3g} {unit} off{wanted}"
    )
