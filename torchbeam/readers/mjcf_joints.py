"""Joints of MJCF and URDF, and what acts in them.

MuJoCo's limits and dry friction are soft constraints. A displacement r and a rate v of one joint
with the inertia I, pushed by the effort I a0, obey

    a + d (b v + d k r) = (1 - d) a0,    b = 2/(d1 t),    k = 1/(d1 t z)^2

with t and z of `solref`, and the impedance d from d0 to d1 of `solimp`. At rest on a limit
I a0 = K r with K = I d1^2 k/(1 - d1). A stuck joint creeps by v = (1 - d0) a0/(d0 b).

Source: MuJoCo documentation, "Computation", "Solver parameters".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..scene.ball import Ball
from ..scene.effects.values import Input
from ..scene.joints import Hinge, Slider
from .mjcf_model import Model

NONLINEAR = "jnt_stiffnesspoly", "jnt_springyield"
IMPEDANCES = 1e-4, 0.9999  # between these MuJoCo keeps d


def joint(model: Model, j: int, parent: Any, child: Any) -> list[Any]:
    """A joint at its place; none for a free one."""
    kinds, kind = model.mujoco.mjtJoint, int(model.m.jnt_type[j])
    name, dof = f"the joint {model.name('joint', j)!r}", int(model.m.jnt_dofadr[j])
    model.refuse(name, j, *NONLINEAR)
    model.refuse(name, dof, "dof_dampingpoly")
    if kind == kinds.mjJNT_FREE:
        model.refuse(name, j, "jnt_stiffness")
        resisting = "dof_damping", "dof_armature", "dof_frictionloss"
        model.refuse(name, slice(dof, dof + 6), *resisting)
        return []
    at, axis = model.d.xanchor[j].copy(), model.d.xaxis[j].copy()
    law = _resistance(model, j, dof)
    if kind == kinds.mjJNT_BALL:
        if model.m.jnt_limited[j]:
            model.changing.append(f"limits of {name}, a ball")
        model.refuse(name, dof, "dof_armature")
        return [Ball(parent, child, at=at, **law)]
    effort, kind = ("torque", Hinge) if kind == kinds.mjJNT_HINGE else ("force", Slider)
    law |= _coordinate(model, j, effort)
    return [kind(parent, child, axis, at=at, **law)]


def _resistance(model: Model, j: int, dof: int) -> dict[str, Any]:
    """Spring, damping and friction of a joint of any kind."""
    m, law = model.m, {}
    _, by_coordinate, by_rate = model.servos.get(j, np.zeros(3))
    if stiffness := float(m.jnt_stiffness[j] - by_coordinate):
        law["stiffness"] = stiffness
    if damping := float(m.dof_damping[dof] - by_rate):
        law["damping"] = damping
    if mu := float(m.dof_frictionloss[dof]):
        d, _, _, b = _constraint(m.dof_solref[dof], m.dof_solimp[dof])
        law |= dict(friction=mu, slip_speed=mu * m.dof_invweight0[dof] * (1 - d) / (d * b))
    return law


def _coordinate(model: Model, j: int, effort: str) -> dict[str, Any]:
    """Armature, limits, motor and pull of the spring, of a coordinate that is 0 at qpos0."""
    m, q, dof = model.m, int(model.m.jnt_qposadr[j]), int(model.m.jnt_dofadr[j])
    law: dict[str, Any] = {}
    if armature := float(m.dof_armature[dof]):
        law["inertia"] = armature
    if m.jnt_limited[j]:
        inverse = m.dof_invweight0[dof]
        k = rest_stiffness(m.jnt_solref[j], m.jnt_solimp[j], inverse)
        low, high = (m.jnt_range[j] - m.qpos0[q]).tolist()
        margin = float(m.jnt_margin[j])
        law |= dict(limits=(low + margin, high - margin), limit_stiffness=k)
    constant, by_coordinate, _ = model.servos.get(j, np.zeros(3))
    pull = m.jnt_stiffness[j] * (m.qpos_spring[q] - m.qpos0[q])
    if pull := float(pull + constant + by_coordinate * m.qpos0[q]):
        law[effort] = pull
    if motor := model.motors.get(("joint", j)):
        if effort in law:
            name = model.name("joint", j)
            model.changing.append(f"a motor beside the stretched spring of the joint {name!r}")
        law[effort] = Input(motor, 1)
    return law


def _constraint(solref: np.ndarray, solimp: np.ndarray) -> tuple[float, float, float, float]:
    """d0, d1, k 1/s^2 and b 1/s; negative numbers are k and b, times d1^2 and d1."""
    least, largest = np.clip(solimp[:2], *IMPEDANCES).tolist()
    if solref[0] <= 0:
        return least, largest, -solref[0] / largest**2, -solref[1] / largest
    k, b = 1 / (largest * solref[0] * solref[1]) ** 2, 2 / (largest * solref[0])
    return least, largest, k, b


def rest_stiffness(solref: np.ndarray, solimp: np.ndarray, inverse: float) -> float:
    """K of a limit, of the inverse inertia 1/I."""
    _, d, k, _ = _constraint(solref, solimp)
    return float(d * d * k / ((1 - d) * inverse))
