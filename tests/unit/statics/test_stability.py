"""What a warning of unstable equilibria names, under loads that are not conservative, and beside
what rests where nothing moves; and that neither this nor a path depends on units.
"""

import math
import re
import warnings
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.math import quaternions
from torchbeam.nodal.discretise import discretise
from torchbeam.statics.stability import conservative

ENGINES = "eager", "compiled"


def brake(x, R, v, w, t):
    return -0.5 * v, -0.1 * w


# each of the library's effects whose force vanishes at rest
RESTING = {
    "MassDamping": lambda node: [tb.MassDamping(2.0)],
    "MassDamping of nothing": lambda node: [tb.MassDamping(0.0)],
    "Damping": lambda node: [tb.Damping(0.01)],
    "rayleigh": lambda node: tb.rayleigh((10.0, 100.0), (0.01, 0.02)),
    "Drag": lambda node: [tb.Drag(1000.0, 0.01, tangential=0.01)],
    "Drag with added mass": lambda node: [tb.Drag(1000.0, 0.01, added_mass=1.0)],
    "Spring": lambda node: [tb.Spring(node, 0.0, to=(9.0, 0, 0), damping=1.0)],
    "Spring with a length": lambda node: [
        tb.Spring(node, 0.0, to=(9.0, 0, 0), length=1.0, damping=1.0)
    ],
    "Spring at an offset": lambda node: [
        tb.Spring(node, 0.0, to=(9.0, 0, 0), damping=1.0, offset=(0.1, 0, 0.2))
    ],
    "Load of velocity": lambda node: [tb.Load(brake, node)],
    "Load along the beam": lambda node: [tb.Load(brake, None)],
    "Load that says so": lambda node: [tb.Load(brake, node, of=("velocity", "spin"))],
    "Contact": lambda node: [
        tb.Contact(tb.Plane((0, 0, -50.0), (0, 0, 1)), thickness=0.1, force=1.0, damping=0.1)
    ],
}


def column(force, moment, frame=None, EI=(1.0, 4.0)):
    """Cantilever under dead loads (batch, 3) of its tip: the moment, in space, has no energy."""
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
    return tb.Scene(
        tb.Beam.straight(1.0, 6, section), [tb.TipLoad(force=force, moment=moment)], frame=frame
    )


def told(scene, engine="eager"):
    """The equilibria, and the warning or None."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        state = tb.equilibrium(scene, engine=engine)
    said = [str(one.message) for one in heard if issubclass(one.category, RuntimeWarning)]
    assert len(said) < 2
    return state, said[0] if said else None


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("turning", [False, True], ids=["moment", "turning frame"])
@torch.no_grad()
def test_one_motion_that_diverges(engine, turning):
    """Buckling at pi^2/4 = 2.47 N in the soft plane, 9.9 N in the stiff one: one negative pivot in
    between, where the warning names the sample; past both the determinant is positive again, and
    nothing is said where the frame turns, which may hold them; a moment that is next to nothing
    beside what is negative changes nothing.
    """
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    P = torch.tensor([1.0, 2.3, 4.0, 8.0, 15.0])
    none = torch.zeros_like(P)
    moment = torch.stack((none if turning else 1e-6 + none, none, none), -1)
    frame = tb.Frame(angular_velocity=(0.0, 0.0, 0.01)) if turning else None
    scene = column(torch.stack((-P, none, none), -1), moment, frame)
    state, said = told(scene, engine)
    assert re.search(rf"sample 2 \({2 if turning else 3} of 5\) is in unstable equilibrium", said)
    assert tb.modes(scene, state, count=3).divergence.any(-1).tolist() == [
        False, False, True, True, True,
    ]  # fmt: skip


@torch.no_grad()
def test_who_is_named_diverges():
    """Bent columns under dead moments in space, named alone where an odd number of its modes
    diverge, nowhere else.
    """
    generator = torch.Generator().manual_seed(5)
    P, M = 6 * torch.rand(12, generator=generator), 0.6 * torch.randn(12, 3, generator=generator)
    force = torch.stack((-P, 0 * P, 0 * P), -1)
    bent = column(force, M)
    diverging = tb.modes(bent, told(bent)[0], count=4).divergence.sum(-1)
    named = [told(column(f, m))[1] is not None for f, m in zip(force, M, strict=True)]
    assert named == (diverging % 2 == 1).tolist() and 0 < sum(named) < 12


HAIRS = {
    "follower moment": lambda: tb.TipLoad(moment=(0, 1e-9, 1e-9), follower=True),
    "moment in space": lambda: tb.TipLoad(moment=(1e-9, 0, 0)),
    "follower force": lambda: tb.PointLoad(2, force=(0, 1e-9, 1e-9), follower=True),
    "swirl": lambda: tb.Load(lambda x, R, v, w, t: (1e-9 * x.flip(-1) * x, None), node=-1),
}


@pytest.mark.parametrize("hair", HAIRS)
@torch.no_grad()
def test_a_hair_of_asymmetry_changes_no_verdict(hair):
    """Round and flat columns under 0.4 to 12 times Euler's load of the soft plane: named alike
    beside a load without an energy that is next to nothing; of the round ones an even number of
    pivots is negative.
    """
    P = torch.tensor([1.0, 2.3, 3.95, 15.0, 30.0])
    for EI in ((1.0, 1.0), (1.0, 4.0)):
        plain = column(torch.stack((-P, 0 * P, 1e-4 * P), -1), None, EI=EI)
        verdict = told(plain)[1]
        beside = tb.Scene(plain.beam, [*plain.effects, HAIRS[hair]()])
        assert told(beside)[1] == verdict and "sample 2 (3 of 5)" in verdict


@torch.no_grad()
def test_flutter_is_no_static_instability():
    """Beck's column and Ziegler's pendulum, where a follower load has no divergence, below and
    above flutter: statics, which sees no mass, says nothing.
    """
    P = torch.tensor([5.0, 15.0, 19.0, 21.0, 25.0])
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=1.0, mass=0.2)
    for plane in ("xz", None):
        push = tb.TipLoad(force=torch.stack((-P, 0 * P, 0 * P), -1), follower=True)
        scene = tb.Scene(tb.Beam.straight(1.0, 6, section), [push], plane=plane)
        assert told(scene)[1] is None
    links = {
        "a": tb.Beam.straight(0.5, 2, section),
        "b": tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0)),
    }
    joints = [
        tb.Hinge(None, ("a", 0), axis=(0, 1, 0), stiffness=0.01),
        tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), stiffness=0.01),
    ]
    for load in (0.01, 0.05, 0.2):
        push = tb.PointLoad(("b", -1), force=(-load, 0, 0), follower=True)
        assert told(tb.Scene(links, [push], joints=joints, supports=()))[1] is None


def slack(*effects):
    """Cable in a plane, its pinned ends moved nearer to each other."""
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1e-3, EI=1e-3, mass=0.2)
    ends = tb.Support(0, rotation=""), tb.Support(-1, rotation="", displacement=(-0.2, 0, 0))
    gravity = tb.Gravity((0, 0, -9.81))
    beam = tb.Beam.straight(1.0, 4, section)
    return tb.Scene(beam, [gravity, *effects], supports=ends, plane="xz")


def strut(*effects):
    """Round column under 1.6 times Euler's load, a little eccentric: two motions diverge."""
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=1.0, mass=0.2)
    press = tb.TipLoad(force=(-3.95, 0, 1e-3))
    return tb.Scene(tb.Beam.straight(1.0, 4, section), [press, *effects])


@pytest.fixture(scope="module")
def alone():
    return (
        tb.equilibrium(slack(), relax=True),
        told(strut()),
        tb.path(strut(), branch=True, step=0.4),
    )


@pytest.mark.parametrize("name", RESTING)
@torch.no_grad()
def test_statics_do_not_see_what_rests(name, alone):
    """Equilibria by relaxation and by load steps, what is said of them, and a path with its
    bifurcations, beside an effect without a force at rest: as without it. A cable that hangs was
    a straight strut in compression, and of the column nothing was said.
    """
    hangs, (pressed, warning), way = alone
    assert hangs.nodes[2, 2] < -0.25 and "unstable" in warning
    effects = RESTING[name](2)
    beside = tb.equilibrium(slack(*effects), relax=True)
    torch.testing.assert_close(beside.position, hangs.position, rtol=0, atol=1e-7)
    state, said = told(strut(*effects))
    torch.testing.assert_close(state.position, pressed.position, rtol=0, atol=1e-9)
    assert said == warning
    path = tb.path(strut(*effects), branch=True, step=0.4)
    assert torch.equal(path.kind, way.kind) and torch.equal(path.negative, way.negative)
    torch.testing.assert_close(path.factor, way.factor, rtol=1e-6, atol=1e-9)


@torch.no_grad()
def test_loads_are_judged_by_their_tangent():
    """Loads by a function that pull into a potential's direction or across it, as a dead moment
    does in space and not in a plane: whether statics take them for conservative there.
    """
    scenes = {
        "wall": (strut(tb.Load(lambda x, R, v, w, t: (-3 * x.square() * x, None), node=-1)), True),
        "swirl": (strut(tb.Load(lambda x, R, v, w, t: (x.flip(-1) * x, None), node=-1)), False),
        "follower": (strut(tb.TipLoad(force=(0.5, 0.1, 0), follower=True)), False),
        "moment": (strut(tb.TipLoad(moment=(0, 0.1, 0))), False),
        "lever": (strut(tb.PointLoad(-1, force=(0, 0.2, 0.1), offset=(0.1, 0.2, 0.3))), True),
        "clamp": (strut(tb.RootSpring((1e3, 10.0), damping=(1.0, 1.0))), True),
    }
    flat = slack(tb.PointLoad(2, moment=(0, 1e-3, 0)))
    for name, (scene, energy) in {**scenes, "flat": (flat, True)}.items():
        model = discretise(scene)
        x = model.space.to_reduced(bent(scene))
        problem = SteadyProblem(model, x.t, {}, torch.ones_like(x.t))
        at = Configuration(x.position, x.rotation, x.stress)
        assert bool(conservative(problem, at)) is energy, name


def bent(scene):
    """Any state of it."""
    generator, start = torch.Generator().manual_seed(3), tb.rest(scene)
    flat = scene.plane is not None
    turn = torch.randn(start.position[..., :1].shape, generator=generator) * torch.tensor(
        [0.0, 0.3, 0.0] if flat else [0.2, 0.3, -0.4]
    )
    shift = 0.1 * torch.randn(start.position.shape, generator=generator)
    if flat:
        shift[..., 1] = 0
    q = quaternions.multiply(quaternions.exponential(turn), start.rotation)
    return replace(start, position=start.position + shift, rotation=q)


UNITS = {"mm-N": (1e3, 1.0), "nm-pN": (1e9, 1e12), "km-MN": (1e-3, 1e-6)}  # of a m and a N


def measured(length, force, shape):
    section = tb.Section.from_stiffness(
        EA=1e4 * force, GA=4e3 * force, GJ=0.8 * force * length**2,
        EI=(1.0 * force * length**2, 1.3 * force * length**2), mass=0.2,
    )  # fmt: skip
    if "column" in shape:
        beam = tb.Beam.straight(length, 8 if "8" in shape else 4, section)
        return tb.Scene(beam, [tb.TipLoad(force=(-4 * force, 0, 1e-3 * force))])
    halves = {
        "a": tb.Beam.straight(0.5 * length, 2, section),
        "b": tb.Beam.straight(0.5 * length, 2, section, root=(0.5 * length, 0, 0)),
    }
    joints = [tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), stiffness=8.0 * force * length)]
    press = tb.PointLoad(("b", -1), force=(-3 * force, 0, 1e-3 * force))
    return tb.Scene(halves, [press], joints=joints, supports=[tb.Support(("a", 0))])


@cache
def statics_of(*case):
    scene = measured(*case)
    return *told(scene), tb.equilibrium(scene, branch="stable"), tb.path(scene, steps=8)


@pytest.mark.parametrize(
    "units", [pytest.param(x, marks=[pytest.mark.long] * (x != "nm-pN")) for x in UNITS]
)
@pytest.mark.parametrize("shape", ["column", "column of 8", "hinged"])
@torch.no_grad()
def test_statics_do_not_depend_on_units(shape, units):
    """Buckling in other units than m and N: the same equilibria, warnings and stable branch, the
    same points of a path with as many negative pivots. In pN and nm any number of these was
    counted, from 0 to 3; of 8 elements Newton's method took an iteration more, and
    the path other steps, as a strain and a curvature were measured by one number.
    """
    length, force = UNITS[units]
    here, said, stable, way = statics_of(1.0, 1.0, shape)
    there, also, settled, path = statics_of(length, force, shape)
    torch.testing.assert_close(there.position / length, here.position, rtol=0, atol=1e-8)
    assert said == also and said is not None
    torch.testing.assert_close(settled.position / length, stable.position, rtol=0, atol=1e-6)
    torch.testing.assert_close(path.factor, way.factor, rtol=0, atol=1e-4)
    assert torch.equal(path.negative, way.negative) and torch.equal(path.kind, way.kind)


def test_a_round_column_that_buckles_alike_to_all_sides():
    """It has a ring of stable shapes. Rounding alone picks one, as the processor has it: it comes
    to one or says that it did not, and what picks one. Each is the plane's.
    """
    section = tb.Section.circle(radius=0.005, E=69e9, nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(1.0, 8, section, direction=(0, 0, 1.0))
    down = -1.2 * math.pi**2 * 69e9 * math.pi * 0.005**4 / 16  # N, 1.2 of Euler's

    def tip(across=0.0, **options):
        scene = tb.Scene(beam, [tb.TipLoad(force=(across, 0, down))], **options)
        return tb.equilibrium(scene, branch="stable").tip.position

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        alone = tip()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        leans, flat = tip(-1e-6 * down), tip(plane="xz")
    told = [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)]
    if told:
        assert "did not come to it; a load across" in told[0]
        assert alone[:2].norm() < 1e-9
    else:
        assert_close(alone[:2].norm(), flat[0].abs(), rtol=0, atol=1e-5)
    assert_close(leans.abs(), flat.abs(), rtol=0, atol=1e-5)
    assert flat[2] < 0.7


@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0])
def test_a_spin_that_nothing_resists_has_no_sign(speed):
    """A rope between two pins in a cross-current may turn about itself: the determinant of its
    tangent is zero, and its sign that of rounding, by speed and mesh. It is stable, as `modes` has
    it.
    """
    rope = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1e-3, EI=1e-3, mass=0.1)
    ends = [tb.Support(0, rotation=""), tb.Support(-1, rotation="", displacement=(-0.2, 0, 0))]
    loads = [tb.Gravity((0, 0, -9.81)), tb.Drag(1000.0, 0.01, flow=(0, speed, 0))]
    scene = tb.Scene(tb.Beam.straight(1.0, 16, rope), loads, supports=ends)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        tb.equilibrium(scene, relax=True)
    assert not [warning for warning in seen if "unstable" in str(warning.message)]
