"""MuJoCo's flex rod (a discrete elastic rod, from 4.0 on) in the common dynamic case, inextensible
edges: by explicit steps, and by the implicit ones of its integrator `discrete`, which takes bending
and twist at the end of the step. With --beside also a batch by `mujoco.batch`, on one thread.

MuJoCo holds the first edge rigid, which is a clamp of first order. So the rod begins half an edge
before the clamp: the edge's middle, where the bending of the first free vertex ends, is where the
beam is held. Each vertex carries the mass of its part of the beam.
"""

import math
from itertools import chain

import mujoco
import numpy as np
from case import EI, GJ, MASS, clock, measure, show

BATCH = 64
SETTINGS = ((14, 1e-3), (8, 2e-3), (20, 5e-4), (28, 2.5e-4), (40, 1.25e-4))  # edges, step s
# stable in any step, of first order
IMPLICIT = ((8, 1e-2), (8, 2e-3), (14, 1e-3), (14, 2.5e-4), (20, 1.25e-4))
RADIUS = 0.01  # m: it gives the rod its polar inertia, stiffness follows E and G


def model(edges: int, step: float, integrator: str = "Euler") -> mujoco.MjModel:
    h = 1 / (edges - 0.5)
    young, shear = EI / (math.pi * RADIUS**4 / 4), GJ / (math.pi * RADIUS**4 / 2)
    made = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"><flag contact="disable"/></option><worldbody>
          <flexcomp name="rod" type="grid" dim="1" count="{edges + 1} 1 1" spacing="{h} {h} {h}" radius="{RADIUS}"
                    mass="{MASS * h * (edges + 1)}" pos="{(edges - 1) * h / 2} 0 0">
            <elasticity young="{young}" shear="{shear}"/><contact selfcollide="none"/><pin id="0 1"/>
            <edge equality="true" solref="{2 * step} 1" solimp="0.999 0.999 0.001"/>
          </flexcomp></worldbody></mujoco>""")
    made.body_mass[made.body(f"rod_{edges}").id] /= 2
    mujoco.mj_setConst(made, mujoco.MjData(made))
    return made


def run(edges: int, step: float, integrator: str = "Euler") -> tuple[np.ndarray, float]:
    made = model(edges, step, integrator)
    data, tip = mujoco.MjData(made), made.body(f"rod_{edges}").id
    mujoco.mj_forward(made, data)
    way = [data.xpos[tip].copy()]
    data.xfrc_applied[tip, 1] = 1.0
    start = clock()
    for _ in range(200):
        mujoco.mj_step(made, data, round(0.01 / step))
        way.append(data.xpos[tip].copy())
    return np.array(way), clock() - start


def run_implicit(edges: int, step: float) -> tuple[np.ndarray, float]:
    return run(edges, step, "discrete")


def run_batch(edges: int, step: float) -> tuple[np.ndarray, float]:
    """Of the last of `BATCH` rods."""
    from mujoco.batch import Batch

    made = model(edges, step)
    rods, tip = Batch(made, BATCH, nthread=1), made.body(f"rod_{edges}").id
    rods.xfrc_applied[:, tip, 1] = 1.0
    position = rods.bind("xpos")
    rods.forward()
    way = [position[-1, tip].copy()]
    start = clock()
    for _ in range(200):
        rods.step(nstep=round(0.01 / step))
        way.append(position[-1, tip].copy())
    return np.array(way), clock() - start


if __name__ == "__main__":
    show(
        chain(
            measure("mujoco", "3D", "rod", SETTINGS, run),
            measure("mujoco", "3D", "rod, implicit", IMPLICIT, run_implicit),
            measure("mujoco", "3D", "rod", SETTINGS[:3], run_batch, BATCH),
        )
    )
