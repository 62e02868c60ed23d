"""Supports: what they hold, the gradient by the geometry that they take it from, where a motion may
start.
"""

import itertools
import re
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat

ROTATIONS = ("", "xy", "yz", "xz", "xyz")
SECTION = tb.Section.from_stiffness(
    EA=60.0, GA=40.0, GJ=1.2, EI=(1.0, 1.7), mass=1.0, inertia=(0.02, 0.03)
)


def bent(g, nodes=4):
    """A beam through nodes that a vector g (..., 5) moves and turns, its section axes turned by it
    as well.
    """
    s = torch.linspace(0, 1, nodes)
    x = torch.stack((s, 0.2 * s * s, 0.1 * torch.sin(3 * s)), -1)
    q = quat.exponential(g[..., None, :3] + torch.tensor([0.3, 0.2, -0.4]))
    across, along = (g[..., 3:4] * s * s)[..., None], g[..., 4:, None]
    return tb.Beam.from_nodes(
        quat.rotate(q, x) + across * torch.eye(3)[0] + along * torch.eye(3)[2], SECTION
    )


WEIGHTS = torch.linspace(0.3, 1.7, 12).reshape(4, 3).sin()


def measured(state):
    """One number of positions and rotations."""
    axes = quat.matrix(state.rotation)[..., 1]
    return (WEIGHTS * state.position).sum((-1, -2)) + (WEIGHTS.flip(0) * axes).sum((-1, -2))


def answer(g, position, rotation, how, **options):
    """Held in part at both ends; springs to the ground, so that nothing is a mechanism whatever is
    held.
    """
    ground = [
        tb.Spring(i, 6.0, to=to)
        for i, to in enumerate(((0, 0, 0.4), (0, 0.5, 0), (0, 0, -0.6), (1.2, 0, 0)))
    ]
    scene = tb.Scene(
        bent(g),
        [tb.PointLoad(1, force=(0.2, -0.3, 0.4), moment=(0.1, 0.1, -0.2)), *ground],
        supports=[tb.Support(node, position=position, rotation=rotation) for node in (0, -1)],
        **options,
    )
    if how == "statics":
        return measured(tb.equilibrium(scene, tolerance=1e-12))
    return measured(
        tb.simulate(scene, [0.0, 0.1, 0.2], method=how, step=0.1, tolerance=1e-12).state[-1]
    )


@pytest.mark.parametrize(
    "how, small, every",
    [
        pytest.param("statics", False, True, marks=pytest.mark.long),
        ("statics", False, False),
        ("midpoint", False, False),
        pytest.param("generalized_alpha", False, False, marks=pytest.mark.long),
        ("statics", True, False),
        ("midpoint", True, False),
        pytest.param("generalized_alpha", True, False, marks=pytest.mark.long),
    ],
)
def test_gradient_by_geometry_whatever_is_held(how, small, every):
    """Node places and section axes all move with g: forward mode against central differences (their
    error: 1e-7 where it is soft), for every kind of held rotation; reverse mode where a hinge is.
    (Hinges held their axes without their derivative: 10 % and more.)
    """
    way, e = torch.tensor([0.3, -0.5, 0.7, 0.4, 0.2]), 1e-5
    cases = (
        list(itertools.product(("yz", "xyz"), ROTATIONS))
        if every
        else list(zip(("", "xyz", "yz", "x"), ROTATIONS[1:], strict=True))
    )
    for position, rotation in cases:

        def f(g, position=position, rotation=rotation):
            return answer(g, position, rotation, how, small=small)

        low, high = f(e * torch.stack((-way, way)))
        forward = torch.func.jvp(f, (0 * way,), (way,))[1]
        assert_close(
            forward, (high - low) / (2 * e), rtol=2e-7, atol=2e-7,
            msg=lambda m, at=(position, rotation): f"{at}: {m}",
        )  # fmt: skip
        if rotation == "yz":
            assert_close(torch.func.grad(f)(0 * way) @ way, forward, rtol=0, atol=1e-9)


# One place for what is held: where the beam has it, displaced and turned


STRAIGHT = tb.Beam.straight(1.0, 4, SECTION)
DISPLACED = (
    tb.Support(0, displacement=torch.tensor([0.0, 0.01, 0.0]), turn=torch.tensor([0.0, 0.1, 0.0])),
    tb.Support(-1, position="yz", rotation="", displacement=torch.tensor([0.0, 0.02, -0.01])),
)


def moved(state, node=0, position=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), **rates):
    """`state` with one node elsewhere, turned or moving."""
    at, q = state.position.clone(), state.rotation.clone()
    at[..., node, :] += torch.tensor(position, dtype=at.dtype)
    q[..., node, :] = quat.multiply(
        quat.exponential(torch.tensor(turn, dtype=at.dtype)), q[..., node, :]
    )
    for name, value in rates.items():
        rate = getattr(state, name).clone()
        rate[..., node, :] += torch.tensor(value, dtype=at.dtype)
        rates[name] = rate
    return replace(state, position=at, rotation=q, **rates)


@pytest.mark.parametrize(
    "off, said",
    [
        (dict(position=(0, 1e-3, 0)), "the position y of node 0, which is held, 0.001 m off"),
        (dict(turn=(0, 0, 0.01)), "the rotation z of node 0, which is held, 0.01 rad off"),
        (
            dict(node=4, position=(0.1, 0, 2e-3)),
            "the position z of node 4, which is held, 0.002 m off",
        ),
        (dict(node=4, turn=(0.01, 0, 0)), "the rotation x of node 4, which is held, 0.01 rad off"),
        (dict(velocity=(0, 0, 0.1)), "the velocity z of node 0, which is held, 0.1 m/s off"),
        (dict(node=4, spin=(0.3, 0.2, 0)), "the spin x of node 4, which is held, 0.3 rad/s off"),
        (
            dict(
                node=4,
                position=(0.1, 0, 0),
                turn=(0, 0.2, 0),
                velocity=(0.1, 0, 0),
                spin=(0, 0.2, 0),
            ),
            None,
        ),
    ],
)
@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha", "dopri5"])
def test_a_start_off_its_supports_is_refused(off, said, method):
    """A clamp, and a tip that slides along x and is hinged about y: what is held is refused
    elsewhere, what is free is not.
    """
    scene = tb.Scene(
        STRAIGHT, supports=(tb.Support(0), tb.Support(-1, position="yz", rotation="xz"))
    )
    start, t = moved(tb.rest(scene), **off), [0.0, 1e-3]
    how = {} if method == "dopri5" else dict(step=1e-3)
    if said is None:
        assert not tb.simulate(scene, t, start, method, **how).status.any()
        return
    with pytest.raises(ValueError, match=re.escape(said)):
        tb.simulate(scene, t, start, method, **how)
    if method != "dopri5":
        with pytest.raises(ValueError, match=re.escape(said)):
            tb.Stepper(scene, 1e-3, method).begin(start)


def test_one_sample_off_is_named_and_a_failed_one_is_not_judged():
    scene = tb.Scene(tb.Beam.straight(torch.tensor([1.0, 2.0]), 4, SECTION))
    start = moved(tb.rest(scene), position=(0, 1e-3, 0))
    start = replace(start, position=torch.stack((tb.rest(scene).position[0], start.position[1])))
    with pytest.raises(ValueError, match=re.escape("initial of sample [1] was given")):
        tb.simulate(scene, [0.0, 0.01], start, step=0.01)
    failed = replace(start, status=torch.tensor([0, 1]))
    assert_close(
        tb.simulate(scene, [0.0, 0.01], failed, step=0.01).nodes[:, :, 0],
        torch.zeros(2, 2, 3),
        rtol=0,
        atol=1e-15,
    )


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha", "dopri5"])
def test_restart(method, dtype):
    """From `equilibrium`, and from the middle of a motion, with supports elsewhere than the beam
    has their nodes, a hinge among them: what is held stays to rounding, and the energy of what is
    let go is that of the equilibrium (nothing jumps).
    """
    beam = tb.Beam.straight(
        1.0, 4, tb.Section.from_stiffness(60.0, 40.0, 1.2, 1.0, mass=1.0, inertia=0.05)
    )
    supports = (
        replace(DISPLACED[0], turn=None, displacement=(0.0, 0.01, 0.02)),
        tb.Support(-1, position="yz", rotation="xz", displacement=(0.0, 0.02, -0.01)),
    )
    pulled = [tb.PointLoad(2, force=(1.0, 2.0, 3.0))]
    bent = tb.equilibrium(tb.Scene(beam, pulled, supports=supports, dtype=dtype))
    loose = tb.Scene(beam, supports=supports, dtype=dtype)
    how = dict(method=method) if method == "dopri5" else dict(method=method, step=0.01)
    first = tb.simulate(loose, [0.0, 0.05, 0.1], bent, **how)
    again = tb.simulate(loose, [0.05, 0.1], first.state[1], **how)
    held = (again.nodes - bent.position)[..., (0, 4), 1:]
    assert held.abs().max() < 10 * torch.finfo(dtype).eps
    assert_close(
        again.nodes[-1],
        first.nodes[-1],
        rtol=0,
        atol={torch.float64: 1e-6, torch.float32: 1e-4}[dtype],
    )
    if method == "midpoint":
        total = first.energy.kinetic + first.energy.strain
        assert_close(total, total[:1].expand(3), rtol=2e-3, atol=0)


def test_statics_and_motion_hold_the_same_place():
    """A damped motion from rest comes to the equilibrium, with the root turned and both ends
    displaced by values.
    """
    scene = tb.Scene(STRAIGHT, [tb.Damping(0.3), tb.MassDamping(6.0)], supports=DISPLACED)
    assert not scene.has_prescribed_motion and not any(s.moves for s in scene.supports)
    end = tb.simulate(scene, [0.0, 7.0], step=0.1).state[-1]
    assert_close(end.position, tb.equilibrium(scene).position, rtol=0, atol=1e-6)


def test_values_that_do_not_change_are_no_motion():
    """`conserve`, an explicit method and the mixed forms take a clamp that stands elsewhere; the
    root's place may be one.
    """
    place, t = torch.tensor([0.0, 0.01, 0.0]), [0.0, 0.01, 0.02]
    scene = tb.Scene(
        STRAIGHT, root=tb.RootMotion(displacement=place, rotation=torch.tensor([0.0, 0.0, 0.02]))
    )
    want = tb.simulate(scene, t, step=2e-3, lumped=True)
    energy = want.energy.kinetic + want.energy.strain
    kept = tb.simulate(scene, t, step=1e-3, lumped=True, conserve=True)
    assert_close(kept.nodes, want.nodes, rtol=0, atol=1e-4)
    assert_close(energy, energy[:1].expand(3), rtol=1e-2, atol=0)
    assert_close(tb.simulate(scene, t, method="dopri5").nodes, want.nodes, rtol=0, atol=1e-3)
    moving = tb.Scene(
        STRAIGHT,
        root=tb.RootMotion(displacement=lambda t: place + 0 * t, rotation=scene.root.rotation),
    )
    for form in ("minimal", "block_rate"):
        ends = [tb.simulate(x, [0.0, 1e-3], form=form).nodes for x in (scene, moving)]
        assert_close(*ends, rtol=0, atol=1e-12)
    slide = tb.Scene(STRAIGHT, supports=DISPLACED)
    ends = [
        tb.simulate(slide, t, method=m, **how).nodes
        for m, how in (("dopri5", {}), ("midpoint", dict(step=2e-3, lumped=True)))
    ]
    assert_close(*ends, rtol=0, atol=1e-3)
    assert "displaced and turned" in str(tb.describe(slide)) and "moved" not in str(
        tb.describe(slide)
    )


def test_gradient_by_a_value_of_a_support():
    """d(nodes)/d(displacement) of an equilibrium and of a motion from rest, against central
    differences.
    """

    def f(d, motion):
        scene = tb.Scene(
            STRAIGHT, supports=(tb.Support(0), tb.Support(-1, "yz", "", displacement=d))
        )
        return (
            (
                tb.simulate(scene, [0.0, 0.05], step=0.01).state[-1]
                if motion
                else tb.equilibrium(scene)
            )
            .position.sin()
            .sum()
        )

    d, e = torch.tensor([0.0, 0.02, -0.1]), 1e-5
    for motion in (False, True):
        got = torch.func.grad(f)(d, motion)
        want = torch.stack(
            [(f(d + e * x, motion) - f(d - e * x, motion)) / (2 * e) for x in torch.eye(3)]
        )
        assert_close(got, want, rtol=0, atol=1e-7)


def test_a_start_brings_the_derivative_of_its_supports():
    """A start that is a constant, on a clamp that is not: what is held moves with the beam, in a
    motion as in statics.
    """
    start = tb.rest(tb.Scene(STRAIGHT))

    def f(y):
        root = torch.stack((0 * y, y, 0 * y))
        scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION, root=root))
        return tb.simulate(scene, [0.0, 0.01], start, step=0.01).nodes[-1, 0, 1]

    assert_close(torch.func.grad(f)(torch.tensor(0.0)), torch.tensor(1.0))


@pytest.mark.parametrize("position, rotation", [("z", ""), ("xyz", "xz"), ("xyz", "xyz")])
def test_a_start_with_what_moves(position, rotation):
    """At rest on a support that moves: where it is at t[0], with the velocity of what it holds; a
    start at its place at another time is refused.
    """
    support = tb.Support(
        -1,
        position,
        rotation,
        displacement=lambda t: torch.stack((0 * t, 0 * t, 0.1 * torch.sin(3 * t))),
    )
    scene = tb.Scene(STRAIGHT, supports=(tb.Support(0), support))
    start = tb.simulate(scene, [0.5, 0.52], step=0.01).state
    assert_close(start.position[0, -1, 2], torch.tensor(0.1).mul(torch.tensor(1.5).sin()))
    assert_close(
        start.velocity[0, -1, 2], torch.tensor(0.3).mul(torch.tensor(1.5).cos()), rtol=1e-6, atol=0
    )
    tb.simulate(scene, [0.52, 0.54], start[-1], step=0.01)
    tb.simulate(scene, [0.5, 0.52], tb.equilibrium(scene, t=0.5), step=0.01)
    with pytest.raises(ValueError, match="the position z of node 4, which is held, "):
        tb.simulate(scene, [0.0, 0.02], start[-1], step=0.01)


# Mechanisms and slack cables


HINGE, PIN = tb.Support(0, rotation="xz"), tb.Support(0, rotation="")


@pytest.mark.parametrize(
    "said, scene",
    [
        ("nothing holds the rotation about y at node 0", dict(supports=HINGE)),
        ("nothing holds the rotation about y at node 0", dict(supports=HINGE, plane="xz")),
        ("nothing holds the rotation about y at node 0", dict(supports=HINGE, small=True)),
        ("nothing holds the rotation about x, y and z at node 0", dict(supports=PIN)),
        (
            "nothing holds the rotation about x at node 0",
            dict(supports=(PIN, tb.Support(-1, rotation=""))),
        ),
        ("nothing holds the displacement along z;", dict(supports=tb.Support(0, position="xy"))),
        (
            "nothing holds the rotation about x at node 0;",
            dict(supports=PIN, effects=[tb.Spring(-1, 1.0, to=(1.0, 0.0, 1.0))]),
        ),
        (
            "nothing holds the displacement along x, y and z and the rotation about x, y and z",
            dict(supports=()),
        ),
    ],
)
def test_a_mechanism_is_named(said, scene):
    """`equilibrium` and `describe` of what nothing holds say which motion that is."""
    load = tb.PointLoad(
        2, force=(0.1, 0.0, 1.0), moment=(0.0 if "plane" in scene else 0.1, 0.0, 0.0)
    )
    scene = tb.Scene(STRAIGHT, [load, *scene.pop("effects", ())], **scene)
    with pytest.raises(RuntimeError, match=re.escape(said)):
        tb.equilibrium(scene)
    shown = tb.describe(scene).lines["frequencies"][0]
    assert said.strip(";") in shown or shown == "free: none of a rigid motion"


OWN = tb.Beam.straight(
    torch.tensor([0.9, 1.0, 1.1]), 3, tb.Section.from_stiffness(50.0, 20.0, 0.3, 0.4, mass=1.0)
)


@pytest.mark.parametrize(("beam", "k"), [(STRAIGHT, (5.0, 0.0)), (OWN, (5.0, 0.0, 5.0))])
def test_a_mechanism_in_the_batch_is_told_from_its_neighbour(beam, k):
    """Springs of all samples but one, of one beam or each its own: the sentence is of the sample
    that has none, whose nodes are looked at.
    """
    spring = tb.Spring(-1, torch.tensor(k), to=(1.0, 0.0, 0.5))
    scene = tb.Scene(beam, [tb.TipLoad(force=(0.0, 0.0, 0.1)), spring], supports=HINGE)
    said = f"found no equilibrium of sample 1 (1 of {len(k)}): nothing holds the rotation about"
    with pytest.raises(RuntimeError, match=re.escape(said)):
        tb.equilibrium(scene)


@pytest.mark.parametrize("order, N", [(1, 16), (2, 6)])
def test_what_nothing_holds_and_nothing_loads_stays(order, N):
    """A free beam without loads is in equilibrium where it is, whatever rounding makes of its
    stiffness: no error and no warning; modes take that. (beta L)^2 of Euler's free beam: three of
    rigid motions, 22.3733, 61.6728; mesh and shear 0.5 %.
    """
    free = tb.Scene(
        tb.Beam.straight(
            torch.tensor([1.0, 2.0]),
            N,
            tb.Section.from_stiffness(1e6, 1e6, 0.3, 1.0, mass=1.0),
            order=order,
        ),
        [tb.PointMass(0.0)],
        supports=(),
        plane="xz",
    )
    state = tb.equilibrium(free)
    assert (
        (state.status == 0).all()
        and (state.position == tb.rest(free).position).all()
        and (state.stress == 0).all()
    )
    known = torch.tensor([0.0, 0.0, 0.0, 22.3733, 61.6728])
    assert_close(
        tb.modes(free, count=5).frequency, torch.stack((known, known / 4)), rtol=5e-3, atol=1e-3
    )


def test_what_stays_beside_what_springs_hold():
    """Springs of one sample alone, at rest: its tip has the derivative 1/k by a force there. Its
    neighbour has the one that it has with the motion held at the hinge, that of a clamped beam:
    L^3/3EI less the 1/4 N^2 that N elements leave out, and shear.
    """
    force = torch.zeros(2, 3, requires_grad=True)
    spring = tb.Spring(-1, torch.tensor([5.0, 0.0]), to=(1.0, 0.0, 0.0))
    beam = tb.Beam.straight(1.0, 3, tb.Section.from_stiffness(1e6, 1e6, 0.3, 1.0, mass=1.0))
    state = tb.equilibrium(tb.Scene(beam, [spring, tb.TipLoad(force=force)], supports=HINGE))
    assert (state.status == 0).all()
    (slope,) = torch.autograd.grad(state.tip.position[:, 2].sum(), force)
    assert_close(
        slope[:, 2], torch.tensor([0.2, (1 / 3) * (1 - 1 / (4 * 3**2)) + 1e-6]), rtol=1e-5, atol=0
    )


CABLE = tb.Section.from_stiffness(EA=1e4, GA=5e3, GJ=1e-4, EI=1e-4, mass=1.0, inertia=1e-5)


@pytest.mark.parametrize("how", ["hanging", "cable", "hinged"])
def test_slack_cables_relax(how):
    """EI = 1e-4 under weight: load steps fail and say so; relax=True finds the cantilever that
    hangs down, the cable that sags 0.2 m shorter than it is long, and the hinged beam that swings
    down. Statics by the reactions; sag of the catenary (L = 2 a sinh(w/2a)): 0.2661 m, within 1 %
    at N = 16 with its stiff ends.
    """
    near = tb.Support(-1, rotation="xz", displacement=torch.tensor([-0.2, 0.0, 0.0]))
    supports = {"hanging": None, "cable": (HINGE, near), "hinged": (HINGE,)}[how]
    scene = tb.Scene(
        tb.Beam.straight(1.0, 16, CABLE), [tb.Gravity((0.0, 0.0, -9.81))], supports=supports
    )
    with pytest.raises(RuntimeError, match="relax=True"):
        tb.equilibrium(scene)
    state = tb.equilibrium(scene, relax=True)
    assert_close(state.reaction[..., :3].sum(-2), torch.tensor([0.0, 0.0, 9.81]), rtol=0, atol=1e-6)
    if how == "cable":
        assert_close(state.nodes[8, 2], torch.tensor(-0.2661), rtol=0.01, atol=0)
    else:
        assert_close(state.tip.position, torch.tensor([0.0, 0.0, -1.0]), rtol=0, atol=6e-3)


def test_relaxed_samples_and_their_gradient():
    """A batch, one of whose samples is easy: each as alone, and the derivative that load steps
    have.
    """

    def f(EI, relax):
        section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=EI, EI=EI, mass=1.0, inertia=0.01)
        scene = tb.Scene(tb.Beam.straight(1.0, 6, section), [tb.Gravity((0.0, 0.0, -9.81))])
        return tb.equilibrium(scene, relax=relax, tolerance=1e-11).tip.position[..., 2]

    EI = torch.tensor([1.0, 20.0])
    want, slope = torch.func.jvp(lambda x: f(x, False), (EI,), (torch.ones(2),))
    got, by = torch.func.jvp(lambda x: f(x, True), (EI,), (torch.ones(2),))
    assert_close(got, want, rtol=0, atol=1e-9)
    assert_close(by, slope, rtol=0, atol=1e-9)


def test_starts_and_relaxation_under_vmap():
    """Over starts and over weights: as alone; one start that is off is refused."""
    beam = tb.Beam.straight(1.0, 4, SECTION)
    scene = tb.Scene(beam, supports=(tb.Support(0), tb.Support(-1, "z", "")))
    starts = torch.stack([torch.tensor([[0.0, 0, 0]] * 3 + [[0, y, 0]] * 2) for y in (0.0, 0.01)])

    def run(off):
        start = tb.rest(scene)
        return tb.simulate(
            scene, [0.0, 0.02], replace(start, position=start.position + off), step=0.02
        ).nodes[-1]

    both = torch.func.vmap(run)(starts)
    assert_close(both, torch.stack([run(x) for x in starts]), rtol=0, atol=1e-12)
    with pytest.raises(
        ValueError, match=re.escape("sample [1] was given with the position z of node 0")
    ):
        torch.func.vmap(run)(
            starts + torch.tensor([0.0, 0.0, 0.01]) * (starts.sum((-1, -2), keepdim=True) > 0)
        )

    def hang(g):
        return tb.equilibrium(
            tb.Scene(beam, [tb.Gravity(torch.stack((0 * g, 0 * g, g)))]), relax=True
        ).tip.position

    g = torch.tensor([-1.0, -9.81])
    assert_close(torch.func.vmap(hang)(g), torch.stack([hang(x) for x in g]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", [dict(plane="xz"), dict(small=True)])
def test_starts_in_a_plane_and_of_small_rotations(options):
    """As in space: from the equilibrium of displaced supports, on; off the hinge or its axis,
    refused.
    """
    far = tb.Support(-1, "yz", "xz", displacement=torch.tensor([0.0, 0.0, -0.02]))
    scene = tb.Scene(
        STRAIGHT, [tb.TipLoad(moment=(0.0, 0.2, 0.0))], supports=(HINGE, far), **options
    )
    start = tb.equilibrium(scene)
    on = tb.simulate(scene, [0.0, 0.1], start, step=0.05)
    assert_close(on.nodes[-1], start.nodes, rtol=0, atol=1e-8)
    tb.simulate(scene, [0.1, 0.2], on.state[-1], step=0.05)
    for off, said in (
        (dict(node=4, position=(0, 0, 0.02)), "position z of node 4"),
        (dict(spin=(0, 0, 1)), "spin z of node 0"),
        (dict(turn=(0.1, 0, 0)), "rotation x of node 0"),
    ):
        with pytest.raises(
            ValueError,
            match=said if "plane" not in options or "node" in off else "leaves the plane",
        ):
            tb.simulate(scene, [0.0, 0.1], moved(start, **off), step=0.05)


ORDERED = tb.Section.from_stiffness(EA=60.0, GA=40.0, GJ=1.2, EI=(1.0, 1.7), mass=1.0, inertia=0.02)
SWAY = tb.Support(
    0, displacement=lambda t: torch.stack((0 * t, 0.1 * torch.sin(3 * t) ** 2, 0 * t))
)


@pytest.mark.parametrize(
    "how, options",
    [
        ("equilibrium", {}),
        ("midpoint", {"step": 0.01, "engine": "eager"}),
        ("midpoint", {"step": 0.01, "engine": "compiled"}),
        ("generalized_alpha", {"step": 0.01}),
        ("rk4", {"options": {"step_size": 5e-3}}),
    ],
)
def test_reactions_come_in_the_order_given(how, options):
    """Supports said in another order: `reaction` in that order, `root` that of node 0, everything
    else alike; a clamp that moves stands at any place among them. Equal to rounding. (Reactions
    came by node, and `root` was the first of them.)
    """
    three = (
        SWAY,
        tb.Support(2, position="z", rotation=""),
        tb.Support(-1, position="yz", rotation=""),
    )

    def state(order):
        scene = tb.Scene(
            tb.Beam.straight(1.0, 4, ORDERED),
            [tb.PointLoad(3, force=(0.1, 0.2, -0.3))],
            supports=[three[k] for k in order],
        )
        if how == "equilibrium":
            return tb.equilibrium(scene, t=0.2)
        return tb.simulate(scene, torch.linspace(0, 0.02, 3), method=how, **options).state[-1]

    plain = state((0, 1, 2))
    assert plain.reaction.abs().amax(-1).min() > 1e-4
    order = (2, 0, 1)
    other = state(order)
    assert other.supports == tuple((0, 2, 4)[k] for k in order)
    for k, of in enumerate(order):
        assert_close(
            torch.cat(other.reaction_of(k), -1),
            torch.cat(plain.reaction_of(of), -1),
            rtol=0,
            atol=1e-12,
        )
    assert_close(tb.sensors.RootReaction()(other), plain.reaction[..., 0, :], rtol=0, atol=1e-12)
    assert_close(other.position, plain.position, rtol=0, atol=1e-13)


def test_the_load_of_a_root_that_nothing_holds():
    """`root` is the load of node 0 and no other; a state that comes from other supports has none of
    theirs.
    """
    beam = tb.Beam.straight(1.0, 4, ORDERED)
    tip = tb.Scene(beam, [tb.PointLoad(1, force=(0, 0, 0.1))], supports=tb.Support(-1))
    still = tb.equilibrium(tip)
    assert_close(still.reaction_of(0).force, torch.tensor([0, 0, -0.1]), rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=re.escape("supports hold node 4 alone")):
        _ = still.root
    with pytest.raises(ValueError, match="the beam has no support"):
        _ = tb.rest(tb.Scene(beam, supports=())).root
    assert tb.Stepper(tb.Scene(beam), 0.01)(tb.rest(tip)).supports == (0,)


def test_a_clamp_that_gives_way_about_an_axis_alone():
    """Small forces: the tip sinks by F L^3/3 EI + F L^2/k along z (Euler and Bernoulli, a turning
    spring), and by F L^3/3 EI along y, where the support holds the turn. Frequencies are those of
    firm springs in the limit, the slope by k is that of differences, both engines agree.
    """
    k, section = (
        torch.tensor([3.0, 5.0]),
        tb.Section.from_stiffness(EA=1e5, GA=1e7, GJ=1.0, EI=(1.0, 2.0), mass=1.0, inertia=1e-3),
    )

    def scene(k, firm=None, *more):
        if firm is None:
            spring, foot = tb.RootSpring((0.0, k[..., None])), tb.Support(0, rotation="xz")
        else:
            f = torch.full_like(k, firm)
            spring, foot = tb.RootSpring(torch.stack((f, f, f, f, k, f), -1)), None
        return tb.Scene(tb.Beam.straight(1.0, 8, section, order=2), [spring, *more], supports=foot)

    push = tb.TipLoad(force=(0, 1e-3, 1e-3))
    tip = tb.equilibrium(scene(k, None, push)).tip.position
    assert_close(tip[:, 1], torch.full((2,), 1e-3 / 6), rtol=1e-4, atol=0)
    assert_close(tip[:, 2], 1e-3 * (1 / 3 + 1 / k), rtol=1e-4, atol=0)
    found = tb.modes(scene(k), count=4).frequency
    errors = [(tb.modes(scene(k, f), count=4).frequency - found).abs().max() for f in (1e5, 1e6)]
    assert 0.09 * errors[0] < errors[1] < 0.11 * errors[0]  # compliance 1/f, to first order
    assert torch.autograd.gradcheck(
        lambda k: tb.equilibrium(scene(k, None, tb.TipLoad(force=(0.2, 0.3, 0.5)))).tip.position,
        k.requires_grad_(),
    )
    motions = [
        tb.simulate(scene(k.detach(), None, push), [0, 0.1, 0.2], step=0.02, engine=engine)
        for engine in ("eager", "compiled")
    ]
    assert_close(motions[0].state.position, motions[1].state.position, rtol=0, atol=1e-12)
    assert "a mechanism" not in str(tb.describe(scene(k.detach())))


@pytest.mark.parametrize(
    "more",
    [
        dict(supports=tb.Support(0)),
        dict(supports=tb.Support(0, rotation="", displacement=(0, 0, 0.1))),
        dict(supports=tb.Support(0, rotation=""), root=tb.RootMotion(lambda t: (0, 0, t))),
    ],
    ids=["a clamp", "elsewhere", "moved"],
)
def test_a_root_spring_beside_a_support_that_clamps_or_moves_is_refused(more):
    beam = tb.Beam.straight(1.0, 2, SECTION)
    with pytest.raises(ValueError, match="a RootSpring and a support that clamps or moves node 0"):
        tb.Scene(beam, [tb.RootSpring((0.0, 1.0))], **more)
