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


def bar(joints: str, inside: str, pos: str = "0 0 0", name: str = "first", size: float = 0.4) -> str:
    link = LINK.format(size)
    return f'<body name="{name}" pos="{pos}">{joints}{link}{inside}</body>'


def hinge(axis: str = "0 1 0", more: str = "") -> str:
    return f'<joint type="hinge" axis="{axis}" {more}/>'


def model(world: str, more: str = "", option: str = OPTION) -> str:
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{world}</worldbody>{more}</mujoco>'


TIP = '<site name="tip" pos="0.4 0 0"/>'
SECOND = "0.4 0 0", "second"
# mechanisms, by a motion each of a kind; their places are apart, their names have a prefix
MECHANISMS = {
    "double pendulum": bar(hinge(), bar(hinge(), TIP, *SECOND)),
    "turned hinges": bar(hinge("0 1 0.3"), bar(hinge("1 0 2"), TIP, *SECOND)),
    "spring": bar(hinge(more='stiffness="2" damping="0.1" springref="0.5" ref="0.2"'), TIP),
    "three hinges": bar(
        hinge("0 1 0", 'damping="0.02"')
        + hinge("1 0 0", 'stiffness="3"')
        + hinge("0 0 1", 'stiffness="1" springref="1"'),
        '<geom type="box" pos="0.2 0 0" size=".2 .15 .1" density="200"/>' + TIP,
    ),
    "ball": bar('<joint type="ball" damping="0.01"/>', bar(hinge("0 1 1"), TIP, *SECOND)),
    "cart": '<body name="cart"><joint type="slide" axis="1 0 0" stiffness="20" damping="0.5"/>'
    '<inertial pos="0 0 0" mass="0.7" diaginertia="1 1 1"/>' + bar(hinge(), TIP) + "</body>",
    "free": bar("<freejoint/>", bar(hinge("0 0 1", 'stiffness="1" springref="1"'), TIP, *SECOND)),
    "welded parts": bar(
        hinge(), '<body pos="0.2 0 0" euler="0.3 0.2 0.1"><geom type="box" size=".05 .1 .02"/></body>' + TIP
    ),
    "rotor": bar(hinge(more='armature="0.05"'), TIP),
}


def side_by_side(mechanisms: dict[str, str]) -> str:
    """All of them in one model, whose names begin with their numbers."""
    world = ""
    for k, text in enumerate(mechanisms.values()):
        named = text.replace('name="', f'name="{k} ')
        world += f'<frame pos="0 {k} 0">{named}</frame>'
    return model(world)


def mujoco_motion(text: str, t: torch.Tensor, sites: list[str], finer: int = 1) -> np.ndarray:
    """Places of sites (time, site, 3)."""
    m = mujoco.MjModel.from_xml_string(text)
    m.opt.timestep /= finer
    d = mujoco.MjData(m)
    steps = round((t[1] - t[0]).item() / m.opt.timestep)
    mujoco.mj_forward(m, d)
    places = []
    for k in range(len(t)):
        mujoco.mj_step(m, d, steps if k else 0)
        mujoco.mj_kinematics(m, d)
        places.append([d.site(name).xpos.copy() for name in sites])
    return np.array(places)


def sites_of(solution: tb.Solution, text: str, sites: list[str]) -> np.ndarray:
    """The same of a solution, of points of bodies."""
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    places = []
    for name in sites:
        part = solution[m.body(int(m.site(name).bodyid[0])).name]
        arm = part.rotation[0].mT @ (torch.as_tensor(d.site(name).xpos) - part.position[0])
        places.append(part.position + part.rotation @ arm)
    return torch.stack(places, 1).numpy()


def read(text: str, folder: Path, **options):
    path = folder / "model.xml"
    path.write_text(text)
    return tb.read(path, **options)


def differences(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """RMS of how far each site is off, over that of its displacement."""
    motion = np.square(theirs - theirs[0]).sum(-1).mean(0)
    assert (motion > 1e-3).all()
    return np.sqrt(np.square(ours - theirs).sum(-1).mean(0) / motion)


def test_mechanisms_move_as_in_mujoco(tmp_path):
    """Within 2e-4 of the displacement: of second order in the step of 4 ms."""
    text = side_by_side(MECHANISMS)
    sites = [f"{k} tip" for k in range(len(MECHANISMS))]
    t = torch.linspace(0, 0.4, 11)
    solution = tb.simulate(read(text, tmp_path), t, step=4e-3)
    off = differences(sites_of(solution, text, sites), mujoco_motion(text, t, sites))
    print(dict(zip(MECHANISMS, off.tolist(), strict=True)))
    assert (off < 2e-4).all()
