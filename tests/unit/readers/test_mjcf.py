"""MJCF and URDF against MuJoCo itself: the motion of what `tb.read` makes of a model is that of the
model in MuJoCo, with its fourth-order Runge-Kutta method where nothing stands against it.
"""

from pathlib import Path

import numpy as np
import pytest
import torch

import torchbeam as tb

mujoco = pytest.importorskip("mujoco")

OPTION = '<option timestep="5e-4" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>'
LINK = '<geom type="capsule" fromto="0 0 0 {} 0 0" size="0.02" density="1000"/>'
LAST = '<site name="tip" pos="{} 0 0"/>'


def bar(joints: str, inside: str, pos: str = "0 0 0", name: str = "", size: float = 0.4) -> str:
    link = LINK.format(size)
    return f'<body name="{name}" pos="{pos}">{joints}{link}{inside}</body>'


def hinge(axis: str = "0 1 0", more: str = "") -> str:
    return f'<joint type="hinge" axis="{axis}" {more}/>'


def model(world: str, more: str = "", option: str = OPTION) -> str:
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{world}</worldbody>{more}</mujoco>'


TIP = LAST.format(0.4)
SECOND = bar(hinge("0 1 0"), TIP, "0.4 0 0", "second")
# name: model, how far both motions may be apart, of the RMS displacement
MODELS = {
    "double pendulum": model(bar(hinge(), SECOND, name="first")),
    "turned hinges": model(
        bar(hinge("0 1 0.3"), bar(hinge("1 0 2"), TIP, "0.4 0 0", "second"), name="first")
    ),
    "spring, damper, ref": model(
        bar(hinge(more='stiffness="2" damping="0.1" springref="0.5" ref="0.2"'), TIP, name="first")
    ),
    "three hinges": model(
        bar(hinge("1 0 0", 'damping="0.02"') + hinge("0 1 0") + hinge("0 0 1"), TIP, name="arm")
    ),
    "ball": model(bar('<joint type="ball" damping="0.01"/>', bar(hinge("0 1 1"), TIP, "0.4 0 0", "b"), name="a")),
    "cart": model(
        '<body name="cart"><joint type="slide" axis="1 0 0" stiffness="20" damping="0.5"/>'
        '<inertial pos="0 0 0" mass="0.7" diaginertia="1 1 1"/>' + bar(hinge(), TIP, name="pole") + "</body>"
    ),
    "free": model(bar("<freejoint/>", bar(hinge("0 0 1", 'stiffness="1" springref="1"'), TIP, "0.4 0 0", "b"), "0 0 1", "a")),
    "welded parts": model(
        bar(hinge(), '<body pos="0.2 0 0" euler="0.3 0.2 0.1"><geom type="box" size=".05 .1 .02"/></body>' + TIP, name="a")
    ),
    "armature to the ground": model(bar(hinge(more='armature="0.05"'), TIP, name="first")),
}


def mujoco_motion(text: str, t: torch.Tensor, finer: int = 1, start=None) -> np.ndarray:
    """Places of the site `tip`."""
    m = mujoco.MjModel.from_xml_string(text)
    m.opt.timestep /= finer
    d = mujoco.MjData(m)
    if start is not None:
        start(m, d)
    steps = round((t[1] - t[0]).item() / m.opt.timestep)
    mujoco.mj_forward(m, d)
    places = [d.site("tip").xpos.copy()]
    for _ in t[1:]:
        mujoco.mj_step(m, d, steps)
        mujoco.mj_kinematics(m, d)
        places.append(d.site("tip").xpos.copy())
    return np.array(places)


def tip_of(solution: tb.Solution, text: str) -> np.ndarray:
    """The same of a solution: a point of the body or the rod that has the site."""
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    body = m.body(int(m.site("tip").bodyid[0])).name
    part = solution[body]
    arm = torch.as_tensor(d.site("tip").xpos) - part.position[0]
    R0 = part.rotation[0]
    return (part.position + (part.rotation @ (R0.mT @ arm)[..., None])[..., 0]).numpy()


def read(text: str, folder: Path, **options):
    path = folder / "model.xml"
    path.write_text(text)
    return tb.read(path, **options)


@pytest.mark.parametrize("name", MODELS)
def test_rigid_mechanisms_move_as_in_mujoco(name, tmp_path):
    text = MODELS[name]
    scene = read(text, tmp_path)
    t = torch.linspace(0, 0.6, 13)
    ours = tip_of(tb.simulate(scene, t, step=2e-3), text)
    theirs = mujoco_motion(text, t)
    motion = np.sqrt(np.square(theirs - theirs[0]).sum(-1).mean())
    off = np.sqrt(np.square(ours - theirs).sum(-1).mean()) / motion
    print(name, off, motion)
    assert motion > 0.03
    assert off < 1e-3
