"""The torque-driven arm of Elastica-RL-control in MuJoCo, under the actions of `case`.

A chain of rigid links, an element each, with ball joints of the stiffness EI/h: it neither shears
nor stretches, and twists as it bends. The first link is held, as PyElastica holds the first axes.
Steps are those that are published, seven to an interval. Couples and drag act on links.
"""

import math

import mujoco
import numpy as np
from case import ARM, actions, clock, measured, show
from scipy.interpolate import make_interp_spline

COUNT = ARM["elements"]
H = ARM["length"] / COUNT
STIFFNESS = ARM["young"] * math.pi * ARM["radius"] ** 4 / 4 / H  # N m/rad
TWIST = STIFFNESS * 2 / 1.5  # GJ/h
FRAME = 'xyaxes="0 0 1 1 0 0"'  # of the first link: normal, binormal, tangent, which is +y


def model():
    """An `MjModel`; bodies from 1 on are the links."""
    size = f'size="{ARM["radius"]} {H / 2}" density="{ARM["density"]}"'
    link = f'<geom type="cylinder" pos="0 0 {H / 2}" {size}/>'
    inner = "".join(
        f'<body pos="0 0 {H}"><joint type="ball" stiffness="{STIFFNESS}"/>{link}'
        for _ in range(COUNT - 1)
    )
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco><compiler angle="radian"/>
        <option timestep="{ARM["interval"] / ARM["substeps"]}" gravity="0 0 0">
          <flag contact="disable"/></option>
        <worldbody><body {FRAME}>{link}{inner}{"</body>" * COUNT}</worldbody></mujoco>""")


MODEL = model()


def run(kind, seed):
    """Tip (interval, 3) m, at the end of each."""
    data, tip = mujoco.MjData(MODEL), []
    knots, ends = np.array([0.0, *ARM["points"], 1.0]), H * np.arange(1, COUNT + 1)
    axes, outer = data.xmat[1:].reshape(-1, 3, 3), data.xfrc_applied[1:]
    twist, middle, about = data.cvel[1:], data.xipos[1:], data.subtree_com[1:2]
    turn, inner = data.qpos.reshape(-1, 4), data.qfrc_applied.reshape(-1, 3)
    c, couple = ARM["viscous"] * H, np.zeros((COUNT, 3))
    start = clock()
    for action in actions(kind, seed):
        values = np.pad(action.reshape(2, -1), ((0, 0), (1, 1)))
        couple[:, :2] = ARM["torque"] * make_interp_spline(knots, values, k=3, axis=1)(ends).T
        for _ in range(ARM["substeps"]):
            mujoco.mj_step1(MODEL, data)
            spin = twist[:, :3]  # spins, then velocities of what lies at the arm's centre of mass
            outer[:, :3] = -c * (twist[:, 3:] + np.cross(spin, middle - about))
            outer[:, 3:] = (axes @ couple[:, :, None])[:, :, 0] - c * spin
            w, half = turn[:, 0], np.linalg.norm(turn[:, 1:], axis=1)
            about_tangent = 2 * turn[:, 3] * np.arctan2(half, w) / np.maximum(half, 1e-12)
            inner[:, 2] = (STIFFNESS - TWIST) * about_tangent
            mujoco.mj_step2(MODEL, data)
        mujoco.mj_kinematics(MODEL, data)
        tip.append(data.xpos[-1] + H * data.xmat[-1].reshape(3, 3)[:, 2])
    return np.array(tip), clock() - start


if __name__ == "__main__":
    show(measured("mujoco", run))
