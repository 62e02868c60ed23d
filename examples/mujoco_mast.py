"""A trolley with an elastic mast, from a MuJoCo file: the force that moves it by a metre and leaves
the mast at rest, found by derivatives through the motion, then tried in MuJoCo.

`tb.read(part="arguments")` gives the parts, effects and joints of the scene. The rod becomes a beam
with the stretch that MuJoCo leaves out, so that derivatives run natively. Two Newton steps with
`tb.rollout_jacobian` find the least force that fulfils six conditions at the end. The check is by
how much the mast's top swings in MuJoCo afterwards, over the swing after a plain push and brake.
Run as a script, it also draws both motions.
"""

import argparse
import math
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/mujoco_mast.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

EDGES, HEIGHT, RADIUS, YOUNG = 12, 2.0, 0.01, 70e9  # -, m, m, N/m^2
DURATION, AFTER, DT, HOLD = 1.5, 1.0, 0.01, 5  # s, s, s, steps of one value of the force
h = HEIGHT / EDGES
MODEL = f"""<mujoco>
  <option timestep="5e-4" integrator="discrete"><flag contact="disable"/></option>
  <worldbody>
    <body name="trolley">
      <joint name="rail" type="slide" axis="1 0 0" damping="2"/>
      <geom type="box" size="0.2 0.1 0.05" mass="5"/>
      <flexcomp name="mast" type="grid" dim="1" count="{EDGES + 1} 1 1" spacing="{h} {h} {h}"
                radius="{RADIUS}" mass="1.7" pos="0 0 {HEIGHT / 2}" euler="0 -90 0">
        <elasticity young="{YOUNG}" shear="27e9" damping="2e-4"/><pin id="0 1"/>
        <contact selfcollide="none"/><edge equality="true" solref="1e-3 1"/>
      </flexcomp>
    </body>
    <body name="load" pos="0 0 {HEIGHT}"><freejoint/><geom size="0.08" mass="1"/></body>
  </worldbody>
  <equality><connect body1="mast_{EDGES}" body2="load" anchor="0 0 0" solref="1e-3 1"/></equality>
  <actuator><motor name="force" joint="rail"/></actuator>
</mujoco>"""


def read(path: Path) -> tb.Scene:
    """The model as a scene, with a mast that stretches."""
    given = tb.read(path, part="arguments")
    rod, area = given["beam"]["mast"], math.pi * RADIUS**2
    mass, compliance = rod.mass[0].diagonal(), rod.compliance[0].diagonal()
    section = tb.Section.from_stiffness(
        EA=YOUNG * area, GA=0.9 * 27e9 * area, GJ=1 / compliance[3], EI=1 / compliance[4],
        mass=mass[0], inertia=mass[4],
    )  # fmt: skip
    given["beam"]["mast"] = tb.Beam.from_nodes(rod.nodes, section)
    return tb.Scene(**given)


def at_rest(states: tb.State) -> torch.Tensor:
    """What is to be 0 at the end: places and velocities along x of trolley, middle and top."""
    mast, trolley = states["mast"], states["trolley"]
    places = (trolley.position[..., 0], mast.nodes[..., EDGES // 2, 0], mast.tip.position[..., 0])
    rates = (trolley.velocity[..., 0], mast.velocity[..., EDGES // 2, 0], mast.tip.velocity[..., 0])
    return torch.stack((*(x - 1 for x in places), *rates), -1)


with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "mast.xml"
    file.write_text(MODEL)
    scene = read(file)

stepper, steps = tb.Stepper(scene, DT), round(DURATION / DT)
push = torch.where(torch.arange(steps // HOLD) < steps // HOLD / 2, 1.0, -1.0)
push = (push * 7.7 / (DURATION / 2) ** 2)[:, None].double()  # N: 7.7 kg by a metre
shaped = push.clone()
for _ in range(3):
    shaped.requires_grad_()
    force = tb.PerInterval(shaped.repeat_interleave(HOLD, 0))
    missed, slopes = tb.rollout_jacobian(
        stepper, stepper.rest(), steps, {"force": force}, at_rest, shaped, every=steps
    )
    by = slopes[0, :, :, 0]
    shaped = shaped.detach() - (torch.linalg.pinv(by) @ missed[0])[:, None]


def in_mujoco(force: torch.Tensor) -> np.ndarray:
    """Places of trolley and top along x (time, 2) m, 5 ms apart, with no force at the end."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    places = []
    for k in range(round((DURATION + AFTER) / 0.005)):
        value = int(k * 0.005 / (DT * HOLD))
        data.ctrl[0] = force[value].item() if value < len(force) else 0.0
        mujoco.mj_step(model, data, 10)
        mujoco.mj_kinematics(model, data)
        places.append([data.body("trolley").xpos[0], data.body("load").xpos[0]])
    return np.array(places)


plain, still = in_mujoco(push), in_mujoco(shaped)
swings = [np.ptp((x[:, 1] - x[:, 0])[round(DURATION / 0.005) :]) for x in (plain, still)]
CHECK, EXPECTED, TOLERANCE = swings[1] / swings[0], 0.0, 0.1


def draw(path: Path) -> None:
    t = 0.005 * (1 + np.arange(len(plain)))
    above, below = tb.plot.grid(2, 1, (7, 5))
    for x, look, label in ((plain, "C1", "push and brake"), (still, "C0", "shaped")):
        above.plot(t, 1e3 * (x[:, 1] - x[:, 0]), look, label=label)
    above.axvline(DURATION, color="0.7")
    above.set_ylabel("top against trolley, mm")
    above.legend()
    held = np.arange(len(push) + 1) * DT * HOLD
    below.stairs(push[:, 0], held, color="C1")
    below.stairs(shaped[:, 0], held, color="C0")
    below.set_ylabel("force, N")
    below.set_xlabel("s")
    tb.plot.save(above, path, dpi=120)


if __name__ == "__main__":
    print(scene)
    print(f"swing in MuJoCo after the move: {1e3 * swings[0]:.1f} mm pushed, "
          f"{1e3 * swings[1]:.2f} mm shaped; trolley at {still[-1, 0]:.4f} m")  # fmt: skip
    draw(options.picture)
    print(f"picture: {options.picture}")
