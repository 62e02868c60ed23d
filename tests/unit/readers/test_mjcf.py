"""MJCF and URDF against MuJoCo itself: the motion of what `tb.read` makes of a model is that of the
model in MuJoCo, with its fourth-order Runge-Kutta method where nothing stands against it.
"""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchbeam as tb

mujoco = pytest.importorskip("mujoco")

RIGID_ALONE = '<flag contact="disable"/>'
OPTION = f'<option timestep="5e-4" integrator="RK4">{RIGID_ALONE}</option>'
FOUR = int(mujoco.__version__.split(".")[0]) > 3
rods = pytest.mark.skipif(not FOUR, reason="flexes of one dimension are rods from 4 on")
LINK = '<geom type="capsule" fromto="0 0 0 {} 0 0" size="0.02" density="1000"/>'


def bar(
    joints: str, inside: str, pos: str = "0 0 0", name: str = "first", size: float = 0.4
) -> str:
    link = LINK.format(size)
    return f'<body name="{name}" pos="{pos}">{joints}{link}{inside}</body>'


def hinge(axis: str = "0 1 0", more: str = "") -> str:
    return f'<joint type="hinge" axis="{axis}" {more}/>'


def model(world: str, more: str = "", option: str = OPTION) -> str:
    return (
        f'<mujoco><compiler angle="radian"/>{option}<worldbody>{world}</worldbody>{more}</mujoco>'
    )


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
        hinge(),
        '<body pos="0.2 0 0" euler="0.3 0.2 0.1"><geom type="box" size=".05 .1 .02"/></body>' + TIP,
    ),
    "servo": bar(hinge(more='name="j" stiffness="0.5" damping="0.05"'), TIP),
    "rotor": bar(hinge(more='armature="0.05"'), TIP),
    "geared arm": bar(
        hinge(more='armature="0.05"') + hinge("1 0 2", 'armature="0.02"'),
        bar('<joint type="slide" axis="1 0 1" armature="0.3"/>' + hinge(), TIP, *SECOND),
    ),
    "slipping": bar(hinge(more='frictionloss="0.15" damping="0.3"'), TIP),
    "pulled": bar(hinge(more='damping="0.05"'), TIP + '<site name="end" pos="0.3 0 0"/>')
    + '<site name="wall" pos="0.1 0 0.4"/>',
    "weld": bar(hinge(), TIP) + bar("<freejoint/>", "", "0.5 0 0", "other"),
    "stuck": bar(hinge(more='frictionloss="2"'), TIP),
}
STEP = 2e-4
STIFF = f'solref="{2 * STEP} 1" solimp="0.9999 0.9999 0.001"'
TIES = f"""<tendon><spatial stiffness="60" springlength="0 0.35"><site site="pulled wall"/>
  <site site="pulled end"/></spatial></tendon>
  <equality><weld body1="weld first" body2="weld other" {STIFF}/></equality>
  <actuator><position name="drive" joint="servo j" kp="2" kv="0.1" gear="1.5"/></actuator>"""


def side_by_side() -> str:
    """All of them in one model."""
    world = ""
    for k, (name, text) in enumerate(MECHANISMS.items()):
        named = text.replace('name="', f'name="{name} ')
        world += f'<frame pos="0 {k} 0">{named}</frame>'
    return model(world, TIES)


def places(text: str, t: torch.Tensor, kind: str, names: list[str], start=None) -> np.ndarray:
    """Of sites or bodies (time, name, 3), in MuJoCo."""
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    if start is not None:
        start(m, d)
    x = []
    for k in range(len(t)):
        if k:
            mujoco.mj_step(m, d, round((t[1] - t[0]).item() / m.opt.timestep))
        mujoco.mj_kinematics(m, d)
        x.append([getattr(d, kind)(name).xpos.copy() for name in names])
    return np.array(x)


def sites_of(solution: tb.Solution, text: str, sites: list[str]) -> np.ndarray:
    """The same of a solution, of points of bodies."""
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    sites = [(m.body(int(m.site(name).bodyid[0])).name, d.site(name).xpos) for name in sites]
    return points_of(solution, sites)


def points_of(solution: tb.Solution, points: list[tuple[str, np.ndarray]]) -> np.ndarray:
    """(time, point, 3) of parts, and where each is at the start."""
    places = []
    for name, x in points:
        part = solution[name]
        arm = part.rotation[0].mT @ (torch.as_tensor(x) - part.position[0])
        places.append(part.position + part.rotation @ arm)
    return torch.stack(places, 1).numpy()


def read(text: str, folder: Path, **options):
    path = folder / "model.xml"
    path.write_text(text)
    return tb.read(path, **options)


def differences(ours: np.ndarray, theirs: np.ndarray, least: float = 1e-3) -> np.ndarray:
    """RMS of how far each site is off, over that of its displacement."""
    motion = np.square(theirs - theirs[0]).sum(-1).mean(0)
    assert (motion > least).all()
    return np.sqrt(np.square(ours - theirs).sum(-1).mean(0) / motion)


def test_mechanisms_move_as_in_mujoco(tmp_path):
    """Within 2e-4 of the displacement, of second order in the step of 4 ms; 5e-4 where a tendon
    pulls. A joint that sticks creeps by less than 2 % of a fall; by how much agrees to a quarter.
    The input of a servo is gear kp times its control.
    """
    text, names = side_by_side(), list(MECHANISMS)
    sites = [f"{name} tip" for name in names]
    t = torch.linspace(0, 0.4, 11)
    inputs = {"drive": torch.tensor([1.5 * 2 * -0.6])}
    solution = tb.simulate(read(text, tmp_path), t, step=4e-3, inputs=inputs)
    aim = lambda m, d: d.ctrl.fill(-0.6)  # noqa: E731
    ours, theirs = sites_of(solution, text, sites), places(text, t, "site", sites, aim)
    off = dict(zip(names, differences(ours, theirs, 1e-6).tolist(), strict=True))
    motion = np.square(theirs - theirs[0]).sum(-1).mean(0) ** 0.5
    assert motion[-1] < 0.02 * motion[0] and off.pop("stuck") < 0.25
    assert off.pop("pulled") < 5e-4
    assert {name: x for name, x in off.items() if not x < 2e-4} == {}


def test_models_of_gymnasium(tmp_path):
    """Of the 14 all are read but for the swimmer, which is in a fluid. Without contact and limits
    the half cheetah, driven, moves as in MuJoCo: to 1e-6 of the displacement, with steps of 5 ms of
    fourth order. Bodies between joints have 1e-6 of the mass.
    """
    gymnasium = pytest.importorskip("gymnasium")
    files = sorted((Path(gymnasium.__file__).parent / "envs/mujoco/assets").glob("*.xml"))
    assert len(files) > 12
    for file in files:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if file.stem == "swimmer":
                with pytest.raises(ValueError, match=r"swimmer\.xml with a fluid"):
                    tb.read(file)
            else:
                assert tb.read(file).joints
    t, mujoco_step = torch.linspace(0, 0.2, 5), 5e-4
    for file in files:
        if file.stem != "half_cheetah":
            continue
        spec = mujoco.MjSpec.from_file(str(file))
        for joint in spec.joints:
            joint.limited = 0
        for motor in spec.actuators:
            motor.ctrllimited = 0
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_RK4, mujoco_step
        m = spec.compile()
        text, control = spec.to_xml(), 0.2 * np.cos(np.arange(m.nu))
        force = control * m.actuator_gear[:, 0]
        names = [m.actuator(k).name for k in range(m.nu)]
        inputs = {x: torch.tensor([f]) for x, f in zip(names, force, strict=True)}
        scene = read(text, tmp_path)
        solution = tb.simulate(scene, t, method="midpoint4", step=5e-3, inputs=inputs)
        bodies = [m.body(b).name for b in range(1, m.nbody)]
        bodies = [name for name in bodies if name in {part.name for part in scene.beam.parts}]
        theirs = places(text, t, "body", bodies, lambda m, d, u=control: np.copyto(d.ctrl, u))
        ours = points_of(solution, list(zip(bodies, theirs[0], strict=True)))
        assert (differences(ours, theirs) < 1e-6).all(), file.stem


def rod(edges: int, name: str = "rod", pin: str = "0 1", y: float = 0.0) -> str:
    """A rod of 1 m along x of EI = 0.785 N m^2 and 0.6 kg/m; mass is equal in all vertices."""
    h = 1 / edges
    return (
        f'<flexcomp name="{name}" type="grid" dim="1" count="{edges + 1} 1 1" '
        f'spacing="{h} {h} {h}" radius="0.01" mass="{0.6 * (1 + h)}" pos="0.5 {y} 0">'
        '<elasticity young="1e8" shear="4e7" damping="0.002"/><contact selfcollide="none"/>'
        f'<pin id="{pin}"/><edge equality="true" {STIFF}/></flexcomp>'
    )


def explicit(gravity: str) -> str:
    return (
        f'<option timestep="{STEP}" integrator="Euler" gravity="{gravity}">{RIGID_ALONE}</option>'
    )


@rods
def test_rods_move_as_in_mujoco(tmp_path):
    """Clamped rods of six and twelve edges fall: the difference is of second order in an edge's
    length, 2.3 % and 0.53 % of the displacement, where MuJoCo's steps leave 0.02 %. A rod of eight
    on a pin carries a ball of 0.2 kg at its end: 0.2 %.
    """
    ball = '<body name="weight" pos="1 2 -0.05"><freejoint/><geom size="0.03" mass="0.2"/></body>'
    tie = f'<connect body1="hung_8" body2="weight" anchor="0 0 0" {STIFF}/>'
    world = rod(6, "a") + rod(12, "b", y=1.0) + rod(8, "hung", pin="0", y=2.0) + ball
    text = model(world, f"<equality>{tie}</equality>", explicit("0 0 -9.81"))
    t = torch.linspace(0, 0.5, 11)
    solution = tb.simulate(read(text, tmp_path), t, step=5e-3)
    x = [solution["a"].tip.position, solution["b"].tip.position, solution["weight"].position]
    theirs = places(text, t, "body", ["a_6", "b_12", "weight"])
    coarse, fine, hung = differences(torch.stack(x, 1).numpy(), theirs)
    assert fine < 0.006 and 3.5 < coarse / fine < 5
    assert hung < 0.002


@rods
def test_a_rod_vibrates_as_in_mujoco(tmp_path):
    """First frequency of a clamped rod, from five half periods in MuJoCo: 4.039 rad/s within 5e-5,
    and a hundredth of what the first edge's clamp at its middle makes (2.6 %).
    """
    n, text = 12, model(rod(12), option=explicit("0 0 0"))

    def pluck(m, d):
        for k in range(2, n + 1):
            d.qvel[m.body_dofadr[m.body(f"rod_{k}").id] + 2] = 0.02 * (k / n) ** 2

    z = places(text, torch.linspace(0, 4, 1001), "body", [f"rod_{n}"], pluck)[1:, 0, 2]
    k = np.flatnonzero(z[:-1] * z[1:] < 0)
    crossing = (k - z[k] / (z[k + 1] - z[k])) * 4e-3
    measured = np.pi * (len(k) - 1) / (crossing[-1] - crossing[0])
    frequency = tb.modes(read(text, tmp_path), count=1).frequency.item()
    assert abs(frequency / measured - 1) < 2e-4


@pytest.mark.skipif(FOUR, reason="cables went with MuJoCo 3")
@pytest.mark.parametrize("shape", ["circle", "box"])
def test_cables_move_as_in_mujoco(shape, tmp_path):
    """Of the plugin `cable`, clamped, with six and twelve links, as rods: 3.1 % and 0.6 % of the
    displacement (3.4 % and 0.7 % of a box). Measured with MuJoCo 3.3.7.
    """
    geom = {"circle": 'type="capsule" size=".01"', "box": 'type="box" size=".1 .02 .005"'}[shape]
    t, off = torch.linspace(0, 1, 51), []
    for n in (6, 12):
        text = f"""<mujoco><extension><plugin plugin="mujoco.elasticity.cable"/></extension>
          <option timestep="1.25e-4" integrator="implicitfast">{RIGID_ALONE}</option><worldbody>
          <composite type="cable" curve="s" count="{n + 1} 1 1" size="1" initial="none" prefix="r_">
          <plugin plugin="mujoco.elasticity.cable"><config key="twist" value="4e7"/>
          <config key="bend" value="{1e8 if shape == "circle" else 3e8}"/></plugin>
          <joint kind="main" damping="{0.012 / n}"/><geom {geom} density="1000"/>
          </composite></worldbody></mujoco>"""
        ours = tb.simulate(read(text, tmp_path), t, step=5e-3)["r"].tip.position[:, None].numpy()
        off.append(differences(ours, places(text, t, "site", ["r_S_last"])).item())
    assert off[1] < 0.008 and 3.5 < off[0] / off[1] < 5.5


def test_a_limit_gives_way_at_rest_as_in_mujoco(tmp_path):
    """The depth in a limit, of a joint and of a tendon, under a bar's weight: K of the scene times
    MuJoCo's depth is the weight's moment, or the tendon's pull. (The impedance is constant here;
    MuJoCo's default rises from 0.9 to 0.95 over a depth of 1 mm, K is that of the end.) A margin is
    before the limit.
    """
    rest, hard = 'damping="3"', 'solimplimit="0.95 0.95 0.001"'
    tendon = '<site name="end" pos="0.4 0 0"/>'
    world = bar(hinge(more=f'range="-2 0.45" margin="0.05" limited="true" {rest} {hard}'), "") + (
        '<frame pos="0 1 0">' + bar(hinge(more=rest), tendon, name="hung")
        + '<site name="wall" pos="0.4 0 0.5"/></frame>'
    )  # fmt: skip
    path = '<site site="wall"/><site site="end"/>'
    rope = f'limited="true" range="0 0.52" margin="0.02" {hard}'
    rope = f"<tendon><spatial {rope}>{path}</spatial></tendon>"
    text = model(world, rope)
    scene = read(text, tmp_path)
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_step(m, d, 8000)
    moment = m.body_mass[1] * 9.81 * 0.2 * np.cos(d.qpos)
    depths = d.qpos[0] - 0.4, d.ten_length[0] - 0.5
    stiffness = scene.joints[0].limit_stiffness, scene.tendons[0].stiffness
    for depth, K, load in zip(depths, stiffness, (moment[0], moment[1] / 0.4), strict=True):
        assert abs(K.item() * depth / load - 1) < 0.005


URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0" rpy="0 0 0.3"/><mass value="1.5"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><mass value="0.3"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><mesh filename="package://there/is/none.stl"/></geometry></collision></link>
  <link name="slide"><inertial><mass value="0.2"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.5" rpy="0 0.4 0"/><axis xyz="0 1 0"/><dynamics damping="0.2" friction="0.1"/>
    <limit lower="-1.5" upper="1.2" effort="10" velocity="3"/></joint>
  <joint name="mount" type="fixed"><parent link="upper"/><child link="tool"/>
    <origin xyz="0.4 0 0"/></joint>
  <joint name="feed" type="prismatic"><parent link="tool"/><child link="slide"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
</robot>"""


def test_urdf_is_read_likewise(tmp_path):
    """Fixed links are one body: 1.8 kg about (1.5 * 0.2 + 0.3 * 0.4)/1.8 = 0.2333 m from the
    shoulder, turned by 0.4 rad; damping, friction, limits and axes as they stand in the file. A
    mesh is not needed where an inertia is given.
    """
    arm = read(URDF, tmp_path, part="arguments", format="urdf")
    upper, (shoulder, feed) = arm["beam"]["upper"], arm["joints"]
    assert set(arm["beam"]) == {"upper", "slide"}
    torch.testing.assert_close(torch.as_tensor(upper.mass), torch.tensor(1.8).double())
    along = torch.tensor((np.cos(0.4), 0, -np.sin(0.4)))
    centre = torch.tensor((0, 0, 0.5)) + 0.42 / 1.8 * along
    torch.testing.assert_close(torch.as_tensor(upper.position), centre)
    # of the inertia of `upper` alone, about its own z; MuJoCo 3 forgets this turn
    turned = 0.3 if FOUR else 0.0
    R = torch.tensor(
        ((np.cos(turned), -np.sin(turned), 0), (np.sin(turned), np.cos(turned), 0), (0, 0, 1))
    )
    own = torch.tensor(((0.02, 0.001, 0), (0.001, 0.03, 0), (0, 0, 0.02))).double()
    steiner = 1.5 * 0.3 / 1.8 * 0.2**2 * torch.diag(torch.tensor((0.0, 1, 1)))
    want = R @ own @ R.mT + 1e-3 * torch.eye(3) + steiner
    torch.testing.assert_close(torch.as_tensor(upper.inertia), want)
    assert isinstance(shoulder, tb.Hinge) and isinstance(feed, tb.Slider)
    assert (float(shoulder.damping), float(shoulder.friction)) == (0.2, 0.1)
    torch.testing.assert_close(torch.as_tensor(shoulder.limits), torch.tensor((-1.5, 1.2)).double())
    torch.testing.assert_close(
        torch.as_tensor(feed.axis), torch.tensor((np.sin(0.4), 0, np.cos(0.4)))
    )


def test_motors_are_inputs_and_numbers_have_gradients(tmp_path):
    """The input is the torque itself, whatever the gear. Of a bar at rest q = u t^2/(2 I), and the
    derivative by a damper that is put in, at c = 0, is -u t^3/(6 I^2).
    """
    motor = '<actuator><motor name="drive" joint="turn" gear="3"/></actuator>'
    text = model(bar(hinge("0 0 1", 'name="turn"'), ""), motor, explicit("0 0 0"))
    given = read(text, tmp_path, part="arguments")
    u = torch.tensor([0.03], dtype=torch.float64, requires_grad=True)
    c = torch.zeros((), dtype=torch.float64, requires_grad=True)
    given["joints"] = [replace(given["joints"][0], damping=c)]
    scene = tb.Scene(**given)
    assert scene.inputs == {"drive": 1}
    t = 0.2
    end = tb.simulate(scene, [0.0, t], step=5e-3, inputs={"drive": u}).joint[0].coordinate[-1]
    by_u, by_c = torch.autograd.grad(end, (u, c))
    m = mujoco.MjModel.from_xml_string(text)
    inertia = m.body_inertia[1][0] + m.body_mass[1] * 0.2**2
    assert abs(end.item() / (0.03 * t**2 / 2 / inertia) - 1) < 1e-5
    assert abs(by_u.item() / (t**2 / 2 / inertia) - 1) < 1e-5
    assert abs(by_c.item() / (-0.03 * t**3 / 6 / inertia**2) - 1) < 1e-3


JOINT = bar(hinge(more='name="j"'), '<site name="a"/>') + '<site name="w" pos="0 0 1"/>'
REFUSED = {  # what a model has, and what the sentence says of it
    "armature": (model(bar('<joint type="ball" armature="1"/>', "")), "armature of the joint"),
    "fluid": (model(JOINT, option='<option density="1.2"/>'), "a fluid"),
    "compensated": (
        model(JOINT.replace('name="first"', 'name="first" gravcomp="1"')),
        "gravity comp",
    ),
    "coupled": (
        model(JOINT, '<equality><joint joint1="j"/></equality>'),
        "another kind than connect",
    ),
    "apart": (
        model(JOINT, '<equality><connect site1="a" site2="w"/></equality>'),
        "not fulfilled at qpos0",
    ),
    "pushing": (
        model(
            JOINT,
            '<tendon><spatial stiffness="1"><site site="a"/><site site="w"/></spatial></tendon>',
        ),
        "the push of the tendon",
    ),
    "fixed tendon": (
        model(JOINT, '<tendon><fixed stiffness="1"><joint joint="j" coef="1"/></fixed></tendon>'),
        "sites alone",
    ),
    "cloth": (
        model(JOINT + '<flexcomp name="f" type="grid" dim="2" count="3 3 1" spacing=".1 .1 .1"/>'),
        "no rod of MuJoCo 4",
    ),
    "ball limit": (
        model(bar('<joint type="ball" range="0 1" limited="true"/>', "")),
        "limits of the joint 'joint 0', a ball",
    ),
    "sprung body": (model(bar('<joint type="free" stiffness="1"/>', "")), "stiffness of the joint"),
    "servo of a tendon": (
        model(
            JOINT,
            '<tendon><spatial name="t"><site site="a"/><site site="w"/></spatial></tendon>'
            '<actuator><position name="p" tendon="t" kp="1"/></actuator>',
        ),
        "the actuator 'p', which is no motor or servo",
    ),
    "plugin": (
        model(
            JOINT,
            '<extension><plugin plugin="mujoco.pid"><instance name="x"/></plugin></extension>'
            '<actuator><plugin name="p" joint="j" plugin="mujoco.pid" instance="x"/></actuator>',
        ),
        "the actuator 'p', which is no motor or servo",
    ),
    "switch": (
        model(JOINT, option='<option><flag spring="disable"/></option>'),
        "spring switched off",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_changes_the_motion_is_refused_and_named(name, tmp_path):
    """And the arguments without it come with a warning that names it."""
    text, says = REFUSED[name]
    with pytest.raises(ValueError, match=says):
        read(text, tmp_path)
    with pytest.warns(UserWarning, match=says):
        assert "first" in read(text, tmp_path, part="arguments")["beam"]


def test_impedances_are_bounded_as_in_mujoco(tmp_path):
    """d = 1 counts as 0.9999: a limit is finite, friction slips slowly but moves."""
    ones = 'solimplimit="1 1 1" solimpfriction="1 1 1"'
    text = model(bar(hinge(more=f'range="-1 1" limited="true" frictionloss="1" {ones}'), ""))
    (joint,) = read(text, tmp_path).joints
    near = read(text.replace("1 1 1", ".9999 .9999 1"), tmp_path).joints[0]
    for name in ("limit_stiffness", "slip_speed"):
        torch.testing.assert_close(getattr(joint, name), getattr(near, name), rtol=1e-9, atol=0)


def test_what_may_not_matter_is_told(tmp_path):
    """Contact, a second motor, limits of efforts and keyframes, in one warning; a connection within
    a body is none; the time step is a part of its own.
    """
    actuators = (
        '<actuator><motor name="m" joint="j"/><motor name="second" joint="j"/></actuator>'
        '<equality><connect body1="first" body2="mate" anchor="0 0 0"/></equality>'
    )
    key = '<keyframe><key qpos="1"/></keyframe>'
    mate = '<body name="mate"/><site name="a"/>'
    limited = JOINT.replace('<site name="a"/>', mate).replace('"j"', '"j" actuatorfrcrange="-1 1"')
    text = model(limited, actuators + key, '<option timestep="0.004"/>')
    every = "'second'.*contact of geoms.*keyframes"
    with pytest.warns(UserWarning, match=f"the range of the motor 'm'.*{every}"):
        scene = read(text, tmp_path)
    assert isinstance(scene.beam.surface("first"), tb.Capsule)
    assert read(text, tmp_path, part="timestep") == 0.004
    for wrong, says in (("<mujoco><a/></mujoco>", "refuses: .*Element 'a'"), (model(""), "moves")):
        with pytest.raises(ValueError, match=says):
            read(wrong, tmp_path)
    with pytest.raises(ValueError, match="elements or order"):
        read(text, tmp_path, part="timestep", elements=3)
