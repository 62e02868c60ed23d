"""MuJoCo's flex rod (a discrete elastic rod, from 4.0 on) in the common dynamic case: explicit, inextensible edges.

MuJoCo holds the first edge rigid, which is a clamp of first order. So the rod begins half an edge before the clamp: the
edge's middle, where the bending of the first free vertex ends, is where the beam is held. Each vertex carries the mass of its
part of the beam.
"""

import math

import mujoco
import numpy as np
from case import EI, GJ, MASS, clock, measure, show

EDGES, STEP, RADIUS = 14, 0.001, 0.01  # s, m; the radius gives the rod its polar inertia, stiffness follows E and G


def model() -> mujoco.MjModel:
    h = 1 / (EDGES - 0.5)
    young, shear = EI / (math.pi * RADIUS**4 / 4), GJ / (math.pi * RADIUS**4 / 2)
    made = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{STEP}" integrator="Euler" gravity="0 0 0"><flag contact="disable"/></option><worldbody>
          <flexcomp name="rod" type="grid" dim="1" count="{EDGES + 1} 1 1" spacing="{h} {h} {h}" radius="{RADIUS}"
                    mass="{MASS * h * (EDGES + 1)}" pos="{(EDGES - 1) * h / 2} 0 0">
            <elasticity young="{young}" shear="{shear}"/><contact selfcollide="none"/><pin id="0 1"/>
            <edge equality="true" solref="{2 * STEP} 1" solimp="0.999 0.999 0.001"/>
          </flexcomp></worldbody></mujoco>""")
    made.body_mass[made.body(f"rod_{EDGES}").id] /= 2
    for k in range(made.njnt):  # the motion is plane: torsion rests, and its fast waves need no smaller step
        if "twist" in made.joint(k).name:
            made.dof_armature[made.jnt_dofadr[k]] = 1.0
    mujoco.mj_setConst(made, mujoco.MjData(made))
    return made


def run() -> tuple[np.ndarray, float]:
    made = model()
    data, tip = mujoco.MjData(made), made.body(f"rod_{EDGES}").id
    mujoco.mj_forward(made, data)
    way = [data.xpos[tip].copy()]
    data.xfrc_applied[tip, 1] = 1.0
    start = clock()
    for _ in range(200):
        mujoco.mj_step(made, data, round(0.01 / STEP))
        way.append(data.xpos[tip].copy())
    return np.array(way), clock() - start


if __name__ == "__main__":
    show(measure("mujoco", "3D", EDGES, "rod", STEP, run))
