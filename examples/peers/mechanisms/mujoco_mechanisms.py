"""MuJoCo in the two mechanisms, its beams chains of rigid links: inextensible, in joints with springs
and dampers. Explicit steps.

Links are joined by hinges in the plane and by three hinges each in space, of the stiffness EI over a
link's length; bending of the half links at a clamp or a knuckle is in the joint there, so that the
chain converges with second order. The tree holds exactly; the linkage's last pin is a `connect`.
"""

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np
from case import (
    DAMPING,
    DURATION,
    EI,
    EVERY,
    FINGERS,
    GRAVITY,
    INERTIA,
    KNUCKLE,
    MASS,
    PALM,
    PINS,
    clock,
    finger,
    measured,
    show,
)

LINKAGE = (4, 2e-3), (3, 2e-3), (4, 1e-3), (6, 5e-4), (8, 2.5e-4), (12, 1.25e-4)  # links, s
FOURTH_ORDER = (3, 2e-3), (4, 2e-3)  # finer ones are unstable with damping
HAND = (3, 1e-3), (2, 2e-3), (4, 5e-4), (6, 2e-4), (8, 1e-4), (12, 5e-5)


def hinge(axis: str, stiffness: float = 0.0, damping: float = 0.0) -> str:
    return f'<joint type="hinge" axis="{axis}" stiffness="{stiffness}" damping="{damping}"/>'


def link(name: str, length: float, place: str, joints: str, inside: str = "") -> str:
    """A rod along its own x."""
    across = MASS * length**3 / 12 + INERTIA * length
    own = f"{2 * INERTIA * length} {across} {across}"
    return (
        f'<body name="{name}" pos="{place}">{joints}'
        f'<inertial pos="{length / 2} 0 0" mass="{MASS * length}" diaginertia="{own}"/>{inside}</body>'
    )


def springs(axes: Sequence[str], stiffness: float, damping: float = 0.0) -> str:
    """Of the bending between the middles of two links, EI/h, of which half is at a clamp; damping
    s.
    """
    return "".join(hinge(axis, stiffness, damping * stiffness) for axis in axes)


def turned(name: str, place: np.ndarray, x: np.ndarray, z: np.ndarray, inside: str) -> str:
    """A frame without mass of its own, of given axes."""
    axes = " ".join(f"{v}" for v in (*x, *np.cross(z, x)))
    return f'<frame pos="{place[0]} {place[1]} {place[2]}" xyaxes="{axes}">{inside}</frame>'


def linkage(links: int, step: float, integrator: str = "implicitfast") -> tuple[np.ndarray, float]:
    """Pins of the first and second bar: that of the third hangs on the second's."""
    free, up, whole = hinge("0 0 1"), np.array([0.0, 0.0, 1.0]), ""
    lengths = np.linalg.norm(np.diff(PINS, axis=0), axis=-1)
    angles = [np.arctan2(*(b - a)[1::-1]) for a, b in pairwise(PINS)]
    for bar in (2, 1, 0):
        h = lengths[bar] / links
        inside = (
            whole
            and f'<frame pos="{h} 0 0" euler="0 0 {angles[bar + 1] - angles[bar]}">{whole}</frame>'
        )
        for k in reversed(range(links)):
            joint = free if k == 0 else springs(["0 0 1"], EI / h, DAMPING)
            if k == links - 1:
                inside += f'<site name="pin{bar}" pos="{h} 0 0"/>'
            inside = link(f"{bar}_{k}", h, f"{h if k else 0} 0 0", joint, inside)
        whole = inside
    root = turned("root", PINS[0], (PINS[1] - PINS[0]) / lengths[0], up, whole)
    last = " ".join(f"{x}" for x in (lengths[2] / links, 0, 0))
    close = (
        f'<equality><connect body1="2_{links - 1}" body2="world" anchor="{last}" '
        f'solref="{2 * step} 1" solimp="0.999 0.999 0.001"/></equality>'
    )
    return motion(root, (0, -GRAVITY, 0), close, ("pin0", "pin1"), step, integrator)


def hand(links: int, step: float) -> tuple[np.ndarray, float]:
    """Tips of the fingers."""
    h, fingers = FINGERS["phalanx"] / links, ""
    axes = "0 0 1", "0 1 0"
    for k in range(FINGERS["count"]):
        places, along, axis = finger(k)
        inside = ""
        for j in reversed(range(2 * links)):
            stiffness = (2 if j == 0 else 1) * EI / h
            bending = knuckle(axes, h) if j == links else springs(axes, stiffness)
            # fast waves of torsion, which matter little, need no smaller step if they are damped
            joints = bending + springs(["1 0 0"], stiffness, DAMPING)
            if j == 2 * links - 1:
                inside = f'<site name="tip{k}" pos="{h} 0 0"/>'
            inside = link(f"{k}_{j}", h, f"{h if j else 0} 0 0", joints, inside)
        fingers += turned(f"finger{k}", places[0], along, axis, inside)
    own = PALM["inertia"]
    palm = (
        f'<body name="palm">{hinge("0 1 0")}'
        f'<inertial pos="0 0 0" mass="{PALM["mass"]}" diaginertia="{own} {own} {own}"/>{fingers}</body>'
    )
    tips = [f"tip{k}" for k in range(FINGERS["count"])]
    return motion(palm, (0, 0, -GRAVITY), "", tips, step, torque=PALM["torque"])


def knuckle(axes: Sequence[str], h: float) -> str:
    """Two half links, and about z the knuckle's own spring in series: its damper is that of the
    knuckle, which is far weaker.
    """
    own = 1 / (1 / KNUCKLE["stiffness"] + h / EI)
    return springs(axes[1:], EI / h) + hinge(axes[0], own, KNUCKLE["damping"])


def motion(
    world: str,
    gravity: tuple[float, float, float],
    more: str,
    sites: Sequence[str],
    step: float,
    integrator: str = "implicitfast",
    torque: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Positions (time, site, 3) m at all instants; CPU seconds. torque: about y, on the palm."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{integrator}" '
        f'gravity="{gravity[0]} {gravity[1]} {gravity[2]}"/>'
        f"<worldbody>{world}</worldbody>{more}</mujoco>"
    )
    data, rows = mujoco.MjData(model), [model.site(name).id for name in sites]
    if torque:
        data.xfrc_applied[model.body("palm").id, 4] = torque
    mujoco.mj_forward(model, data)
    found = [data.site_xpos[rows]]
    start = clock()
    for _ in range(round(DURATION / EVERY)):
        mujoco.mj_step(model, data, round(EVERY / step))
        mujoco.mj_kinematics(model, data)  # places as they are after the step
        found.append(data.site_xpos[rows])
    return np.stack(found), clock() - start


def fourth_order(links: int, step: float) -> tuple[np.ndarray, float]:
    return linkage(links, step, "RK4")


if __name__ == "__main__":
    show(measured("mujoco", "links", {"four-bar": (linkage, LINKAGE), "hand": (hand, HAND)}))
    show(measured("mujoco", "links, RK4", {"four-bar": (fourth_order, FOURTH_ORDER)}))
