"""Planes and small rotations: the same beam with fewer unknowns, held against 3D."""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import state as random_state
from torchbeam.nodal.coordinates.planar import Planar
from torchbeam.nodal.discretise import discretise

NORMAL = {"xy": 2, "xz": 1}
FIELDS = ("position", "rotation", "velocity", "spin", "stress", "reaction", "work")


def section(coupled=False):
    """Every stiffness its own; `coupled`: stretch with bending about z."""
    K = torch.diag(torch.tensor([100.0, 60, 50, 0.8, 1.0, 1.5]))
    if coupled:
        K[0, 5] = K[5, 0] = 2.0
    mass = torch.diag(torch.tensor([0.2, 0.2, 0.2, 0.003, 0.001, 0.002]))
    return tb.Section(torch.linalg.inv(K), mass)


def inside(plane, along, across):
    """A vector in the plane."""
    v = [along, across, across]
    v[NORMAL[plane]] = 0.0
    return tuple(v)


def turn(plane, value):
    v = [0.0, 0.0, 0.0]
    v[NORMAL[plane]] = value
    return tuple(v)


def scenes(plane):
    """Pairs (name, scene by its arguments): everything that fits a plane."""
    force, moment = inside(plane, 0.5, 2.0), turn(plane, 0.4)
    up = (0.0, 0, 1) if plane == "xz" else (0.0, 1, 0)
    direction = inside(plane, 1.0, 0.3)
    beam = tb.Beam.straight(1.0, 4, section(), direction=direction, up=up)
    arc = tb.Beam.arc(
        0.8, 1.2, 4, section(coupled=plane == "xy"), up=(0, 0, 1) if plane == "xy" else (0, 1, 0)
    )
    dead = [tb.TipLoad(force=force, moment=moment), tb.Gravity(inside(plane, 0.0, -9.81))]
    follower = [tb.TipLoad(force=(1.0, 0, 2.0), follower=True)]  # z of the section is `up`
    rotating = tb.Frame(
        angular_velocity=lambda t: 3 * t * torch.tensor(turn(plane, 1.0), dtype=t.dtype),
        velocity=inside(plane, 0.2, 0.1),
    )
    shaken = tb.RootMotion(
        displacement=lambda t: (
            torch.sin(9 * t) * torch.tensor(inside(plane, 0.05, 0.05), dtype=t.dtype)
        ),
        rotation=lambda t: torch.sin(5 * t) * torch.tensor(turn(plane, 0.4), dtype=t.dtype),
    )
    slide = tb.Support(-1, position="z" if plane == "xz" else "y", rotation="")
    hinge = "xz" if plane == "xz" else "xy"
    yield "dead", beam, dead, {}
    yield "arc", arc, dead, {}
    yield "follower", beam, follower, {}
    yield "damped", beam, [*dead, tb.Damping((0.01, 0.02, 0.03, 0.04, 0.05, 0.06))], {}
    yield (
        "eccentric mass",
        beam,
        [*dead, tb.PointMass(0.1, inertia=(1e-3, 2e-3, 3e-3), offset=(0.05, 0, 0.1), node=2)],
        {},
    )
    yield "rotating", beam, dead, dict(frame=rotating)
    yield "shaken", beam, dead, dict(root=shaken)
    yield "hinged", beam, dead, dict(supports=(tb.Support(0, rotation=hinge), slide))
    yield "drag", beam, [*dead, tb.Drag(1.2, 0.05), tb.MassDamping(0.3)], {}
    yield "user load", beam, [tb.Load(lambda r, R, v, w, t: (-r - 0.3 * v, -0.1 * w), node=-1)], {}
    yield "actuated", beam, [tb.Actuation(curvature=(0.0, 1.0, 0))], {}
    eccentric = tb.PointMass(0.1, inertia=(1e-3, 2e-3, 3e-3), offset=(0.05, 0, 0.1), node=2)
    yield "small", beam, [*dead, eccentric, tb.Damping(0.01)], dict(small=True)
    yield "small arc", arc, [*dead, tb.Drag(1.2, 0.05)], dict(small=True)
    yield "small shaken", beam, dead, dict(root=shaken, small=True)
    yield (
        "small hinged",
        beam,
        dead,
        dict(supports=(tb.Support(0, rotation=hinge), slide), small=True),
    )


CASES = {f"{plane} {name}": (plane, *rest) for plane in NORMAL for name, *rest in scenes(plane)}


# in short runs, what knows which plane it is; the others in one
BOTH = "dead", "arc", "eccentric mass", "hinged", "small"


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case, marks=[pytest.mark.long] * (case.startswith("xz") and not case.endswith(BOTH))
        )
        for case in CASES
    ],
)
def test_plane_is_3d(case):
    """Ten steps of 10 ms, in the plane and in 3D: position, rotation, velocity, spin, stress,
    reaction and work agree to 1e-10 of the largest (Newton to 1e-13 in both).
    """
    plane, beam, effects, motion = CASES[case]
    ends = []
    for chosen in (None, plane):
        stepper = tb.Stepper(tb.Scene(beam, effects, plane=chosen, **motion), 0.01, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(10):
            state = stepper(state)
        assert state.status == 0
        ends.append(state)
    for name in FIELDS:
        whole, flat = (getattr(s, name) for s in ends)
        # a pin that slides in 3D holds what the plane holds by itself
        if name == "reaction" and "hinged" in case:
            whole, flat = (
                x[..., [i for i in (0, 1, 2) if i != NORMAL[plane]]] for x in (whole, flat)
            )
        assert_close(flat, whole, rtol=0, atol=1e-10 * max(1.0, whole.abs().max().item()))


@pytest.mark.parametrize(
    "method, plane",
    [
        ("generalized_alpha", "xy"),
        ("generalized_alpha", "xz"),
        ("rk4", "xz"),
        pytest.param("rk4", "xy", marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("small", [False, True])
def test_other_methods_in_a_plane(plane, method, small):
    """generalized_alpha and an explicit method, likewise."""
    _, beam, effects, _ = CASES[f"{plane} dead"]
    options = (
        dict(step=0.01, tolerance=1e-13) if method != "rk4" else dict(options={"step_size": 1e-3})
    )
    ends = [
        tb.simulate(
            tb.Scene(beam, effects, plane=p, small=small), [0.0, 0.05], method=method, **options
        ).state[-1]
        for p in (None, plane)
    ]
    for name in ("position", "rotation", "velocity", "spin"):
        assert_close(getattr(ends[1], name), getattr(ends[0], name), rtol=0, atol=1e-10)


@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize("plane", NORMAL)
def test_statics_and_modes_in_a_plane(plane, small):
    """Equilibrium to 1e-11, and the frequencies of the plane among those of 3D to 1e-8."""
    _, beam, effects, _ = CASES[f"{plane} dead"]
    scenes = [tb.Scene(beam, effects, plane=p, small=small) for p in (None, plane)]
    whole, flat = (tb.equilibrium(scene, tolerance=1e-12) for scene in scenes)
    for name in ("position", "rotation", "stress", "reaction"):
        assert_close(getattr(flat, name), getattr(whole, name), rtol=0, atol=1e-11)
    mine = tb.modes(scenes[1], flat, count=4).frequency
    all_ = tb.modes(scenes[0], whole, count=12).frequency
    assert ((all_[:, None] - mine).abs().amin(0) < 1e-8 * mine).all()


def test_gradients_in_a_plane_are_those_in_3d():
    """By a stiffness, a load in the plane and the length, through five steps."""

    def gradients(plane):
        EI, force, length = (torch.tensor(v, requires_grad=True) for v in (1.0, 2.0, 1.0))
        of = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
        scene = tb.Scene(
            tb.Beam.straight(length, 3, of), [tb.TipLoad(force=(0.0, 0.0, force))], plane=plane
        )
        stepper = tb.Stepper(scene, 0.02, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(5):
            state = stepper(state)
        return torch.stack(
            torch.autograd.grad(state.tip.position[2] + state.root.moment[1], (EI, force, length))
        )

    assert_close(gradients("xz"), gradients(None), rtol=1e-10, atol=1e-12)


def test_auto_finds_the_plane():
    """Where everything that is a number lies in one; a function of t, an Input or a load across it
    means 3D.
    """
    beam = tb.Beam.straight(1.0, 3, section())
    across = {"xz": (0, 0, 1.0), "xy": (0, 1.0, 0)}
    for name, force in across.items():
        found = discretise(
            tb.Scene(beam, [tb.TipLoad(force=force), tb.Damping(0.1)], plane="auto")
        ).space
        assert isinstance(found, Planar) and found.name == name
    for effects in (
        [tb.TipLoad(force=(0, 1.0, 1.0))],
        [tb.TipLoad(force=lambda t: torch.zeros(3))],
        [tb.TipLoad(force=tb.Input("u", 3))],
        [tb.TipLoad(moment=(1.0, 0, 0))],
    ):
        assert not isinstance(discretise(tb.Scene(beam, effects, plane="auto")).space, Planar)


# fmt: off
OUT_OF_XY = {
    "Actuation": dict(effects=[tb.Actuation(curvature=(0, 0.5, 0))]),
    # slack at rest
    "Spring": dict(effects=[tb.Spring(-1, stiffness=100.0, to=(1.0, 0, 1.0), length=1.0)]),
    "PointMass": dict(effects=[tb.PointMass(0.1,
                                            inertia=[[0.02, 0.005, 0.003], [0.005, 0.02, 0],
                                                     [0.003, 0, 0.02]])]),
    "displacement of a support": dict(supports=(tb.Support(0),
                                                tb.Support(-1, displacement=(0, 0, 0.05)))),
    "turn of a support": dict(supports=(tb.Support(0), tb.Support(-1, turn=(0, 0.1, 0)))),
    "RootSpring": dict(effects=[tb.RootSpring(stiffness=[10.0] * 6)],
                       root=tb.RootMotion(displacement=(0, 0, 0.05))),
}
# fmt: on


@pytest.mark.parametrize("what", OUT_OF_XY)
def test_what_acts_out_of_a_plane_is_refused_there(what):
    """Numbers out of the plane, also where nothing of them is felt at rest, or where no load brings
    them: "xy" says so, "auto" goes on in 3D.
    """
    beam = tb.Beam.straight(1.0, 2, section())
    with pytest.raises(ValueError, match=f"{what}.* out of the plane 'xy'"):
        discretise(tb.Scene(beam, plane="xy", **OUT_OF_XY[what]))
    found = discretise(tb.Scene(beam, plane="auto", **OUT_OF_XY[what])).space
    assert not isinstance(found, Planar) or found.name == "xz"


AXES = {"x": (1.0, 0, 0), "y": (0, 1.0, 0), "z": (0, 0, 1.0)}
DRIVEN = {  # by the axis of the coordinate that is driven
    "Hinge": lambda e, _, m: tb.Hinge(None, ("arm", 0), axis=e, torque=m),
    "Slider": lambda e, _, m: tb.Slider(None, ("arm", 0), axis=e, force=m),
    "Cylindrical, turn": lambda e, _, m: tb.Cylindrical(None, ("arm", 0), axis=e, torque=m),
    "Cylindrical, travel": lambda e, _, m: tb.Cylindrical(None, ("arm", 0), axis=e, force=m),
    "Universal": lambda e, n, m: tb.Universal(None, ("arm", 0), axis=e, second=n, torque=m),
    "Universal, second": lambda e, n, m: tb.Universal(
        None, ("arm", 0), axis=n, second=e, second_torque=m
    ),
}


@pytest.mark.parametrize("letter", AXES)
@pytest.mark.parametrize("name", DRIVEN)
def test_a_motor_in_a_plane_moves_as_in_3d_or_is_refused(name, letter):
    """A step under an input along each coordinate: in "xz" as in 3D, or, where 3D leaves the plane,
    a sentence that names the axis that is wanted.
    """
    axis, normal = AXES[letter], AXES["xyz"["xyz".index(letter) - 2]]
    joint = DRIVEN[name](axis, normal, tb.Input("m", 1))
    parts = {"arm": tb.Beam.straight(1.0, 2, section())}
    space = tb.Stepper(tb.Scene(parts, joints=[joint]), 0.01)
    after = space(space.rest(), m=(0.1,))
    assert after.velocity.abs().max() + after.spin.abs().max() > 1e-3
    leaves = after.velocity[..., 1].abs().max() + after.spin[..., ::2].abs().max() > 1e-9
    flat = tb.Scene(parts, joints=[joint], plane="xz")
    if leaves:
        wanted = "lie in it" if name in ("Slider", "Cylindrical, travel") else "be y"
        with pytest.raises(ValueError, match=f"in the plane 'xz'; its axis must {wanted}"):
            tb.Stepper(flat, 0.01)
    else:
        plane = tb.Stepper(flat, 0.01)
        torch.testing.assert_close(
            plane(plane.rest(), m=(0.1,)).velocity, after.velocity, rtol=0, atol=1e-9
        )


def test_a_joint_that_holds_the_plane_is_refused_there():
    """Without a motor too: a Hinge about z, and a Universal about x and z, are welds in "xz", and
    turn in "xy"; a Ball is a hinge in a plane, if no torque acts out of it.
    """
    beam = tb.Beam.straight(1.0, 2, section())
    for joint in (
        tb.Hinge(None, ("arm", 0), axis=(0, 0, 1)),
        tb.Universal(None, ("arm", 0), second=(0, 0, 1)),
        tb.Ball(None, ("arm", 0), torque=(1.0, 0, 0)),
    ):
        with pytest.raises(ValueError, match="plane 'xz'"):
            discretise(tb.Scene({"arm": beam}, joints=[joint], plane="xz"))
        found = discretise(tb.Scene({"arm": beam}, joints=[joint], plane="auto")).space
        assert getattr(found, "name", None) == (None if isinstance(joint, tb.Ball) else "xy")
    discretise(tb.Scene({"arm": beam}, joints=[tb.Ball(None, ("arm", 0))], plane="xz"))


def test_an_elastic_clamp_that_moves_by_a_function_means_3d():
    """Its motion is the scene's, not that of a support."""
    scene = tb.Scene(
        tb.Beam.straight(1.0, 2, section()),
        [tb.RootSpring(stiffness=[10.0] * 6), tb.Gravity((0, -1.0, 0))],
        root=tb.RootMotion(displacement=lambda t: torch.stack((0 * t, 0 * t, t))),
        plane="auto",
    )
    assert not isinstance(discretise(scene).space, Planar)


def test_a_plane_in_single_precision():
    """In a frame whose numbers came in the default dtype."""
    of = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=1.0, mass=0.2)
    frame = tb.Frame(velocity=(0.2, 0, 0), angular_velocity=(0, 0.5, 0))
    stepper = tb.Stepper(
        tb.Scene(tb.Beam.straight(1.0, 2, of), frame=frame, plane="xz", dtype=torch.float32), 0.01
    )
    state = stepper(stepper.rest())
    assert state.position.dtype == torch.float32 and state.status == 0


def test_coupled_section_has_no_plane():
    """Bending-torsion coupling leaves the plane, and is refused with a sentence."""
    K = torch.eye(6)
    K[3, 4] = K[4, 3] = 0.3
    beam = tb.Beam.straight(1.0, 2, tb.Section(torch.linalg.inv(K), torch.eye(6)))
    with pytest.raises(ValueError, match="whose compliance couples the plane 'xz'"):
        discretise(tb.Scene(beam, plane="xz"))


def test_small_is_the_limit_of_3d():
    """Displacements under loads of size s, of a bent beam: the difference to 3D, relative to s, is
    of first order in s (small rotations neglect squares).
    """
    beam, gaps = tb.Beam.arc(0.8, 1.2, 4, section()), []
    for s in (1e-2, 1e-3):
        effects = [
            tb.TipLoad(force=(0.3 * s, 2.0 * s, 1.0 * s), moment=(0.1 * s, 0, 0.2 * s)),
            tb.Damping(0.01),
            tb.MassDamping(0.2),
        ]
        ends = []
        for small in (False, True):
            stepper = tb.Stepper(tb.Scene(beam, effects, small=small), 0.02, tolerance=1e-12)
            state = stepper.rest()
            for _ in range(10):
                state = stepper(state)
            ends.append(state)
        assert all(s.status == 0 for s in ends)
        gaps.append((ends[1].position - ends[0].position).abs().max().item() / s)
    assert gaps[1] < 0.15 * gaps[0] and gaps[0] < 0.1


@pytest.mark.long
@pytest.mark.parametrize(
    "mass", [(), (tb.PointMass(0.1, inertia=(0.01, 0.01, 0.01), offset=(0, 0.05, 0.02), node=0),)]
)
def test_a_clamp_that_moves_by_small_rotations_explicitly(mass):
    """The explicit form's tip and reaction are those of short implicit steps with lumped mass; a
    batch of motions (as many as there are nodes, lest axes are mistaken) is each of them.
    """
    way = torch.tensor([[0, 0.01, 0], [0, 0, 0.02], [0, 0.01, 0.01]])
    beam = tb.Beam.straight(1.0, 2, section(), direction=(1.0, 1.0, 0))

    def scene(way):
        def swing(t):
            return (1 - torch.cos(10 * t)) * way

        return tb.Scene(
            beam, mass, root=tb.RootMotion(displacement=swing, rotation=swing), small=True
        )

    many = tb.simulate(scene(way), [0, 0.1], method="dopri5")
    for k in range(3):
        one = tb.simulate(scene(way[k]), [0, 0.1], method="dopri5")
        assert_close(many.tip.position[:, k], one.tip.position, rtol=0, atol=1e-7)
        assert_close(many.root.moment[:, k], one.root.moment, rtol=0, atol=1e-4)
    steps = tb.simulate(scene(way[2]), [0, 0.1, 0.101], step=1e-3, lumped=True)
    # 2.5e-7 measured: the steps, second order
    assert_close(one.tip.position[-1], steps.tip.position[1], rtol=0, atol=1e-6)
    mean = steps.state.reaction[1:].mean(0)[0]  # of the steps before and after the instant
    # 2e-4 measured
    assert_close(one.state.reaction[-1, 0], mean, rtol=0, atol=1e-3 * mean.abs().max().item())


def test_small_superposes():
    """A load 200 times as large, a displacement 200 times as large, to rounding (rotations of a
    state stay below pi).
    """
    beam = tb.Beam.straight(1.0, 4, section())

    def moved(scale):
        effects = [
            tb.TipLoad(force=(0.0, 5.0 * scale, 2.0 * scale)),
            tb.PointMass(0.3, offset=(0, 0.1, 0.05)),
        ]
        stepper = tb.Stepper(tb.Scene(beam, effects, small=True), 0.02, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(10):
            state = stepper(state)
        return state.position - beam.nodes

    assert_close(moved(0.2), 200 * moved(1e-3), rtol=0, atol=1e-11)


@pytest.mark.parametrize("plane", NORMAL)
def test_state_goes_in_and_comes_out(plane):
    """A planar state entered and left is the same state."""
    space = Planar.of(CASES[f"{plane} dead"][1], plane)
    stepper = tb.Stepper(tb.Scene(CASES[f"{plane} dead"][1], CASES[f"{plane} dead"][2]), 0.05)
    state = stepper(stepper(stepper.rest()))
    back = space.to_public(space.to_reduced(state))
    for name in ("position", "rotation", "velocity", "spin", "stress", "reaction"):
        assert_close(getattr(back, name), getattr(state, name), rtol=0, atol=1e-12)
    assert math.isclose(random_state(stepper.scene).t.item(), 0.0)


def test_a_start_out_of_the_plane_is_refused():
    """By simulate and equilibrium, with a sentence; one in the plane is taken."""
    beam = tb.Beam.straight(1.0, 3, section())
    load = tb.TipLoad(force=(0, 0.1, 0))
    scene = tb.Scene(beam, [load], plane="xy")
    out = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0.1, 0.2))]))
    inside = tb.equilibrium(tb.Scene(beam, [load]))
    for call in (
        lambda s: tb.simulate(scene, torch.tensor([0.0, 0.1]), s),
        lambda s: tb.equilibrium(scene, initial=s),
    ):
        call(inside)
        with pytest.raises(
            ValueError, match="an initial state whose position leaves the plane 'xy' was given"
        ):
            call(out)


@pytest.mark.parametrize("plane", ["xz", "auto"])
def test_a_plane_scene_is_made_under_vmap(plane):
    """Each sample as alone, in a step; one whose force leaves the plane is refused, or has "auto"
    take 3D for all.
    """

    def tip(EI, length, force):
        section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
        scene = tb.Scene(
            tb.Beam.straight(length, 2, section), [tb.TipLoad(force=force)], plane=plane
        )
        stepper = tb.Stepper(scene, 0.01)
        return stepper(stepper.rest()).tip.position

    given = (
        torch.tensor([1.0, 2.0]),
        torch.tensor([1.0, 1.2]),
        torch.tensor([[0.1, 0, 0.3], [0.0, 0, -0.2]]),
    )
    alone = torch.stack([tip(*one) for one in zip(*given, strict=True)])
    assert_close(torch.func.vmap(tip)(*given), alone, rtol=0, atol=1e-12)
    aside = *given[:2], given[2] + torch.tensor([[0.0, 0, 0], [0, 0.1, 0]])
    if plane == "xz":
        with pytest.raises(ValueError, match="TipLoad out of the plane 'xz' was given"):
            torch.func.vmap(tip)(*aside)
    else:
        assert torch.func.vmap(tip)(*aside)[1, 1] > 1e-6


def test_small_rotations_beyond_half_a_turn_are_said():
    """A quaternion holds less: what a state would lose without a word."""
    section = tb.Section.rectangle(width=0.01, height=0.01, E=1e9, nu=0.3, rho=1000.0)

    def bent(moment):
        load = tb.TipLoad(moment=(0, moment * 1e9 * 0.01**4 / 12, 0))
        return tb.equilibrium(
            tb.Scene(tb.Beam.straight(1.0, 2, section), [load], small=True)
        ).position

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bent(3.1)
    with pytest.warns(RuntimeWarning, match=r"rotations of 3\.2 rad .* less than half a turn"):
        bent(3.2)
