"""Bad input: one ValueError, one sentence, that says what was given and what is wanted."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import torchbeam as tb
from cases.rows import ENDS, JOINTS, ROWS

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


F32, F64 = torch.float32, torch.float64
HALF = torch.ones(1, dtype=torch.float16)


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


def loaded(function, batch=None, **more):
    """One step under a user's load."""
    scene = tb.Scene(BEAM, [tb.Load(function, **{"node": -1, **more})])
    return lambda: tb.Stepper(scene, 0.1)(tb.rest(scene, None if batch is None else (batch,)))


def stepped(*state, **options):
    return lambda: tb.Stepper(SCENE, 0.1)(*(state or (tb.rest(SCENE),)), **options)


LONGER = tb.rest(tb.Scene(tb.Beam.straight(1.0, 3, SECTION)))
# fmt: off
CASES = {
    # sections
    "negative EI": (stiffness(EI=-1.0), "EI = -1 was given; a positive or infinite number"),
    "zero EA": (stiffness(EA=0.0), "EA = 0 was given"),
    "NaN GA": (stiffness(GA=NAN), "GA = nan was given"),
    "negative in a batch": (stiffness(GJ=torch.tensor([1.0, -2.0])), "GJ = -2 was given"),
    "EI of three": (stiffness(EI=(1.0, 2.0, 3.0)),
                    "EI with 3 entries was given; one value or a pair"),
    "EA as a pair": (stiffness(EA=(1.0, 2.0)), r"EA = \(1.0, 2.0\) was given; one value"),
    "negative mass": (stiffness(mass=-0.1), "mass = -0.1 was given; a positive finite number"),
    "zero mass": (stiffness(mass=0.0), "mass = 0 was given"),
    "infinite mass": (stiffness(mass=INF), "mass = inf was given"),
    "NaN mass": (stiffness(mass=NAN), "mass = nan was given"),
    "negative inertia": (stiffness(inertia=-1.0),
                         "inertia = -1 was given; a non-negative finite number"),
    "text for EI": (stiffness(EI="stiff"), "'stiff' was given; numbers"),
    "None for EI": (stiffness(EI=None), "None was given; numbers"),
    "section shapes": (stiffness(EI=torch.ones(2), EA=torch.ones(3)),
                       r"\(2,\).*\(3,\)|\(3,\).*\(2,\)"),
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
    "negative compliance": (lambda: tb.Section(matrix((2, 2, -1.0)), torch.eye(6)),
                            "compliance = -1 was given"),
    "NaN in the mass": (lambda: tb.Section(torch.eye(6), matrix((0, 0, NAN))), "mass holds nan"),
    "indefinite mass": (lambda: tb.Section(torch.eye(6), matrix((0, 4, 2.0), (4, 0, 2.0))),
        "mass with the eigenvalue -1"),
    "numbers for matrices": (lambda: tb.Section(1.0, torch.eye(6)),
                             r"compliance of shape \(\) was given"),
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
    "beam dtype": (straight(length=torch.ones(1).half()), "torch.float16 was given"),
    "one node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0]], SECTION), r"nodes of shape \(1, 3\)"),
    "double node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [0, 0, 0]], SECTION),
        "distance of neighbouring nodes = 0"),
    "flat nodes": (lambda: tb.Beam.from_nodes([[0.0, 0], [1, 0]], SECTION),
                   r"nodes of shape \(2, 2\)"),
    "NaN node": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [NAN, 0, 0]], SECTION),
                 "nodes holds nan"),
    "frames off the chord": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [0, 1, 0]], SECTION,
                                                        torch.eye(3)[None]),
        "leaves the chord"),
    "frames that stretch": (
        lambda: tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], SECTION,
                                   torch.diag(torch.tensor([1.0, 2, 1]))[None]),
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
    "text load": (lambda: tb.TipLoad(force="up"), "'up' was given; numbers"),
    "input of two": (lambda: tb.TipLoad(force=tb.Input("u", 2)),
                     "Input of size 2 was given; size 3"),
    "input of none": (lambda: tb.Input("u", 0), "size = 0 was given"),
    "tip load elsewhere": (lambda: tb.TipLoad(force=(0, 0, 1.0), node=2), "TipLoad with node = 2"),
    "node between": (lambda: tb.PointLoad(force=(0, 0, 1.0), node=0.5), "node = 0.5 was given"),
    "no beam": (lambda: tb.Scene("beam"), "beam of type str was given"),
    "not an effect": (lambda: tb.Scene(BEAM, [1.0]), "1.0 was given, which is not an effect"),
    "a class for an effect": (lambda: tb.Scene(BEAM, [tb.Gravity]), "which is not an effect"),
    "unknown node": (lambda: tb.Scene(BEAM, [tb.PointLoad(force=(0, 0, 1.0), node=3)]),
        "node = 3 was given for a beam with the nodes 0 to 2"),
    "two dampings": (lambda: tb.Scene(BEAM, [tb.Damping(0.1), tb.Damping(0.2)]),
                     "2 dampings were given"),
    "inputs that differ": (
        lambda: tb.Scene(BEAM,
                         [tb.TipLoad(force=tb.Input("u", 3)),
                          replace(tb.Gravity((0, 0, 1.0)), g=tb.Input("u", 4))]),
        "size"),
    "load dtype": (lambda: tb.TipLoad(force=torch.ones(3).half()), "torch.float16 was given"),
    "half precision": (lambda: tb.Section(torch.eye(6).half(), torch.eye(6).half()),
        "torch.float16 was given; torch.float32 or torch.float64 is wanted"),
    "bfloat16 stiffness": (stiffness(EI=torch.ones((), dtype=torch.bfloat16)),
                           "torch.bfloat16 was given"),
    "complex stiffness": (stiffness(EI=torch.ones(2, dtype=torch.complex128)),
                          "torch.complex128 was given"),
    "half precision in a scene": (lambda: tb.Scene(replace(BEAM, nodes=BEAM.nodes.half())),
                                  "torch.float16 was given"),
    "load batch": (lambda: tb.Scene(tb.Beam.straight(torch.ones(2), 2, SECTION),
                                    [tb.TipLoad(force=torch.ones(3, 3))]),
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
    "unknown option": (simulate(options={}),
                       "the option 'options' was given; method 'midpoint' has step"),
    "unknown option of dopri5": (simulate(method="dopri5", step=0.1),
        "the option 'step' was given; method 'dopri5' has rtol"),
    "unknown option of torchdiffeq": (simulate(method="rk4", options={"step": 0.1}),
        "the option 'step' was given; torchdiffeq's 'rk4' has grid_constructor, interp, "
        "perturb, step_size"),
    "options as a list": (simulate(method="rk4", options=[1]),
                          "options of type list was given; a dictionary"),
    "rtol as text": (simulate(method="dopri5", rtol="x"),
                     "rtol = 'x' was given; a non-negative finite number"),
    "negative atol": (simulate(form="minimal", atol=-1.0), "atol = -1.0 was given"),
    "inputs as a list": (simulate(DRIVEN, inputs=[1]),
                         "inputs of type list was given; a dictionary of values by name"),
    "an input twice": (lambda: tb.rollout(tb.Stepper(DRIVEN, 0.1), tb.rest(DRIVEN), 2,
                                          {"u": (0, 0, 1.0)}, u=(0, 0, 1.0)),
        "the input 'u' was given twice"),
    "input's axes": (simulate(BATCH, inputs={"u": lambda t: torch.ones(3, 3)}),
        r"a scene and inputs with the batch axes \(2,\) and \(3,\) were given; axes that "
        r"broadcast"),
    "input's axes in the minimal form": (simulate(BATCH, inputs={"u": torch.ones(3, 3)},
                                                  form="minimal"), r"\(2,\) and \(3,\)"),
    "initial's axes": (simulate(tb.Scene(BATCH.beam), initial=tb.rest(SCENE, (3,))),
                       "a scene and an initial state with"),
    "initial of another kind": (simulate(initial=1.0), "initial of type float"),
    "initial of another mesh": (simulate(initial=tb.rest(tb.Scene(tb.Beam.straight(1.0, 3,
                                                                                   SECTION)))),
        "initial with 4 nodes was given; the beam has 3"),
    "mixed initial of another mesh": (
        simulate(initial=tb.consistent_state(tb.Scene(tb.Beam.straight(1.0, 3, SECTION))),
                 form="minimal"),
        "initial with 3 elements was given; the beam has 2"),
    "missing input": (simulate(DRIVEN), "input 'u' is missing"),
    "supports in a mixed form": (
        simulate(tb.Scene(BEAM, supports=(tb.Support(0), tb.Support(-1, rotation=""))),
                 form="minimal"),
        "supports other than a clamp at node 0 alone were given for form='minimal'"),
    "free in a mixed form": (simulate(tb.Scene(BEAM, supports=()), form="block_rate"),
                             "supports other than a clamp at node 0"),
    "small in a mixed form": (simulate(tb.Scene(BEAM, small=True), form="minimal"),
                              "small=True was given for form='minimal'"),
    "added mass in a mixed form": (simulate(tb.Scene(BEAM, [tb.Drag(1.0, 0.1, added_mass=1.0)]),
                                            form="minimal"),
        "added mass was given for form='minimal'"),
    "unknown input": (simulate(inputs={"w": (0, 0, 1.0)}),
                      "input 'w' was given; the scene has none"),
    "input's shape": (simulate(DRIVEN, inputs={"u": (0, 1.0)}), r"input 'u' of shape \(2,\)"),
    "scene of another kind": (simulate(BEAM), "scene of type Beam was given; a torchbeam.Scene"),
    "load function's value": (simulate(tb.Scene(BEAM, [tb.TipLoad(force=lambda t: t)])),
        "load function's value of shape"),
    "explicit without rotary inertia": (simulate(tb.Scene(tb.Beam.straight(1.0, 2,
        stiffness(inertia=0.0)())), method="dopri5"),
        "without rotary inertia"),
    "explicit with infinite stiffness": (simulate(tb.Scene(tb.Beam.straight(1.0, 2,
        stiffness(EA=INF)())), method="dopri5"),
        "infinite stiffness"),
    "nodal with an offset": (
        simulate(tb.Scene(tb.Beam.straight(1.0, 2,
                                           tb.Section(torch.eye(6),
                                                      matrix((1, 5, 0.1), (5, 1, 0.1)))))),
        "offset centre of mass"),
    # stepper and statics
    "stepper's method": (lambda: tb.Stepper(SCENE, 0.1, method="dopri5"),
                         "method = 'dopri5' was given; 'midpoint'"),
    "stepper's step": (lambda: tb.Stepper(SCENE, NAN), "dt = nan was given"),
    "stepper's scene": (lambda: tb.Stepper(BEAM, 0.1),
                        "scene of type Beam was given; a torchbeam.Scene"),
    "no iterations": (simulate(iterations=0),
                      "iterations = 0 was given; a whole number of at least 1"),
    "negative halvings": (simulate(halvings=-1), "halvings = -1 was given"),
    "tolerance as text": (lambda: tb.Stepper(SCENE, 0.1, tolerance="x"),
                          "tolerance = 'x' was given; a positive finite number"),
    "negative tolerance": (lambda: tb.equilibrium(SCENE, tolerance=-1.0),
                           "tolerance = -1.0 was given"),
    "tolerance of a path": (lambda: tb.path(SCENE, tolerance="x"), "tolerance = 'x' was given"),
    "rho_inf as text": (lambda: tb.Stepper(SCENE, 0.1, "generalized_alpha", rho_inf="x"),
                        "rho_inf = 'x' was given"),
    "stepper's input axes": (lambda: tb.Stepper(DRIVEN, 0.1)(tb.rest(DRIVEN, (2,)),
                                                             u=torch.ones(3, 3)),
        r"a scene, a state and inputs with the batch axes \(2,\) and \(3,\) were given"),
    "static input's axes": (lambda: tb.equilibrium(BATCH, inputs={"u": torch.ones(3, 3)}),
                            r"\(2,\) and \(3,\)"),
    "stepper's input missing": (step(), "input 'u' is missing; inputs={'u': 3 numbers} is wanted"),
    "stepper's unknown input": (step(u=(0, 0, 1.0), w=(0, 0, 1.0)),
                                "input 'w' was given; the scene has u"),
    "stepper's input shape": (step(u=1.0), r"input 'u' of shape \(\)"),
    "static input missing": (lambda: tb.equilibrium(DRIVEN), "input 'u' is missing"),
    "static scene": (lambda: tb.equilibrium(BEAM),
                     "scene of type Beam was given; a torchbeam.Scene"),
    "static initial": (lambda: tb.equilibrium(SCENE, initial=tb.consistent_state(SCENE)),
                       "initial of type MixedState"),
    "static initial of another mesh": (
        lambda: tb.equilibrium(SCENE, initial=tb.rest(tb.Scene(tb.Beam.straight(1.0, 3, SECTION)))),
        "initial with 4 nodes"),
    # supports, planes
    "support's letters": (lambda: tb.Support(0, position="xw"),
                          "position = 'xw' was given; some of the letters x, y and z"),
    "support about one axis": (lambda: tb.Scene(BEAM, supports=tb.Support(0, rotation="x")),
                               "rotation = 'x' was given in space"),
    "support's node": (lambda: tb.Scene(BEAM, supports=tb.Support(7)),
                       "the node of a support = 7 was given for a beam with"),
    "two supports of a node": (lambda: tb.Scene(BEAM, supports=(tb.Support(0), tb.Support(0))),
                               "two supports of node 0"),
    "motion of what is free": (lambda: tb.Support(0, position="", displacement=lambda t: t),
                               "whose position is free"),
    "turn of a hinge": (lambda: tb.Support(0, rotation="xz", turn=lambda t: t),
                        "rotation = 'xyz' is wanted"),
    "root without a clamp": (lambda: tb.Scene(BEAM, supports=(),
                                              root=tb.RootMotion(rotation=lambda t: t)),
                             "one clamp with"),
    "root spring in a clamp": (lambda: tb.Scene(BEAM, [tb.RootSpring((1.0, 1.0))],
                                                supports=tb.Support(0)),
        "a RootSpring and a support that clamps or moves node 0 were given"),
    "plane": (lambda: tb.Scene(BEAM, plane="yz"),
              "plane = 'yz' was given; None, 'xy', 'xz', 'auto' are there"),
    "load out of the plane": (lambda: tb.Stepper(tb.Scene(BEAM, [tb.TipLoad(force=(0, 1.0, 0))],
                                                          plane="xz"), 0.1),
        "TipLoad out of the plane 'xz' was given"),
    "beam out of the plane": (
        lambda: tb.Stepper(tb.Scene(tb.Beam.straight(1.0, 2, SECTION, direction=(1, 1, 1.0)),
                                    plane="xz"), 0.1),
        "nodes out of the plane 'xz' were given"),
    "small and follower": (
        lambda: tb.Stepper(tb.Scene(BEAM, [tb.TipLoad(force=(0, 1.0, 0), follower=True)],
                                    small=True), 0.1),
        "small=True with TipLoad was given, whose load turns"),
    "conserve in a moving frame": (
        lambda: tb.Stepper(tb.Scene(BEAM, frame=tb.Frame(velocity=(1.0, 0, 0))), 0.1,
                           conserve=True), "conserve with a frame"),
    "generalized_alpha in a frame": (
        lambda: tb.Stepper(tb.Scene(BEAM, frame=tb.Frame(velocity=(1.0, 0, 0))), 0.1,
                           "generalized_alpha"), "a moving frame"),
    # numbers that are none, and of two kinds
    "boolean stiffness": (stiffness(EI=True), "True was given; numbers or a tensor are wanted"),
    "booleans in a load": (lambda: tb.TipLoad(force=(True, 0, 0)),
                           r"\(True, 0, 0\) was given; numbers"),
    "complex load": (lambda: tb.TipLoad(force=torch.ones(3) * 1j),
                     "torch.complex128 was given; real numbers"),
    "complex motion": (lambda: tb.Frame(velocity=torch.ones(3) * 1j),
                       "torch.complex128 was given; real numbers"),
    "ragged motion": (lambda: tb.Frame(velocity=[[1.0, 2.0], [3.0]]),
                      "was given; numbers or a tensor are wanted"),
    "nothing for a length": (straight(length=[]), r"\[\] was given; numbers"),
    "a load of NumPy's dtype": (lambda: tb.TipLoad(force=np.ones(3, np.float16)),
                                "torch.float16 was given"),
    "half precision of NumPy": (stiffness(EI=np.float16(1.0)), "torch.float16 was given"),
    "extended precision of NumPy": (stiffness(EI=np.longdouble(1.0)),
                                    "was given; torch.float32 or torch.float64 is wanted"),
    # words where True or False belongs
    "follower as text": (lambda: tb.TipLoad(force=(0, 0, 1.0), follower="no"),
                         "follower = 'no' was given; True or False"),
    "small as text": (lambda: tb.Scene(BEAM, small="no"), "small = 'no' was given; True or False"),
    "conserve as a number": (lambda: tb.Stepper(SCENE, 0.1, conserve=1),
                             "conserve = 1 was given; True or False"),
    "lumped as text": (lambda: tb.modes(SCENE, lumped="no"),
                       "lumped = 'no' was given; True or False"),
    "checkpoint as text": (simulate(checkpoint="no"), "checkpoint = 'no' was given; True or False"),
    "throw as text": (lambda: tb.equilibrium(SCENE, throw="no"),
                      "throw = 'no' was given; True or False"),
    "adjoint as text": (simulate(method="dopri5", adjoint="no"),
                        "adjoint = 'no' was given; True or False"),
    "project as text": (simulate(form="block_rate", project="no"),
                        "project = 'no' was given; True or False"),
    "six as text": (lambda: tb.Damping(0.1, six="no"), "six = 'no' was given; True or False"),
    "body as text": (lambda: tb.sensors.Spin(0, body="no"), "body = 'no' was given; True or False"),
    # times
    "static time": (lambda: tb.equilibrium(SCENE, t=NAN), "t holds nan; finite numbers"),
    "times of modes": (lambda: tb.modes(SCENE, t=[0.0, 1.0]),
                       r"t of shape \(2,\) was given; one instant"),
    "time of a linear model": (lambda: tb.linearize(SCENE, t=NAN), "t holds nan"),
    "time of a block rate": (lambda: tb.block_rate(SCENE, tb.consistent_state(SCENE), t=INF),
                             "t holds inf"),
    "time of a path": (lambda: tb.path(SCENE, t=NAN), "t holds nan"),
    "a path's highest factor": (lambda: tb.path(SCENE, NAN),
                                "highest = nan was given; one finite number"),
    "a critical load's highest factor": (lambda: tb.critical_load(DRIVEN, "x",
                                                                  inputs={"u": (0, 0, 1.0)}),
        "'x' was given; numbers"),
    # shapes that no body has, axes that are none
    "a point mass above the triangle": (lambda: tb.PointMass(1.0, inertia=(1.0, 1.0, 3.0)),
                                        "above the sum of the two others"),
    "a section above the triangle": (lambda: tb.Section(torch.eye(6), matrix((3, 3, 3.0))),
                                     "above the sum of the two others"),
    "left-handed frames": (lambda: tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], SECTION,
        torch.diag(torch.tensor([1.0, -1, 1]))[None]), "frames with left-handed axes were given"),
    "a left-handed reference": (lambda: tb.sensors.NodeRotation(0,
        torch.diag(torch.tensor([1.0, -1, 1]))),
        "reference with left-handed axes were given"),
    "a user's load of another dtype": (lambda: tb.Scene(BEAM,
        [tb.Load(lambda *x, c: (c, None), node=-1, values={"c": HALF})]),
         r"^torch\.float16 was given"),
    "an acceleration on a pin that is shaken": (lambda: tb.sensors.NodeAcceleration(-1,
        tb.Scene(BEAM, supports=[tb.Support(
        0, rotation="", displacement=lambda t: torch.stack((t, 0 * t, 0 * t)))])),
        "a support that is no clamp, of a beam whose root or frame moves, was given to "
        "NodeAcceleration"),
    "an arc of more than a turn": (lambda: tb.Beam.arc(1.0, 6.3, 2, SECTION),
                                   "angle = 6.3 was given; an arc of up to 2 pi"),
    # functions, and what they return
    "added mass in a flow by a function": (lambda: tb.Drag(1.0, 0.1, flow=lambda x, t: x,
                                                           added_mass=1.0),
        "an added mass in a flow that is a function or an Input was given"),
    "added mass in a flow by an input": (lambda: tb.Drag(1.0, 0.1, flow=tb.Input("v", 3),
                                                         added_mass=1.0),
        "an added mass in a flow that is a function or an Input was given"),
    "a flow by an input of two": (lambda: tb.Drag(1.0, 0.1, flow=tb.Input("v", 2)),
                                  "Drag's flow with an Input of size 2 was given; size 3 is"),
    "a row too many": (lambda: tb.Scene(BEAM, [tb.LineLoad(force=tb.PerElement(torch.ones(3, 3)))]),
        r"PerElement of shape \(3, 3\) was given; \(..., 2, 3\) is wanted"),
    "a row too many in time": (simulate(tb.Scene(BEAM,
        [tb.LineLoad(force=tb.PerElement(lambda t: torch.ones(3, 3) * t))])),
        r"PerElement of shape \(3, 3\) was given"),
    "a row too few": (lambda: tb.Scene(BEAM,
                                       [tb.Actuation(curvature=tb.PerElement(torch.ones(1, 3)))]),
        r"PerElement of shape \(1, 3\) was given"),
    "boolean elements": (lambda: tb.Actuation(curvature=(0, 0, 1.0), elements=[True, False]),
                         "an element = True was given"),
    "elements between": (lambda: tb.Actuation(curvature=(0, 0, 1.0), elements=0.5),
                         "an element = 0.5 was given; a whole"),
    "a load that returns nothing": (loaded(lambda r, R, v, w, t: (None, None)),
        r"returns \(None, None\) was given; \(force, moment\)"),
    "a load that returns a tensor": (loaded(lambda r, R, v, w, t: -v),
                                     r"was given; \(force, moment\) is wanted"),
    "a load that returns a number": (loaded(lambda r, R, v, w, t: (1.0, None)),
        r"returns 1.0 was given; tensors \(..., 3\)"),
    "a load of another size": (loaded(lambda r, R, v, w, t: (v[..., :2], None)),
        r"value of shape \(2,\) was given; \(..., 3\)"),
    "a load of another batch": (loaded(lambda r, R, v, w, t: (torch.ones(3, 3), None), batch=2),
        r"\(3,\).*\(2,\)|\(2,\).*\(3,\)"),
    "a rate of another size": (loaded(lag, internal=3, rate=lambda z, r, R, v, w, t: z[..., :2]),
        "a Load's rate's value of shape"),
    "a rate that is no function": (lambda: tb.Load(lag, node=-1, internal=3, rate=1.0),
                                   "rate = 1.0 was given; a function"),
    "progress that is no function": (simulate(progress=1.0),
                                     "progress = 1.0 was given; a function"),
    "an input without a name": (lambda: tb.Input(None, 3), "an Input with the name None was given"),
    "a law that returns one number": (lambda: tb.monte_carlo(lambda x: x, {"EI": lambda u: 1.0}, 4),
        "a law of 'EI' that gave a float"),
    # objects of another kind
    "frame of another kind": (lambda: tb.Scene(BEAM, frame=(1.0, 0, 0)),
                              "frame of type tuple was given; a torchbeam.Frame"),
    "root of another kind": (lambda: tb.Scene(BEAM, root=1.0),
                             "root of type float was given; a torchbeam.RootMotion"),
    "one support of another kind": (lambda: tb.Scene(BEAM, supports=1.0),
                                    "1.0 was given as a support"),
    "stations without sections": (lambda: tb.Stations([0.0, 1.0], 1.0),
                                  "a section of type float was given"),
    "block rate of a beam": (lambda: tb.block_rate(BEAM, None), "a scene of type Beam was given"),
    "consistent state of a beam": (lambda: tb.consistent_state(BEAM),
                                   "a scene of type Beam was given"),
    "explicit steps of a beam": (lambda: tb.ExplicitStepper(BEAM, 0.1),
                                 "a scene of type Beam was given"),
    "a list for a method": (simulate(method=["midpoint"]),
                            r"method = \['midpoint'\] was given; there are"),
    "an array for a plane": (lambda: tb.Scene(BEAM, plane=np.ones(3)),
                             "was given; None, 'xy', 'xz', 'auto' are there"),
    "sensors that are none": (lambda: tb.linearize(SCENE, outputs=1.0),
                              "a sensor = 1.0 was given; a function"),
    "departure of a state of another mesh": (lambda: tb.linearize(SCENE).departure(LONGER),
        "a state with 4 nodes was given; the beam has 3"),
    # what a stepper is given
    "no state": (stepped(None),
                 "a state of type NoneType was given; a torchbeam.State, of the nodal form, is"),
    "a state of another form": (stepped(tb.consistent_state(SCENE)),
                                "a state of type MixedState was given"),
    "a state of another mesh": (stepped(LONGER), "a state with 4 nodes was given; the beam has 3"),
    "a state whose velocity is a node short": (stepped(replace(tb.rest(SCENE),
                                                               velocity=torch.zeros(2, 3))),
        r"a state whose velocity is of shape \(2, 3\) was given; \(..., 3, 3\) is wanted"),
    "a state whose stress is an element short": (stepped(replace(tb.rest(SCENE),
                                                                 stress=torch.zeros(1, 6))),
        r"a state whose stress is of shape \(1, 6\)"),
    "a step of no length": (stepped(dt=0.0),
                            "dt = 0.0 was given; a positive finite number of seconds"),
    "a step back": (stepped(dt=torch.tensor(-1.0)), "dt = -1 was given; a positive finite number"),
    "a step of NaN": (stepped(dt=torch.tensor(NAN)), "dt = nan was given"),
    "active of three for two": (stepped(tb.rest(SCENE, (2,)),
                                        active=torch.ones(3, dtype=torch.bool)),
                                r"\(3,\) and \(2,\)"),
    "active with more axes": (stepped(active=torch.ones(2, dtype=torch.bool)),
        r"active of shape \(2,\) was given for samples of shape \(\)"),
    "active of numbers": (stepped(active=torch.ones(())),
                          "active of torch.float64 was given; booleans"),
    "active as text": (stepped(active="all"), "active = 'all' was given; booleans"),
}
# fmt: on


@pytest.mark.parametrize("case", CASES)
def test_one_sentence(case):
    call, wanted = CASES[case]
    with pytest.raises(ValueError, match=wanted) as caught:
        call()
    sentence = str(caught.value)
    assert "\n" not in sentence and len(sentence) < 250


# fmt: off
MALFORMED = {"boolean": True, "text": "x", "complex": 1j, "object": object(), "dictionary": {},
        "ragged": [[1.0, 2.0], [3.0], [4.0]],
             "nothing": [], "booleans": torch.tensor([True, False, True]),
             "complex tensor": torch.ones(3) * 1j,
             "NaN": math.nan, "objects": np.array([None, 1], dtype=object)}
# fmt: on
# of effects and joints: what makes one of a value, whose row says what that may be
MADE = {name: (row, lambda x, row=row: row.make(x, 2)) for name, row in ROWS.items()}
MADE |= {name: (row, lambda x, row=row: row.make(x, *ENDS)) for name, row in JOINTS.items()}
MADE = {name: one for name, one in MADE.items() if one[0].draw is not None}
# fmt: off
VALUES = {  # of every kind of argument that wants numbers: one call each
    **{name: make for name, (_, make) in MADE.items() if not name.endswith(".at")},
    "EI": lambda x: stiffness(EI=x)(), "compliance": lambda x: tb.Section(x, torch.eye(6)),
    "radius": lambda x: tb.Section.circle(x, 1.0, 0.3, 1.0), "angle": SECTION.rotated,
    "y": lambda x: SECTION.shifted(y=x),
    "length": lambda x: straight(length=x)(), "elements": lambda x: straight(elements=x)(),
    "direction": lambda x: straight(direction=x)(), "twist": lambda x: straight(twist=x)(),
    "curvature": lambda x: tb.Beam.curve(1.0, 2, SECTION, x),
    "nodes": lambda x: tb.Beam.from_nodes(x, SECTION),
    "velocity": lambda x: tb.Frame(velocity=x),
    "displacement": lambda x: tb.Support(0, displacement=x),
    "node": lambda x: tb.Scene(BEAM, [tb.PointLoad(node=x, force=(0, 0, 1.0))]),
    "per element": tb.PerElement,
    "actuated elements": lambda x: tb.Actuation(curvature=(0, 0, 1.0), elements=x),
    "frequencies": lambda x: tb.rayleigh(x, (0.1, 0.1)), "point mass": tb.PointMass,
    "size": lambda x: tb.Input("u", x),
    "history": lambda x: tb.History([0.0, 1.0], x),
    "stations": lambda x: tb.Stations(x, [SECTION] * 2),
    "times": lambda x: tb.simulate(SCENE, x), "step": lambda x: simulate(step=x)(),
    "dt": lambda x: tb.Stepper(SCENE, x),
    "one dt": lambda x: stepped(dt=x)(), "input": lambda x: step(u=x)(),
    "static time": lambda x: tb.equilibrium(SCENE, t=x),
    "frequency": lambda x: tb.linearize(SCENE).response(x),
    "gauge": lambda x: tb.sensors.Gauge(0.5, BEAM, y=x),
    "reference": lambda x: tb.sensors.NodePosition(0, x),
}
# fmt: on


@pytest.mark.parametrize("value", VALUES)
def test_every_number_is_one(value):
    """Whatever is no real number is refused in one sentence, wherever numbers are wanted."""
    for name, malformed in MALFORMED.items():
        if (value, name) == ("input", "NaN"):
            continue  # of a sample that has failed
        with pytest.raises(ValueError) as caught:
            VALUES[value](malformed)
            pytest.fail(f"{name} was accepted")
        sentence = str(caught.value)
        assert "given" in sentence or "holds" in sentence, sentence
        assert "\n" not in sentence and len(sentence) < 250


@pytest.mark.parametrize("name", MADE)
def test_what_a_value_may_not_be(name):
    """Of effects and joints: not a number, infinite, or below zero where that is the least."""
    row, make = MADE[name]
    value = torch.as_tensor(row.draw, dtype=F64)
    bad = {"nan": torch.full_like(value, NAN), "inf": torch.full_like(value, INF)}
    if row.at_zero and row.at_zero.get("least"):
        bad["-"] = -value
    for said, x in bad.items():
        with pytest.raises(ValueError, match=rf"(holds|=|moment) {said}.*; .*(wanted|none)"):
            make(x)


@pytest.mark.parametrize("default", [F32, F64])
def test_numbers_are_taken_to_double(default):
    """NumPy's, Python's, torch's of either precision, whatever torch's default is."""
    before = torch.get_default_dtype()
    try:
        torch.set_default_dtype(default)
        for one in (1.0, 1, np.float32(1), np.float64(1), np.int64(1), torch.ones((), dtype=F32)):
            assert tb.Section.from_stiffness(**{**GOOD, "EI": one}).compliance.dtype == F64
            assert tb.Beam.straight(one, 2, SECTION).nodes.dtype == F64
        assert tb.History(np.array([0.0, 1.0]), np.zeros((2, 3), np.float32)).values.dtype == F64
    finally:
        torch.set_default_dtype(before)
    given = np.array([0.0, 0.0, 1.0])
    load = tb.TipLoad(force=given)
    given[:] = 7.0
    assert torch.equal(load.force, torch.tensor([0.0, 0.0, 1.0], dtype=F64))
