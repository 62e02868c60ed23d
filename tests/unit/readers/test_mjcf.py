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


def rod(edges: int, pin: str = "0 1", more: str = "", gravity: str = "0 0 -9.81") -> str:
    """A rod of 1 m along x of EI = 0.785 N m^2 and 0.6 kg/m, of MuJoCo's flexes; mass is equal in
    all vertices.
    """
    h = 1 / edges
    step = 2e-4
    option = f'<option timestep="{step}" integrator="Euler" gravity="{gravity}"><flag contact="disable"/></option>'
    return model(
        f'<flexcomp name="rod" type="grid" dim="1" count="{edges + 1} 1 1" spacing="{h} {h} {h}" '
        f'radius="0.01" mass="{0.6 * (1 + h)}" pos="0.5 0 0">'
        '<elasticity young="1e8" shear="4e7" damping="0.002"/><contact selfcollide="none"/>'
        f'<pin id="{pin}"/><edge equality="true" solref="{2 * step} 1" solimp="0.9999 0.9999 0.001"/>'
        f"</flexcomp>{more}",
        option=option,
    )


def vertices_motion(text: str, t: torch.Tensor, body: str, start=None) -> np.ndarray:
    """Places of a body (time, 1, 3)."""
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    if start is not None:
        start(m, d)
    places = []
    for k in range(len(t)):
        if k:
            mujoco.mj_step(m, d, round((t[1] - t[0]).item() / m.opt.timestep))
        mujoco.mj_kinematics(m, d)
        places.append(d.body(body).xpos.copy())
    return np.array(places)[:, None]


def test_a_clamped_rod_falls_as_in_mujoco(tmp_path):
    """The difference falls with the square of the number of edges: 2.3 % of the displacement with
    six, 0.53 % with twelve, where MuJoCo's steps of 0.2 ms leave 0.02 %.
    """
    t, off = torch.linspace(0, 0.5, 11), []
    for n in (6, 12):
        solution = tb.simulate(read(rod(n), tmp_path), t, step=5e-3)
        ours = solution["rod"].tip.position[:, None].numpy()
        off.append(differences(ours, vertices_motion(rod(n), t, f"rod_{n}")).item())
    print(off)
    assert off[1] < 0.006 and 3.5 < off[0] / off[1] < 5


def test_a_rod_vibrates_as_in_mujoco(tmp_path):
    """First frequency without gravity, from half periods in MuJoCo."""
    n, text = 12, rod(12, gravity="0 0 0")
    def pluck(m, d):
        for k in range(2, n + 1):
            d.qvel[m.body_dofadr[m.body(f"rod_{k}").id] + 2] = 0.02 * (k / n) ** 2

    t = torch.linspace(0, 4, 1001)
    z = vertices_motion(text, t, f"rod_{n}", pluck)[:, 0, 2]
    z = z[1:]
    k = np.flatnonzero(z[:-1] * z[1:] < 0)
    crossing = (k - z[k] / (z[k + 1] - z[k])) * 4e-3
    measured = np.pi * (len(k) - 1) / (crossing[-1] - crossing[0])
    frequency = tb.modes(read(text, tmp_path), count=1).frequency.item()
    print(measured, frequency, frequency/measured-1, len(k))
    assert abs(frequency / measured - 1) < 0.005


def test_a_rod_carries_a_weight_as_in_mujoco(tmp_path):
    """A ball of 0.2 kg that a `connect` holds below the end of a rod, which hangs on a pin."""
    n = 12
    more = (
        '<body name="weight" pos="1 0 -0.05"><freejoint/><geom size="0.03" mass="0.2"/>'
        '<site name="tip"/></body>'
    )
    tie = (
        f'<equality><connect body1="rod_{n}" body2="weight" anchor="0 0 0" solref="4e-4 1" '
        'solimp="0.9999 0.9999 0.001"/></equality>'
    )
    text = rod(n, pin="0", more=more).replace("</mujoco>", tie + "</mujoco>")
    t = torch.linspace(0, 0.5, 11)
    solution = tb.simulate(read(text, tmp_path), t, step=5e-3)
    off = differences(sites_of(solution, text, ["tip"]), mujoco_motion(text, t, ["tip"]))
    print(off)
    assert off.max() < 0.01
