"""Motors, tendons and equality constraints of MJCF.

Source: MuJoCo documentation, "Computation", "Actuation model", "Tendons", "Equality".
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..scene.ball import Ball
from ..scene.effects.tendon import Tendon
from ..scene.effects.values import Input
from ..scene.joints import Weld
from .mjcf_joints import rest_stiffness
from .mjcf_model import Model

MET = 1e-6  # m, and of axes: how far an equality may be from fulfilled at qpos0
# fmt: off
WITHOUT = (
    "tendon_damping", "tendon_frictionloss", "tendon_armature", "tendon_stiffnesspoly",
    "tendon_dampingpoly", "tendon_springyield",
)
ACTING = ("tendon_stiffness", "tendon_limited", *WITHOUT)
# fmt: on


def motors(model: Model) -> dict[tuple[str, int], str]:
    """Names of the inputs of joints and tendons: those of motors, whose force is a control, and of
    servos of joints, which have a stiffness and a damping beside it.
    """
    m, mujoco = model.m, model.mujoco
    plain = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtDyn.mjDYN_NONE)
    none, affine = mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE
    kinds = {mujoco.mjtTrn.mjTRN_JOINT: "joint", mujoco.mjtTrn.mjTRN_TENDON: "tendon"}
    coordinate = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    named: dict[tuple[str, int], str] = {}
    for i in range(m.nu):
        name = f"the actuator {model.name('actuator', i)!r}"
        kind, at = kinds.get(int(m.actuator_trntype[i])), int(m.actuator_trnid[i][0])
        types, bias = (m.actuator_gaintype[i], m.actuator_dyntype[i]), int(m.actuator_biastype[i])
        fits = tuple(map(int, types)) == plain and m.actuator_plugin[i] < 0
        fits = fits and kind is not None and (kind, at) not in named
        fits = fits and bias in ((none, affine) if kind == "joint" else (none,))
        if kind == "joint":
            fits = fits and int(m.jnt_type[at]) in coordinate
        if fits:
            named[kind, at], gear = model.name("actuator", i), m.actuator_gear[i][0]
            if bias != none:
                model.servos[at] = m.actuator_biasprm[i][:3] * (gear, gear**2, gear**2)
            limited = m.actuator_ctrllimited[i] or m.actuator_forcelimited[i]
            if limited or (m.jnt_actfrclimited if kind == "joint" else m.tendon_actfrclimited)[at]:
                model.beside.append(f"the range of the motor {named[kind, at]!r}")
        else:
            acts = bias != none or m.actuator_plugin[i] >= 0  # without a control, too
            left = model.changing if acts else model.beside
            left.append(f"{name}, which is no motor or servo, or a second one")
        model.refuse(name, i, "actuator_damping", "actuator_armature")
    return named


def tendons(model: Model) -> Iterator[Tendon]:
    """Springs, limits and motors of tendons through sites."""
    m = model.m
    for i in range(m.ntendon):
        name = f"the tendon {model.name('tendon', i)!r}"
        first = int(m.tendon_adr[i])
        path = range(first, first + int(m.tendon_num[i]))
        if any(int(m.wrap_type[k]) != model.mujoco.mjtWrap.mjWRAP_SITE for k in path):
            if not _acts(model, i):
                continue
            model.changing.append(f"{name}, which does not go through sites alone")
            continue
        sites = [int(m.wrap_objid[k]) for k in path]
        eyelets = [model.eyelet(int(m.site_bodyid[s]), model.d.site_xpos[s]) for s in sites]
        if motor := model.motors.get(("tendon", i)):
            yield Tendon(eyelets, tension=Input(motor, 1))
        if k := float(m.tendon_stiffness[i]):
            low, high = m.tendon_lengthspring[i].tolist()
            if low > 0:
                model.changing.append(f"the push of {name} below {low:g} m")
            yield Tendon(eyelets, length=high, stiffness=k)
        if m.tendon_limited[i]:
            low, high = m.tendon_range[i].tolist()
            if low > 0:
                model.changing.append(f"the lower limit of {name}")
            solver = m.tendon_solref_lim[i], m.tendon_solimp_lim[i], m.tendon_invweight0[i]
            high -= float(m.tendon_margin[i])
            yield Tendon(eyelets, length=high, stiffness=rest_stiffness(*solver))
        model.refuse(name, i, *WITHOUT)


def _acts(model: Model, i: int) -> bool:
    """Whether something acts in a tendon."""
    numbers = [getattr(model.m, x)[i] for x in ACTING if hasattr(model.m, x)]
    return ("tendon", i) in model.motors or any(map(np.any, numbers))


def equalities(model: Model) -> Iterator[Any]:
    """Connections and welds, which hold exactly."""
    m, d, kinds = model.m, model.d, model.mujoco.mjtEq
    edges = kinds.mjEQ_FLEX
    for i in range(m.neq):
        name, kind = f"the equality {model.name('equality', i)!r}", int(m.eq_type[i])
        if not m.eq_active0[i] or (kind == edges and model.rods):
            continue
        if kind not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            model.changing.append(f"{name} of another kind than connect or weld")
            continue
        ids, data = (int(m.eq_obj1id[i]), int(m.eq_obj2id[i])), m.eq_data[i]
        if int(m.eq_objtype[i]) == model.mujoco.mjtObj.mjOBJ_SITE:
            bodies = [int(m.site_bodyid[s]) for s in ids]
            points = [d.site_xpos[s] for s in ids]
            axes = [d.site_xmat[s].reshape(3, 3) for s in ids]
        else:
            bodies, anchors = list(ids), [data[:3], data[3:6]]
            axes = [d.xmat[b].reshape(3, 3) for b in bodies]
            if kind == kinds.mjEQ_WELD:  # the anchor is the second's
                anchors = anchors[::-1]
                turn = np.zeros(9)
                model.mujoco.mju_quat2Mat(turn, data[6:10])
                axes[0] = axes[0] @ turn.reshape(3, 3)
            points = [
                d.xpos[b] + d.xmat[b].reshape(3, 3) @ p
                for b, p in zip(bodies, anchors, strict=True)
            ]
        off = np.linalg.norm(points[0] - points[1])
        if kind == kinds.mjEQ_WELD:
            off = max(off, np.abs(axes[0] - axes[1]).max())
        if off > MET:
            model.changing.append(f"{name}, which is not fulfilled at qpos0")
            continue
        a, b = (model.end(body, points[0]) for body in bodies)
        turns = kind == kinds.mjEQ_CONNECT
        if a == b:  # parts of one body
            continue
        if not turns and any(
            body in rod.points_only for rod in model.rods.values() for body in bodies
        ):
            model.changing.append(f"{name} of a vertex, whose body does not turn with the rod")
        elif turns:
            yield Ball(a, b, at=points[0].copy())
        else:
            yield Weld(a, b)
