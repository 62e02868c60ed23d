"""Bad input: one ValueError, one sentence, that says what was given and what is wanted."""

import math
from dataclasses import replace

import pytest
import torch

import torchbeam as tb

NAN, INF = math.nan, math.inf
GOOD = dict(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
SECTION = tb.Section.from_stiffness(**GOOD)
BEAM = tb.Beam.straight(1.0, 2, SECTION)
SCENE = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 1.0))])
DRIVEN = tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3))])
BATCH = tb.Scene(tb.Beam.straight(torch.ones(2), 2, SECTION), [tb.TipLoad(force=tb.Input("u", 3))])
T = [0.0, 0.1]


def lag(r, R, v, w, t, z):
    return -z - v, None


LAGGED = tb.Scene(BEAM, [tb.Load(lag, internal=3, rate=lambda z, r, R, v, w, t: -z - v)])
F32, F64 = torch.float32, torch.float64


def stiffness(**changed):
    return lambda: tb.Section.from_stiffness(**{**GOOD, **changed})


def matrix(*entries):
    """The identity with entries (row, column, value) changed."""
    m = torch.eye(6)
    for i, j, value in entries:
        m[i, j] = value
    return m


def straight(**changed):
    return lambda: tb.Beam.straight(**{**dict(length=1.0, elements=2, section=SECTION), **changed})


def simulate(scene=SCENE, t=T, *rest, **options):
    return lambda: tb.simulate(scene, t, *rest, **options)


def step(scene=DRIVEN, **inputs):
    stepper = tb.Stepper(scene, 0.1)
    return lambda: stepper(stepper.rest(), **inputs)


CASES = {
    # sections
    "negative EI": (stiffness(EI=-1.0), "EI = -1 was given; a positive or infinite number"),
    "zero EA": (stiffness(EA=0.0), "EA = 0 was given"),
    "NaN GA": (stiffness(GA=NAN), "GA = nan was given"),
    "negative in a batch": (stiffness(GJ=torch.tensor([1.0, -2.0])), "GJ = -2 was given"),
    "EI of three": (stiffness(EI=(1.0, 2.0, 3.0)), "EI with 3 entries was given; one value or a pair"),
    "EA as a pair": (stiffness(EA=(1.0, 2.0)), r"EA = \(1.0, 2.0\) was given; one value"),
    "negative mass": (stiffness(mass=-0.1), "mass = -0.1 was given; a positive finite number"),
    "zero mass": (stiffness(mass=0.0), "mass = 0 was given"),
    "infinite mass": (stiffness(mass=INF), "mass = inf was given"),
    "NaN mass": (stiffness(mass=NAN), "mass = nan was given"),
    "negative inertia": (stiffness(inertia=-1.0), "inertia = -1 was given; a non-negative finite number"),
    "text for EI": (stiffness(EI="stiff"), "'stiff' was given; numbers"),
    "None for EI": (stiffness(EI=None), "None was given; numbers"),
    "section dtypes": (stiffness(EI=torch.ones(2, dtype=F32), EA=torch.ones(2, dtype=F64)),
        "float64 and torch.float32|float32 and torch.float64"),
    "section shapes": (stiffness(EI=torch.ones(2), EA=torch.ones(3)), r"\(2,\).*\(3,\)|\(3,\).*\(2,\)"),
    "negative radius": (lambda: tb.Section.circle(-0.1, 1.0, 0.3, 1.0), "radius = -0.1 was given"),
    "zero width": (lambda: tb.Section.rectangle(0.0, 0.1, 1.0, 0.3, 1.0), "width = 0 was given"),
    "nu above a half": (lambda: tb.Section.circle(0.1, 1.0, 0.6, 1.0), "nu = 0.6 was given"),
    "NaN density": (lambda: tb.Section.circle(0.1, 1.0, 0.3, NAN), "rho = nan was given"),
    "compliance shape": (lambda: tb.Section(torch.eye(3), torch.eye(6)),
        r"compliance of shape \(3, 3\) was given; \(..., 6, 6\)"),
    "asymmetric compliance": (lambda: tb.Section(matrix((0, 1, 0.1)), torch.eye(6)),
        "compliance that is not symmetric"),
    "indefinite compliance": (lambda: tb.Section(matrix((0, 1, 2.0), (1, 0, 2.0)), torch.eye(6)),
        "compliance with the eigenvalue -1"),
    "negative compliance": (lambda: tb.Section(matrix((2, 2, -1.0)), torch.eye(6)), "compliance = -1 was given"),
    "NaN in the mass": (lambda: tb.Section(torch.eye(6), matrix((0, 0, NAN))), "mass holds nan"),
    "indefinite mass": (lambda: tb.Section(torch.eye(6), matrix((0, 4, 2.0), (4, 0, 2.0))),
        "mass with the eigenvalue -1"),
    "numbers for matrices": (lambda: tb.Section(1.0, torch.eye(6)), r"compliance of shape \(\) was given"),
    # beams
    "negative length": (straight(length=-1.0), "length = -1 was given; a positive finite number"),
    "NaN length": (straight(length=NAN), "length = nan was given"),
    "infinite length": (straight(length=INF), "length = inf was given"),
    "no elements": (straight(elements=0), "elements = 0 was given; a whole number of at least 1"),
    "half an element": (straight(elements=2.5), "elements = 2.5 was given"),
    "flat direction": (straight(direction=(1.0, 0.0)), r"direction of shape \(2,\) was given"),
    "no direction": (straight(direction=(0.0, 0.0, 0.0)), "length of direction = 0 was given"),
    "up along the beam": (straight(up=(2.0, 0.0, 0.0)), "up vector parallel"),
    "no up": (straight(up=(0.0, 0.0, 0.0)), "up"),
    "NaN root": (straight(root=(NAN, 0, 0)), "root holds nan"),
    "no section": (straight(section=1.0), "section of type float was given; a torchbeam.Section"),
    "three sections": (straight(section=[SECTION] * 3), "3 sections were given for 2 elements"),
    "beam dtypes": (straight(length=torch.tensor([1.0], dtype=F32)), "one dtype is wanted"),
    "one node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0]], SECTION), r"nodes of shape \(1, 3\)"),
    "double node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [0, 0, 0]], SECTION),
        "distance of neighbouring nodes = 0"),
    "flat nodes": (lambda: tb.Beam.from_nodes([[0.0, 0], [1, 0]], SECTION), r"nodes of shape \(2, 2\)"),
    "NaN node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [NAN, 0, 0]], SECTION), "nodes holds nan"),
    "frames off the chord": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [0, 1, 0]], SECTION, torch.eye(3)[None]),
        "leaves the chord"),
    "frames that stretch": (
        lambda: tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], SECTION, torch.diag(torch.tensor([1.0, 2, 1]))[None]),
        "orthonormal"),
    "frames' shape": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], SECTION, torch.eye(3)),
        r"frames of shape \(3, 3\)"),
    "negative arc": (lambda: tb.Beam.arc(-1.0, 1.0, 2, SECTION), "radius = -1 was given"),
    "zero arc": (lambda: tb.Beam.arc(1.0, 0.0, 2, SECTION), "angle = 0 was given"),
    "NaN arc direction": (lambda: tb.Beam.arc(1.0, 1.0, 2, SECTION, direction=(NAN, 0, 0)),
        "direction holds nan; finite numbers"),
    # effects
    "load of nothing": (lambda: tb.TipLoad(), "TipLoad with neither force nor moment"),
    "flat load": (lambda: tb.TipLoad(force=(1.0, 2.0)), r"TipLoad's force of shape \(2,\)"),
    "scalar load": (lambda: tb.TipLoad(force=1.0), r"TipLoad's force of shape \(\)"),
    "NaN load": (lambda: tb.LineLoad(force=(NAN, 0, 0)), "LineLoad's force holds nan"),
    "text load": (lambda: tb.TipLoad(force="up"), "'up' was given; numbers"),
    "infinite gravity": (lambda: tb.Gravity((0, 0, INF)), "Gravity's g holds inf"),
    "input of two": (lambda: tb.TipLoad(force=tb.Input("u", 2)), "Input of size 2 was given; size 3"),
    "input of none": (lambda: tb.Input("u", 0), "size = 0 was given"),
    "tip load elsewhere": (lambda: tb.TipLoad(force=(0, 0, 1.0), node=2), "TipLoad with node = 2"),
    "node between": (lambda: tb.PointLoad(force=(0, 0, 1.0), node=0.5), "node = 0.5 was given"),
    "negative tau": (lambda: tb.Damping(-0.1), "tau = -0.1 was given"),
    "NaN tau": (lambda: tb.Damping(NAN), "tau = nan was given"),
    # scenes
    "no beam": (lambda: tb.Scene("beam"), "beam of type str was given"),
    "not an effect": (lambda: tb.Scene(BEAM, [1.0]), "1.0 is not an effect"),
    "a class for an effect": (lambda: tb.Scene(BEAM, [tb.Gravity]), "is not an effect"),
    "unknown node": (lambda: tb.Scene(BEAM, [tb.PointLoad(force=(0, 0, 1.0), node=3)]),
        "node = 3 was given for a beam with the nodes 0 to 2"),
    "two dampings": (lambda: tb.Scene(BEAM, [tb.Damping(0.1), tb.Damping(0.2)]), "2 dampings were given"),
    "inputs that differ": (
        lambda: tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3)), replace(tb.Gravity((0, 0, 1.0)), g=tb.Input("u", 4))]),
        "size"),
    "load dtype": (lambda: tb.Scene(BEAM, [tb.TipLoad(force=torch.ones(3, dtype=F32))]),
        "TipLoad of dtype torch.float32 meets a beam of torch.float64"),
    "half precision": (lambda: tb.Section(torch.eye(6).half(), torch.eye(6).half()),
        "torch.float16 was given; torch.float32 or torch.float64 is wanted"),
    "bfloat16 stiffness": (stiffness(EI=torch.ones((), dtype=torch.bfloat16)), "torch.bfloat16 was given"),
    "complex stiffness": (stiffness(EI=torch.ones(2, dtype=torch.complex128)), "torch.complex128 was given"),
    "half precision in a scene": (lambda: tb.Scene(replace(BEAM, nodes=BEAM.nodes.half())), "torch.float16 was given"),
    "load batch": (lambda: tb.Scene(tb.Beam.straight(torch.ones(2), 2, SECTION), [tb.TipLoad(force=torch.ones(3, 3))]),
        r"\(2,\).*\(3,\)"),
    "flat frame": (lambda: tb.Frame(velocity=(1.0, 0.0)), r"velocity of shape \(2,\)"),
    # simulate
    "one instant": (simulate(t=[0.0]), r"t of shape \(1,\) was given"),
    "t that stands": (simulate(t=[0.0, 1.0, 1.0]), "t goes from 1 to 1; strictly increasing"),
    "t backwards": (simulate(t=[0.0, -1.0]), "t goes from 0 to -1"),
    "NaN t": (simulate(t=[0.0, NAN]), "t holds nan"),
    "unknown method": (simulate(method="magic"), "method = 'magic' was given; there are midpoint"),
    "unknown form": (simulate(form="magic"), "form = 'magic' was given; 'nodal'"),
    "negative step": (simulate(step=-0.1), "step = -0.1 was given"),
    "zero step": (simulate(step=0), "step = 0 was given"),
    "unknown option": (simulate(rtol=1e-3), "the option 'rtol' was given; method 'midpoint' has step"),
    "unknown option of dopri5": (simulate(method="dopri5", step=0.1),
        "the option 'step' was given; method 'dopri5' has rtol"),
    "unknown option of torchdiffeq": (simulate(method="rk4", options={"step": 0.1}),
        "the option 'step' was given; torchdiffeq's 'rk4' has grid_constructor, interp, perturb, step_size"),
    "options as a list": (simulate(method="rk4", options=[1]), "options of type list was given; a dictionary"),
    "rtol as text": (simulate(method="dopri5", rtol="x"), "rtol = 'x' was given; a non-negative finite number"),
    "negative atol": (simulate(form="minimal", atol=-1.0), "atol = -1.0 was given"),
    "inputs as a list": (simulate(DRIVEN, inputs=[1]), "inputs of type list was given; a dictionary of values by name"),
    "an input twice": (simulate(DRIVEN, inputs={"u": (0, 0, 1.0)}, u=(0, 0, 1.0)), "the input 'u' was given twice"),
    "input's axes": (simulate(BATCH, inputs={"u": lambda t: torch.ones(3, 3)}),
        r"a scene and inputs with the batch axes \(2,\) and \(3,\) were given; axes that broadcast"),
    "input's axes in the minimal form": (simulate(BATCH, inputs={"u": torch.ones(3, 3)}, form="minimal"), r"\(2,\) and \(3,\)"),
    "initial's axes": (simulate(tb.Scene(BATCH.beam), initial=tb.rest(SCENE, (3,))), "a scene and an initial state with"),
    "initial of another kind": (simulate(initial=1.0), "initial of type float"),
    "initial of another mesh": (simulate(initial=tb.rest(tb.Scene(tb.Beam.straight(1.0, 3, SECTION)))),
        "initial with 4 nodes was given; the beam has 3"),
    "initial dtype": (simulate(initial=tb.rest(SCENE).to(F32)),
        "initial of torch.float32 meets a scene of torch.float64"),
    "mixed initial of another mesh": (
        simulate(initial=tb.consistent_state(tb.Scene(tb.Beam.straight(1.0, 3, SECTION))), form="minimal"),
        "initial with 3 elements was given; the beam has 2"),
    "missing input": (simulate(DRIVEN), "input 'u' is missing"),
    "supports in a mixed form": (
        simulate(tb.Scene(BEAM, supports=(tb.Support(0), tb.Support(-1, rotation=""))), form="minimal"),
        "supports other than a clamp at node 0 alone were given for form='minimal'"),
    "free in a mixed form": (simulate(tb.Scene(BEAM, supports=()), form="block_rate"), "supports other than a clamp at node 0"),
    "small in a mixed form": (simulate(tb.Scene(BEAM, small=True), form="minimal"), "small=True was given for form='minimal'"),
    "added mass in a mixed form": (simulate(tb.Scene(BEAM, [tb.Drag(1.0, 0.1, added_mass=1.0)]), form="minimal"),
        "added mass was given for form='minimal'"),
    "added mass beside a mass off its node": (
        lambda: tb.Stepper(tb.Scene(BEAM, [tb.Drag(1.0, 0.1, added_mass=1.0), tb.PointMass(1.0, offset=(0, 0, 0.1))]), 0.1),
        "added mass on a beam with a mass off its node was given"),
    "unknown input": (simulate(inputs={"w": (0, 0, 1.0)}), "input 'w' was given; the scene has none"),
    "input's shape": (simulate(DRIVEN, inputs={"u": (0, 1.0)}), r"input 'u' of shape \(2,\)"),
    "scene of another kind": (simulate(BEAM), "scene of type Beam was given; a torchbeam.Scene"),
    "load function's value": (simulate(tb.Scene(BEAM, [tb.TipLoad(force=lambda t: t)])),
        "load function's value of shape"),
    "explicit without rotary inertia": (simulate(tb.Scene(tb.Beam.straight(1.0, 2, stiffness(inertia=0.0)())), method="dopri5"),
        "without rotary inertia"),
    "explicit with infinite stiffness": (simulate(tb.Scene(tb.Beam.straight(1.0, 2, stiffness(EA=INF)())), method="dopri5"),
        "infinite stiffness"),
    "nodal with an offset": (
        simulate(tb.Scene(tb.Beam.straight(1.0, 2, tb.Section(torch.eye(6), matrix((1, 5, 0.1), (5, 1, 0.1)))))),
        "offset centre of mass"),
    # stepper and statics
    "stepper's method": (lambda: tb.Stepper(SCENE, 0.1, method="dopri5"), "method = 'dopri5' was given; 'midpoint'"),
    "stepper's step": (lambda: tb.Stepper(SCENE, NAN), "dt = nan was given"),
    "stepper's scene": (lambda: tb.Stepper(BEAM, 0.1), "scene of type Beam was given; a torchbeam.Scene"),
    "no iterations": (simulate(iterations=0), "iterations = 0 was given; a whole number of at least 1"),
    "negative halvings": (simulate(halvings=-1), "halvings = -1 was given"),
    "tolerance as text": (lambda: tb.Stepper(SCENE, 0.1, tolerance="x"), "tolerance = 'x' was given; a positive finite number"),
    "negative tolerance": (lambda: tb.equilibrium(SCENE, tolerance=-1.0), "tolerance = -1.0 was given"),
    "tolerance of a path": (lambda: tb.path(SCENE, tolerance="x"), "tolerance = 'x' was given"),
    "rho_inf as text": (lambda: tb.Stepper(SCENE, 0.1, "generalized_alpha", rho_inf="x"), "rho_inf = 'x' was given"),
    "stepper's input axes": (lambda: tb.Stepper(DRIVEN, 0.1)(tb.rest(DRIVEN, (2,)), u=torch.ones(3, 3)),
        r"a scene, a state and inputs with the batch axes \(2,\) and \(3,\) were given"),
    "static input's axes": (lambda: tb.equilibrium(BATCH, u=torch.ones(3, 3)), r"\(2,\) and \(3,\)"),
    "stepper's input missing": (step(), "input 'u' is missing; the scene wants u"),
    "stepper's unknown input": (step(u=(0, 0, 1.0), w=(0, 0, 1.0)), "input 'w' was given; the scene has u"),
    "stepper's input shape": (step(u=1.0), r"input 'u' of shape \(\)"),
    "static input missing": (lambda: tb.equilibrium(DRIVEN), "input 'u' is missing"),
    "static scene": (lambda: tb.equilibrium(BEAM), "scene of type Beam was given; a torchbeam.Scene"),
    "static initial": (lambda: tb.equilibrium(SCENE, initial=tb.consistent_state(SCENE)), "initial of type MixedState"),
    "static initial of another mesh": (
        lambda: tb.equilibrium(SCENE, initial=tb.rest(tb.Scene(tb.Beam.straight(1.0, 3, SECTION)))), "initial with 4 nodes"),
    # supports, planes
    "support's letters": (lambda: tb.Support(0, position="xw"), "position = 'xw' was given; some of the letters x, y and z"),
    "support about one axis": (lambda: tb.Support(0, rotation="x"), "rotation = 'x' was given; all three components are held"),
    "support's node": (lambda: tb.Scene(BEAM, supports=tb.Support(7)), "a support of node 7 was given; the beam has the nodes"),
    "two supports of a node": (lambda: tb.Scene(BEAM, supports=(tb.Support(0), tb.Support(0))), "two supports of node 0"),
    "motion of what is free": (lambda: tb.Support(0, position="", displacement=lambda t: t), "whose position is free"),
    "turn of a hinge": (lambda: tb.Support(0, rotation="xz", turn=lambda t: t), "rotation = 'xyz' is wanted"),
    "root without a clamp": (lambda: tb.Scene(BEAM, supports=(), root=tb.RootMotion(rotation=lambda t: t)), "one clamp with"),
    "root spring in a clamp": (lambda: tb.Scene(BEAM, [tb.RootSpring((1.0, 1.0))], supports=tb.Support(0)),
        "a RootSpring and a support that holds node 0 were given"),
    "plane": (lambda: tb.Scene(BEAM, plane="yz"), "plane = 'yz' was given; None, 'xy', 'xz', 'auto' are there"),
    "load out of the plane": (lambda: tb.Stepper(tb.Scene(BEAM, [tb.TipLoad(force=(0, 1.0, 0))], plane="xz"), 0.1),
        "TipLoad out of the plane 'xz' was given"),
    "beam out of the plane": (
        lambda: tb.Stepper(tb.Scene(tb.Beam.straight(1.0, 2, SECTION, direction=(1, 1, 1.0)), plane="xz"), 0.1),
        "nodes out of the plane 'xz' were given"),
    "small and follower": (
        lambda: tb.Stepper(tb.Scene(BEAM, [tb.TipLoad(force=(0, 1.0, 0), follower=True)], small=True), 0.1),
        "small=True with TipLoad was given, whose load turns"),
    "conserve in a moving frame": (
        lambda: tb.Stepper(tb.Scene(BEAM, frame=tb.Frame(velocity=(1.0, 0, 0))), 0.1, conserve=True), "conserve with a frame"),
    "internal states along the beam": (lambda: tb.Load(lag, node=None, internal=3, rate=lag), "one Load for each node"),
    "a lag linearised": (lambda: tb.linearize(LAGGED), "Load with internal states was given to linearize"),
    "modes with a lag": (lambda: tb.modes(LAGGED), "Load with internal states was given to modes"),
    "critical load with a lag": (lambda: tb.critical_load(lambda P: LAGGED, 1.0),
        "Load with internal states was given to critical_load"),
    "generalized_alpha in a frame": (
        lambda: tb.Stepper(tb.Scene(BEAM, frame=tb.Frame(velocity=(1.0, 0, 0))), 0.1, "generalized_alpha"), "a moving frame"),
}


@pytest.mark.parametrize("case", CASES)
def test_one_sentence(case):
    call, wanted = CASES[case]
    with pytest.raises(ValueError, match=wanted) as caught:
        call()
    sentence = str(caught.value)
    assert "\n" not in sentence and len(sentence) < 250
