"""One good call of each public function and class: name -> (what is called, its arguments by
name).
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import torch

import torchbeam as tb
from torchbeam import sensors as S

PLIES = [(0.01, 0.3, tb.Material(E=1.0, nu=0.3, rho=1.0))]
ISOTROPIC = dict(E=1.0, nu=0.3, rho=1.0, fineness=1)
TUBE = tb.CrossSection.tube(0.1, 0.05, 1.0, 0.3, 1.0)
SECTION = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
BEAM = tb.Beam.straight(1.0, 2, SECTION)
SCENE = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 1.0)), tb.Damping(0.01)])
DRIVEN = tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3))])
OTHER = tb.Scene(tb.Beam.straight(1.0, 3, SECTION))
START = tb.rest(SCENE)
HUB = tb.Body(0.2, 0.1, position=(1.0, 0, 0))
HINGED = tb.rest(
    tb.Scene(
        {"arm": BEAM, "hub": HUB},
        joints=[tb.Hinge(("arm", -1), "hub")],
        supports=[tb.Support(("arm", 0))],
    )
)
OVERHUNG = tb.Scene(
    {"arm": BEAM, "hub": HUB},
    joints=[tb.Hinge(("arm", -1), "hub", axis=(1, 0, 0))],
    supports=[tb.Support(("arm", 0))],
)
LEANING = tb.Scene(
    BEAM,
    [
        tb.Contact(
            tb.Plane((0.0, 0, -0.1), (0, 0, 1.0)),
            thickness=0.2,
            force=1.0,
            friction=0.1,
            slip_speed=0.1,
        )
    ],
)
SOLUTION = tb.simulate(SCENE, [0.0, 0.1, 0.2], step=0.1)
EQUILIBRIUM = tb.equilibrium(SCENE)
MODES = tb.modes(SCENE)
LINEAR = tb.linearize(DRIVEN, outputs=[S.TipPosition()], inputs={"u": (0.0, 0, 0)})
STEPPER = tb.Stepper(DRIVEN, 0.1)
FORCE = (0, 0, 1.0)
PUSHED = torch.tensor(FORCE, dtype=torch.float64, requires_grad=True)


def model(p):
    return p["f"][..., None] ** torch.arange(1, 4, dtype=torch.float64)


DATA = model({"f": torch.ones((), dtype=torch.float64)})
PLACES = {f"{k}": tb.Measurement(torch.nan, 0.1) for k in range(3)}
PLAN = dict(model=lambda p: model(p).unbind(-1), candidates=PLACES, start={"f": 0.5}, sensors=2,
            budget=3.0, cost=1.0, most=1, present=["0"], inputs=None, runs=1, criterion="D", of="f",
            correlation=0.5, method="greedy", draws=1, seed=0, log=False, derivatives="difference",
            relative_step=1e-4)  # fmt: skip
FITTED = tb.identify(model, tb.Measurement(DATA + 0.01, 0.1), {"f": 0.5})


def yielding(p):
    return tb.Scene(BEAM, [tb.Gravity(p["g"][..., None] * torch.tensor([0, 0, -1.0]).double()),
        tb.TipLoad(force=tb.Input("u", 3)), tb.Damping(0.01)], plane="xz")  # fmt: skip


MODEL = tb.linearize(
    yielding({"g": torch.tensor(1.0).double()}), inputs={"u": (0.0, 0, 0)}
).reduced(1)
WATCHED = dict(scene=yielding, sensors=S.TipPosition()["z"], dt=0.1, noise=0.01, rate=False,
    process={"u": ((0, 0, 0.1), 0.5)}, parameters={"g": (1.0, 0.1)}, walk={"g": 0.01}, shaking=0.01,
    bias=0.01, delay=0, drive=None, steps=1, model=MODEL, method="midpoint")  # fmt: skip
KALMAN = tb.KalmanFilter(**WATCHED)

SHAKEN = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 1.0)), tb.Damping(0.01)])
FOLDER = TemporaryDirectory(prefix="torchbeam-calls-")  # of this process alone
SAVED = tb.save(START, Path(FOLDER.name) / "saved.pt", scene=SCENE)
BLADE = Path(__file__).parents[2] / "examples/blades/nrel_5_mw_elastodyn.dat"
EXPORTED = str(Path(FOLDER.name) / "exported.vtu")  # nothing else is written, but SAVED and
PICTURE = str(Path(FOLDER.name) / "picture.svg")

# fmt: off
CALLS = {
    "save": (tb.save, dict(what=START, path=str(SAVED), scene=SCENE)),
    "load": (tb.load, dict(path=str(SAVED), scene=SCENE)),
    "read": (tb.read, dict(path=str(BLADE), format="elastodyn", part="blade", elements=2, order=1,
                           length=61.5)),
    "from_stiffness": (tb.Section.from_stiffness, dict(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3,
        inertia=0.01)),
    "rectangle": (tb.Section.rectangle, dict(width=0.1, height=0.1, E=1.0, nu=0.3, rho=1.0)),
    "circle": (tb.Section.circle, dict(radius=0.1, E=1.0, nu=0.3, rho=1.0)),
    **{f"Section.{name}": (getattr(tb.Section, name), arguments | ISOTROPIC)
       for name, arguments in dict(
           tube=dict(outer=0.1, inner=0.05), box=dict(width=0.1, height=0.1, thickness=0.01),
           i_beam=dict(width=0.1, height=0.1, flange=0.01, web=0.01),
           channel=dict(width=0.1, height=0.1, flange=0.01, web=0.01),
           angle=dict(width=0.1, height=0.1, thickness=0.01),
           polygon=dict(points=[(0.0, 0), (1, 0), (0, 1)], holes=[])).items()},
    **{f"Section.{name}": (getattr(tb.Section, name), arguments | dict(fineness=1))
       for name, arguments in dict(
           laminate=dict(plies=PLIES, width=0.1),
           polygons=dict(parts=[([(0.0, 0), (1, 0), (0, 1)], PLIES[0][2])]),
           thin_walled=dict(walls=[([(0.0, 0), (1, 0)], PLIES)], line="first", join="depth")
       ).items()},
    "from_cross_section": (tb.Section.from_cross_section, dict(cross=TUBE)),
    "CrossSection.stress": (TUBE.stress, dict(F=FORCE, M=FORCE, axes="material")),
    "Material": (tb.Material, dict(E=1.0, nu=0.3, rho=1.0)),
    "Material2": (tb.Material, dict(E1=1.0, E2=1.0, E3=1.0, G12=1.0, G13=1.0, G23=1.0, nu12=0.1,
        nu13=0.1, nu23=0.1, rho=1.0)),
    "Section": (tb.Section, dict(compliance=torch.eye(6), mass=torch.eye(6))),
    "rotated": (SECTION.rotated, dict(angle=0.1)),
    "shifted": (SECTION.shifted, dict(y=0.1, z=0.1)),
    "straight": (tb.Beam.straight, dict(length=1.0, elements=2, section=SECTION,
        direction=(1.0, 0, 0), up=(0, 0, 1.0), root=(0.0, 0, 0), twist=0.1, order=1)),
    "arc": (tb.Beam.arc, dict(radius=1.0, angle=1.0, elements=2, section=SECTION,
        direction=(1.0, 0, 0), up=(0, 0, 1.0), root=(0.0, 0, 0), order=1)),
    "curve": (tb.Beam.curve, dict(length=1.0, elements=2, section=SECTION, curvature=(0, 0, 1.0),
        direction=(1.0, 0, 0), up=(0, 0, 1.0), root=(0.0, 0, 0), order=1)),
    "from_nodes": (tb.Beam.from_nodes, dict(nodes=[[0.0, 0, 0], [1, 0, 0]], section=SECTION,
        frames=torch.eye(3)[None], order=1)),
    "Scene": (tb.Scene, dict(beam=BEAM, effects=[tb.Damping(0.1)],
        frame=tb.Frame(velocity=(1.0, 0, 0)), root=None, plane=None, supports=[tb.Support(0)],
        small=False)),
    "Scene2": (tb.Scene, dict(beam=BEAM, effects=[tb.Damping(0.1)],
        root=tb.RootMotion(displacement=(0.0, 0, 0)), plane="xz")),
    "TipLoad": (tb.TipLoad, dict(force=FORCE, moment=FORCE, follower=False)),
    "PointLoad": (tb.PointLoad, dict(node=1, force=FORCE, moment=FORCE, follower=False)),
    "LineLoad": (tb.LineLoad, dict(force=FORCE, moment=FORCE, follower=False)),
    "Gravity": (tb.Gravity, dict(g=FORCE)),
    "Damping": (tb.Damping, dict(tau=0.1, six=False)),
    "Viscoelastic": (tb.Viscoelastic, dict(shares=(0.1, 0.2), times=(0.1, 1.0), six=False)),
    "MassDamping": (tb.MassDamping, dict(alpha=0.1)),
    "rayleigh": (tb.rayleigh, dict(frequency=(1.0, 2.0), ratio=(0.1, 0.1))),
    "Drag": (tb.Drag, dict(density=1.0, diameter=1.0, normal=1.0, tangential=0.1,
        flow=(0.0, 0, 1.0), added_mass=0.0)),
    "Drag2": (tb.Drag, dict(density=1.0, diameter=1.0, added_mass=0.1)),
    "StripAir": (tb.StripAir, dict(chord=0.1, axis=0.3, lift_slope=6.0, lags="wagner",
        density=1.2, wind=(0.0, -1.0, 0))),
    "Wind": (tb.Wind, dict(mean=FORCE, exponent=0.2, height=10.0, up=(0.0, 0, 1.0))),
    "Wind2": (tb.Wind, dict(mean=FORCE, roughness=0.1, height=10.0)),
    "Gust": (tb.Gust, dict(peak=FORCE, gradient=10.0, speed=10.0, direction=FORCE, start=0.0)),
    "Gust.certification": (tb.Gust.certification, dict(reference=17.0, gradient=10.0, up=FORCE,
        alleviation=0.8, speed=10.0)),
    "Turbulence": (tb.Turbulence, dict(mean=(1.0, 0, 0), sigma=0.1, length=1.0, up=(0.0, 0, 1.0),
        spectrum="kaimal", isotropic=False, harmonics=4, band=(0.1, 10.0), seed=(1, 2))),
    "WindTable": (tb.WindTable, dict(t=[0.0, 1.0], values=torch.ones(2, 1, 2, 1, 3),
        y=[0.0, 1.0])),
    "Polar": (tb.Polar, dict(alpha=[-0.1, 0.1], cl=[-0.6, 0.6], cd=[0.0, 0.0], cm=[0.0, 0.0])),
    "DynamicStall": (tb.DynamicStall, dict(polar=tb.Polar((-0.1, 0.1), (-0.6, 0.6), (0.0, 0.0)),
        pressure=1.7, separation=3.0)),
    "Induction": (tb.Induction, dict(r=[0.0, 1.0], axial=[1.0, 1.0], swirl=[0.0, 0.0],
        axis=(0.0, 0, 1.0))),
    "blade_element_momentum": (tb.blade_element_momentum, dict(wind=10.0, spin=5.0, r=[2.0, 4.0],
        chord=[0.5, 0.4], twist=[0.2, 0.1], polar=tb.Polar((-0.5, 0.5), (-3.0, 3.0), (0.0, 0.0)),
        blades=3, hub=1.0, tip=5.0, axis=(0.0, 0, 1.0), density=1.2, losses=True)),
    "PointMass": (tb.PointMass, dict(mass=1.0, inertia=(1.0, 1.0, 1.0), offset=(0.0, 0, 0.1),
        node=1)),
    "Spring": (tb.Spring, dict(node=-1, stiffness=1.0, to=FORCE, length=0.1, damping=0.1)),
    "Tendon": (tb.Tendon, dict(eyelets=[(0, FORCE), (-1, FORCE)], tension=1.0, friction=0.1,
        slip_speed=0.1)),
    "Tendon2": (tb.Tendon, dict(eyelets=[(0, FORCE), (-1, FORCE)], length=1.0, stiffness=1.0)),
    "Tendon.along": (tb.Tendon.along, dict(beam=BEAM, point=FORCE, name="arm", tension=1.0)),
    "RootSpring": (tb.RootSpring, dict(stiffness=torch.ones(6), damping=torch.ones(6))),
    "Contact": (tb.Contact, dict(obstacle=tb.Plane(FORCE, FORCE), thickness=0.1, force=1.0,
        radius=0.1, friction=0.1, slip_speed=0.1, damping=0.1, points=2, push_out=False)),
    "Contact2": (tb.Contact, dict(obstacle="a", other="b", thickness=0.1, stiffness=1.0, radius=0.1,
        other_radius=0.1)),
    "Contact of a node": (tb.Contact, dict(obstacle=tb.Plane(FORCE, FORCE), node=-1, thickness=0.1,
        force=1.0, radius=0.1)),
    "Contact3": (tb.Contact, dict(obstacle="a", other="b", thickness=0.1, force=1.0,
        radius=tb.Table((0.0, 1.0), (0.1, 0.05)), other_radius=tb.Table((0.0, 1.0), (0.1, 0.05)))),
    "SelfContact": (tb.SelfContact, dict(on=None, apart=6.0, thickness=0.1, force=1.0, radius=0.1,
        friction=0.1, slip_speed=0.1, damping=0.1, points=2, push_out=False)),
    **{name: (getattr(S, name), dict(scene=LEANING, contact=0)) for name in ("ContactForce",
        "ContactForces", "ContactGap", "ContactPoints", "ContactPressure", "ContactSlip")},
    "Plane": (tb.Plane, dict(point=FORCE, normal=FORCE)),
    "Sphere": (tb.Sphere, dict(centre=FORCE, radius=0.1, spin=FORCE)),
    "Cylinder": (tb.Cylinder, dict(point=FORCE, axis=FORCE, radius=0.1, inside=True, spin=0.1)),
    "Capsule": (tb.Capsule, dict(a=FORCE, b=(0, 0, 2.0), radius=0.1)),
    "Box": (tb.Box, dict(centre=FORCE, size=(1.0, 1.0, 1.0), rounding=0.1, rotation=FORCE)),
    "Actuation": (tb.Actuation, dict(curvature=FORCE, strain=FORCE, elements=[0])),
    "Load": (tb.Load, dict(function=lambda r, R, v, w, t: (-v, None), node=-1, of=("position",
        "rotation", "velocity", "spin"))),
    "Load2": (tb.Load, dict(function=lambda *x, **k: (None, None), internal=2, rate=lambda *x,
        **k: x[0], inputs={"u": 1}, values={"c": 1.0})),
    "Input": (tb.Input, dict(name="u", size=3)),
    "History": (tb.History, dict(t=[0.0, 1.0], values=[[0.0, 0, 0], [0, 0, 1.0]])),
    "Accelerogram": (tb.Accelerogram, dict(t=[0.0, 1.0, 2.0], acceleration=[[0.0, 0, 0],
        [0, 0, 1.0], [0, 0, 0]])),
    "SmoothHistory": (tb.SmoothHistory, dict(t=[float(k) for k in range(9)],
        values=[[0.0, 0, k * k] for k in range(9)], sigma=0.1)),
    "SmoothRotation": (tb.SmoothRotation, dict(t=[float(k) for k in range(9)],
        values=[[0.0, 0, 0.1 * k] for k in range(9)])),
    "Along": (tb.Along, dict(function=lambda s, t: s)),
    "PerElement": (tb.PerElement, dict(value=torch.ones(2, 3))),
    "PerInterval": (tb.PerInterval, dict(value=torch.ones(2, 3, dtype=torch.float64))),
    "Stations": (tb.Stations, dict(s=[0.0, 1.0], section=[SECTION] * 2)),
    "Table": (tb.Table, dict(s=[0.0, 1.0], values=[1.0, 2.0])),
    "Frame": (tb.Frame, dict(velocity=FORCE, angular_velocity=FORCE)),
    "RootMotion": (tb.RootMotion, dict(displacement=FORCE, rotation=FORCE)),
    "Body": (tb.Body, dict(mass=1.0, inertia=0.1, position=FORCE, rotation=torch.eye(3))),
    "Weld": (tb.Weld, dict(a=("arm", -1), b="hub", at=FORCE)),
    "Ball": (tb.Ball, dict(a=("arm", -1), b="hub", at=FORCE, stiffness=1.0, damping=0.1,
        friction=0.1, slip_speed=0.1, axis=FORCE, limit=1.0, limit_stiffness=1.0, torque=FORCE)),
    "Hinge": (tb.Hinge, dict(a=("arm", -1), b="hub", axis=FORCE, stiffness=1.0, damping=0.1,
        friction=0.1, slip_speed=0.1, limits=(-1.0, 1.0), limit_stiffness=1.0, torque=1.0,
        inertia=0.1, hysteresis=tb.BoucWen(1.0, 1.0))),
    "Slider": (tb.Slider, dict(a=("arm", -1), b=("hub", FORCE), axis=FORCE, stiffness=1.0,
        damping=0.1, friction=0.1, slip_speed=0.1, limits=(-1.0, 1.0), limit_stiffness=1.0,
        force=1.0, hysteresis=tb.ElastoPlastic(1.0, 1.0))),
    "Hinge2": (tb.Hinge, dict(a=("arm", -1), b=None, at=FORCE, angle=0.1)),
    "Slider2": (tb.Slider, dict(a=None, b="hub", travel=0.1)),
    "Cylindrical": (tb.Cylindrical, dict(a=("arm", -1), b="hub", axis=FORCE, at=FORCE)),
    "Universal": (tb.Universal, dict(a=("arm", -1), b="hub", axis=FORCE, second=(1.0, 0, 0),
        at=FORCE, stiffness=(1.0, 0.0), limits=((-1.0, 1.0), (-2.0, 2.0)),
        limit_stiffness=(1.0, 0.0), torque=1.0, second_angle=0.1)),
    "ElastoPlastic": (tb.ElastoPlastic, dict(stiffness=1.0, yield_moment=1.0, hardening=0.1,
        kinematic=0.5)),
    "BoucWen": (tb.BoucWen, dict(stiffness=1.0, yield_moment=1.0, ratio=0.1, n=2.0, beta=0.5,
        gamma=0.5)),
    "Drive": (tb.Drive, dict(function=lambda angle, k: -k * angle, values=dict(k=1.0))),
    "Distance": (tb.Distance, dict(a=None, b="hub", at=FORCE)),
    "Scene of parts": (tb.Scene, dict(beam={"arm": BEAM, "hub": HUB},
        joints=[tb.Weld(("arm", -1), "hub")], supports=[])),
    "Support": (tb.Support, dict(node=0, position="xyz", rotation="xyz", displacement=FORCE,
        turn=FORCE)),
    "rest": (tb.rest, dict(scene=SCENE, batch_shape=(2,), t=0.0)),
    "consistent_state": (tb.consistent_state, dict(scene=SCENE, u=torch.zeros(2, 3),
        theta=torch.zeros(2, 3), V=torch.zeros(2, 3), Omega=torch.zeros(2, 3), t=0.0,
        form="minimal", inputs={})),
    "block_rate": (tb.block_rate, dict(scene=tb.Scene(BEAM),
        state=tb.consistent_state(tb.Scene(BEAM)), t=0.0, inputs={})),
    "simulate": (tb.simulate, dict(scene=DRIVEN, t=[0.0, 0.1], initial=tb.rest(DRIVEN),
        method="midpoint", step=0.1, inputs={"u": (0.0, 0, 0)}, form="nodal", throw=False,
        lumped=False, conserve=False, tolerance=1e-6, iterations=10, halvings=2, engine="auto",
        checkpoint=False, progress=lambda a, b: None)),
    "simulate_alpha": (tb.simulate, dict(scene=SCENE, t=[0.0, 0.1], method="generalized_alpha",
        rho_inf=0.8, step=0.1)),
    "simulate_rtol": (tb.simulate, dict(scene=SCENE, t=[0.0, 0.1], initial=START, rtol=1e-1,
        atol=1e-2, events=lambda s: s.tip.position[..., 0], max_steps=1000, first_step=0.01)),
    "simulate_dopri": (tb.simulate, dict(scene=SCENE, t=[0.0, 0.01], initial=START, method="dopri5",
        rtol=1e-3, atol=1e-3, options={}, adjoint=False, begin=torch.zeros(()))),
    "simulate_minimal": (tb.simulate, dict(scene=tb.Scene(BEAM), t=[0.0, 0.01], form="minimal",
        initial=tb.consistent_state(tb.Scene(BEAM)), rtol=1e-3)),
    "simulate_block": (tb.simulate, dict(scene=tb.Scene(BEAM), t=[0.0, 0.01], form="block_rate",
        project=True, solver="sweep")),
    "rollout": (tb.rollout, dict(stepper=STEPPER, state=tb.rest(DRIVEN), steps=2,
        inputs={"u": torch.zeros(3)})),
    "rollout_jacobian": (tb.rollout_jacobian, dict(stepper=STEPPER, state=tb.rest(DRIVEN), steps=2,
        inputs={"u": PUSHED}, read=lambda states: states.position[..., -1, :], by=PUSHED, every=1)),
    "Stepper": (tb.Stepper, dict(scene=SCENE, dt=0.1, method="midpoint", lumped=False,
        tolerance=1e-6, iterations=10, halvings=2, conserve=False, engine="auto")),
    "step": (STEPPER, dict(state=tb.rest(DRIVEN), u=FORCE, active=torch.tensor(True), dt=0.1)),
    "stepper.rest": (STEPPER.rest, dict(batch_shape=(2,))),
    "stepper.begin": (STEPPER.begin, dict(state=tb.rest(DRIVEN), dt=0.1, u=FORCE)),
    "ExplicitStepper": (tb.ExplicitStepper, dict(scene=SCENE, dt=0.001, method="rk4",
        form="minimal")),
    "equilibrium": (tb.equilibrium, dict(scene=DRIVEN, initial=tb.rest(DRIVEN), t=0.0,
        tolerance=1e-8, throw=True, branch="first", relax=False, engine="auto",
        inputs={"u": FORCE})),
    "path": (tb.path, dict(scene=SCENE, highest=1.0, lowest=-1.0, load=None, step=0.3, steps=5,
        branch=False, initial=None, t=0.0, tolerance=1e-8)),
    "path2": (tb.path, dict(scene=SCENE, control=lambda s: s.tip.position[..., 2], target=0.1,
        steps=5)),
    "critical_load": (tb.critical_load, dict(scene=DRIVEN, highest=5.0, lowest=0.0, points=5,
        count=3, tolerance=1e-3, t=0.0, lumped=False, inputs={"u": (-1.0, 0, 0)})),
    "modes": (tb.modes, dict(scene=DRIVEN, state=tb.rest(DRIVEN), count=3, normalize="largest",
        t=0.0, lumped=False, inputs={"u": (0.0, 0, 0)})),
    "campbell": (tb.campbell, dict(scene=OVERHUNG, speeds=(0.0, 1.0), bearing=0, held=True, count=2,
        method="auto", steps=8, t=0.0, inputs=None, progress=None)),
    "unbalance_response": (tb.unbalance_response, dict(scene=OVERHUNG, speeds=(0.0, 1.0),
        unbalance={"hub": (0, 1e-4, 0)}, bearing=0, t=0.0, inputs=None)),
    "linearize": (tb.linearize, dict(scene=DRIVEN, state=tb.rest(DRIVEN), outputs=[S.TipPosition()],
        t=0.0, lumped=False, inputs={"u": (0.0, 0, 0)})),
    "response": (LINEAR.response, dict(omega=1.0)),
    "departure": (LINEAR.departure, dict(state=tb.rest(DRIVEN))),
    "pose_from_points": (tb.pose_from_points, dict(points=torch.eye(3), measured=2 + torch.eye(3))),
    "SensorFrame": (tb.SensorFrame, dict(origin=(0.0, 0.0, 0.1), rotation=torch.eye(3),
        tilt=(0.0, 0.0, 0.1))),
    "observe": (tb.observe, dict(solution=SOLUTION, sensor=S.TipPosition(), times=[0.05], delay=0.0,
        rate=False)),
    "converge": (tb.converge, dict(scene=SCENE, t=None, read=lambda state: state.tip.position,
        rtol=0.1, solve=tb.equilibrium, size=1.0, share=0.5, elements=["linear"],
        methods=["midpoint"], most_elements=8, most_steps=10, seconds=10.0, initial=None,
        inputs=None, engine="eager", progress=lambda done, setting: None)),
    "export": (tb.export, dict(what=START, path=EXPORTED, state=None, scene=None)),
    "export2": (tb.export, dict(what=MODES, path=EXPORTED, state=EQUILIBRIUM)),
    "remesh": (tb.remesh, dict(scene=SCENE, elements=8, order=2, linked=False)),
    "advise": (tb.advise, dict(scene=SCENE, t=[0.0, 0.1], quantity=lambda s: s.tip.position[..., 2],
        tolerance=0.01, consider=[tb.Gravity(FORCE)], initial=START, step=0.1, repeats=1,
        show=False, inputs={})),
    "describe": (tb.describe, dict(scene=SCENE)),
    "Parameter": (tb.Parameter, dict(start=1.0, transform="log", bounds=(0.1, 2.0), prior=None,
        scale=1.0, own=False)),
    "Measurement": (tb.Measurement, dict(values=DATA, sigma=0.1, times=[0.0, 0.1, 0.2],
        sensor=S.TipPosition(), rate=False, delay=0.0, clock=0.0, offset=False, drift=False,
        name="a", fitted=0, place={}, frame=None, noise="white", baseline=None,
        hum=())),
    "SlowBaseline": (tb.SlowBaseline, dict(first=0.0, last=1.0, spacing=0.3, degree=3)),
    "Smoothness": (tb.Smoothness, dict(order=1, at=[0.0, 1.0], sharp=False)),
    "design": (tb.design, PLAN),
    "compare": (tb.compare, dict(fits={"one": FITTED, "two": FITTED}, by="prediction", blocks=3,
                                 gap=0)),
    "identify": (tb.identify, dict(model=model, data=DATA, start={"f": 0.5}, bounds=None, sigma=0.1,
        starts=1, seed=0, noise="common")),
    "KalmanFilter": (tb.KalmanFilter, dict(**WATCHED, second_order=True, gate=0.999,
        loss="student", bounds={"u[2]": (-1.0, 1.0)})),
    "KalmanFilter2": (tb.KalmanFilter, dict(scene=DRIVEN, sensors=lambda scene, inputs:
        S.TipPosition(), dt=0.1, noise=0.01, process={"u": 0.1}, delay=1,
        drive=lambda p, u: {"u": u}, model=LINEAR)),
    "MovingHorizon": (tb.MovingHorizon, dict(**WATCHED, window=3, iterations=1, loss="huber",
        gate=None, bounds=None)),
    "filter()": (KALMAN, dict(before=KALMAN.start(), y=(0.01,), u=FORCE)),
    "filter.start": (KALMAN.start, dict(batch=(), state=None, amplitude=0.01, modes=1,
        covariance=None)),
    "filter.run": (KALMAN.run, dict(start=KALMAN.start(), readings=[[0.01], [0.02]], u=None)),
    "monte_carlo": (tb.monte_carlo, dict(function=lambda x: x, laws={"f": tb.laws.Normal(1.0, 0.1)},
        n=4, design="sobol", seed=0, chunk=2)),
    "monte_carlo2": (tb.monte_carlo, dict(function=lambda x: x,
        laws={"f": tb.laws.Normal(1.0, 0.1)}, n=4, until=None, replicates=2, correlation=None)),
    "monte_carlo_stream": (tb.monte_carlo_stream, dict(function=lambda x: x[..., 0],
        laws={"f": tb.laws.Normal(1.0, 0.1)}, n=64)),
    "sobol_indices": (tb.sobol_indices, dict(function=lambda x: x.sum(-1),
        laws={"f": tb.laws.Normal(1.0, 0.1), "g": tb.laws.Normal(1.0, 0.1)}, n=64)),
    "tornado": (tb.tornado, dict(function=lambda x: x[..., 0],
        laws={"f": tb.laws.Normal(1.0, 0.1)})),
    "rare_event": (tb.rare_event, dict(function=lambda x: x[..., 0],
        laws={"f": tb.laws.Normal(1.0, 0.1)}, threshold=1.2, n=1000)),
    "moment_derivatives": (tb.moment_derivatives, dict(function=lambda x: x[..., 0],
        laws=lambda q: {"f": tb.laws.Normal(q[0], 0.1)}, q=[1.0], n=64)),
    "pair_modes": (tb.pair_modes, dict(modes=MODES, shapes=torch.ones(3, 2),
        read=lambda s: s[..., -1, :2])),
    "modal_assurance": (tb.modal_assurance, dict(a=torch.ones(3, 2).double(),
        b=torch.ones(3, 2).double())),
    "plot.shape": (tb.plot.shape, dict(state=START, ax=None, plane=None, scene=None, frames=True,
        nodes=True, symbols=False, undeformed=True, magnify=2.0)),
    "plot.symbols": (tb.plot.symbols, dict(state=START, ax=None, scene=SCENE, plane="xz",
        inputs={})),
    "plot.reactions": (tb.plot.reactions, dict(state=START, ax=None, scene=SCENE, plane="xz")),
    "plot.diagram": (tb.plot.diagram, dict(state=START, resultant="M2", scene=SCENE, inputs={},
        plane=None, height=0.1, values=True, symbols=True)),
    "plot.mode_shapes": (tb.plot.mode_shapes, dict(state=START, modes=MODES, count=2)),
    "plot.orbits": (tb.plot.orbits, dict(state=START, motion=MODES.shape[0], ax=None, scale=0.1,
        plane="xz")),
    "plot.history": (tb.plot.history, dict(solution=SOLUTION, sensor=S.TipPosition())),
    "plot.energies": (tb.plot.energies, dict(solution=SOLUTION)),
    "plot.axes": (tb.plot.axes, dict(three=False)),
    "plot.save": (tb.plot.save, dict(ax=tb.plot.axes(), path=PICTURE)),
    "state.node": (START.node, dict(index=0)),
    "state[]": (lambda index: SOLUTION.state[index], dict(index=0)),
    "State.from_nodes": (tb.State.from_nodes, dict(scene=SCENE, nodes=BEAM.nodes, frames=None,
        velocity=torch.zeros(3, 3), spin=torch.zeros(3, 3), t=0.0)),
    "S.Angles": (S.Angles, dict(node=0, reference=torch.eye(3), kind="tait-bryan")),
    "S.Component": (S.Component, dict(of=S.TipPosition(), which=0)),
    "S.Curvature": (S.Curvature, dict(station=0.5, beam=BEAM)),
    "S.Gauge": (S.Gauge, dict(station=0.5, beam=BEAM, y=0.1, z=0.1)),
    "S.Strain": (S.Strain, dict(station=0.5, beam=BEAM)),
    "S.Position": (S.Position, dict(station=0.5, beam=BEAM, point=(0.0, 0.0, 0.1))),
    "S.Stress": (S.Stress, dict(element=0, beam=BEAM)),
    "S.SectionForces": (S.SectionForces, dict(scene=SCENE, inputs={})),
    "S.NodeAcceleration": (S.NodeAcceleration, dict(node=1, scene=SHAKEN, inputs={}, body=False,
        proper=None, lumped=False)),
    "S.NodePosition": (S.NodePosition, dict(node=0, reference=START)),
    "S.NodeRotation": (S.NodeRotation, dict(node=0, reference=START)),
    "S.NodeVelocity": (S.NodeVelocity, dict(node=0)),
    "S.Reaction": (S.Reaction, dict(support=0)),
    "S.RootSpringLoad": (S.RootSpringLoad, dict(scene=tb.Scene(BEAM,
        [tb.RootSpring((1e3, 20.0))]))),
    "S.TendonTension": (S.TendonTension, dict(tendon=0)),
    "S.TendonLength": (S.TendonLength, dict(tendon=0)),
    "S.JointCoordinate": (S.JointCoordinate, dict(joint=0)),
    "S.JointHysteresis": (S.JointHysteresis, dict(joint=0)),
    "S.JointLoad": (S.JointLoad, dict(joint=0)),
    "S.JointRate": (S.JointRate, dict(joint=0, component=0)),
    "S.read.Joint": (lambda joint: S.JointCoordinate(joint)(HINGED), dict(joint=0)),
    "S.Spin": (S.Spin, dict(node=0, body=False)),
    "S.Stack": (S.Stack, dict(sensors=(S.TipPosition(),))),
    "S.TipPosition": (S.TipPosition, dict(reference=START)),
    "S()": (S.TipPosition(), dict(state=START)),
    "S.read.NodePosition": (lambda node: S.NodePosition(node)(START), dict(node=1)),
    "S.read.Strain": (lambda station, beam: S.Strain(station, BEAM)(START),
        dict(station=0.5, beam=BEAM)),
    "S.read.Reaction": (lambda support: S.Reaction(support)(EQUILIBRIUM), dict(support=0)),
}
# fmt: on
