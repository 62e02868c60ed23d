"""Frames by first-order theory, `small=True` with joints, against closed forms of structural
analysis and a stiffness matrix of plane frames.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

INF = math.inf
EI, EA = 2e6, 1e9  # N m^2, N
UP = dict(direction=(0, 0, 1.0), up=(-1.0, 0, 0))
STIFF = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=1e6, EI=EI, mass=60.0)  # bends alone
PLAIN = tb.Section.from_stiffness(EA=EA, GA=INF, GJ=1e6, EI=EI, mass=60.0)
ABOUT_Y = dict(axis=(0, 1, 0))


def line(start, end, section, elements=1):
    """A beam in the plane xz whose nodes a cubic lies through, exact for loads at nodes."""
    (x, z), (X, Z) = start, end
    way = (X - x, 0.0, Z - z)
    beam = tb.Beam.straight(
        math.hypot(*way), elements, section, root=(x, 0, z), direction=way, up=(z - Z, 0, X - x)
    )
    return beam.linked()


def portal(H, B, effects, section=STIFF, **scene):
    """On fixed feet."""
    parts = {
        "left": line((0, 0), (0, H), section),
        "right": line((B, 0), (B, H), section),
        "bar": line((0, H), (B, H), section, 8),
    }
    corners = [tb.Weld(("left", -1), ("bar", 0)), tb.Weld(("right", -1), ("bar", -1))]
    feet = [tb.Support(("left", 0)), tb.Support(("right", 0))]
    return tb.Scene(parts, effects, joints=corners, supports=feet, small=True, **scene)


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@pytest.mark.parametrize("plane", [None, "xz"])
def test_portal_on_fixed_feet(plane, engine):
    """Kleinlogel (1939), k = H/B: a sway force P at a corner gives the feet P H/2 (3k+1)/(6k+1), an
    even load q on the bar q B^2/(12 (k+2)). To rounding: the nodes of cubics are exact. Answers are
    as small as loads are: sway of 9 mm or of 9 um.
    """
    H, B, P, q = 3.0, 4.0, 1e4, 2e4
    k = H / B
    sway = P * H / 2 * (3 * k + 1) / (6 * k + 1)
    scale = torch.tensor([1.0, 1e-3])
    push = scale[:, None] * torch.tensor([P, 0, 0])
    state = tb.equilibrium(
        portal(H, B, [tb.PointLoad(("left", -1), push)], plane=plane), engine=engine
    )
    feet = state.reaction[..., 4]
    assert_close(feet[0], torch.tensor([-sway, -sway]), rtol=1e-11, atol=0)
    assert_close(feet[1] * 1e3, feet[0], rtol=1e-10, atol=0)
    even = [tb.LineLoad(force=(0, 0, -q), on="bar")]
    found = tb.equilibrium(portal(H, B, even, plane=plane), engine=engine).reaction[:, 4]
    want = q * B**2 / (12 * (k + 2))
    assert_close(found, torch.tensor([want, -want]), rtol=1e-11, atol=0)


def stiffness_matrix(nodes, bars, pinned=()):
    """Of a plane frame (Przemieniecki 1968, chapter 5): displacements x, z and the rotation from x
    to z of each node; a bar in `pinned` carries its force alone.
    """
    K = np.zeros((3 * len(nodes), 3 * len(nodes)))
    for i, j in bars:
        dx, dz = np.subtract(nodes[j], nodes[i])
        L = math.hypot(dx, dz)
        c, s, b = dx / L, dz / L, 0.0 if (i, j) in pinned else EI / L**3
        axial = EA / L * np.array([[1.0, 0, 0, -1, 0, 0]])
        k = np.zeros((6, 6))
        k[np.ix_([0, 3], [0, 3])] = axial[0, 0] * np.array([[1, -1], [-1, 1]])
        bend = [[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]]  # fmt: skip
        k[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = b * np.array(bend)
        turn = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
        at = [*range(3 * i, 3 * i + 3), *range(3 * j, 3 * j + 3)]
        K[np.ix_(at, at)] += turn.T @ k @ turn
    return K


def test_vierendeel_girder_is_its_stiffness_matrix():
    """Three panels of 2 m x 1.5 m with a pinned diagonal, forces at three nodes: displacements and
    rotations as of the matrix, to rounding of its condition, 1e5.
    """
    nodes = [(2.0 * k, z) for z in (0.0, 1.5) for k in range(4)]
    chords = [(k, k + 1) for k in (0, 1, 2, 4, 5, 6)]
    bars, pinned = [*chords, *((k, k + 4) for k in range(4)), (1, 6)], [(1, 6)]
    forces = {5: (3e3, -2e4), 6: (0.0, -1e4), 2: (0.0, -5e3)}
    K, f = stiffness_matrix(nodes, bars, pinned), np.zeros(24)
    for node, force in forces.items():
        f[3 * node : 3 * node + 2] = force
    free = [k for k in range(24) if k not in (0, 1, 10)]  # a hinge and a roller
    want = np.zeros(24)
    want[free] = np.linalg.solve(K[np.ix_(free, free)], f[free])

    parts = {f"{i}{j}": line(nodes[i], nodes[j], PLAIN) for i, j in bars}
    joints, first = [], {}
    for i, j in bars:
        for node, end in ((i, 0), (j, -1)):
            at = (f"{i}{j}", end)
            if node not in first:
                first[node] = at
            elif (i, j) in pinned:
                joints.append(tb.Hinge(first[node], at, **ABOUT_Y))
            else:
                joints.append(tb.Weld(first[node], at))
    loads = [tb.PointLoad(first[n], (x, 0.0, z)) for n, (x, z) in forces.items()]
    held = [tb.Support(first[0], rotation="xz"), tb.Support(first[3], position="yz", rotation="xz")]
    scene = tb.Scene(parts, loads, joints=joints, supports=held, plane="xz", small=True)
    state = tb.equilibrium(scene)
    rows = [scene.beam.row(first[n]) for n in range(8)]
    moved = (state.position - scene.beam.nodes)[rows][:, [0, 2]]
    want = torch.tensor(want).view(8, 3)
    assert_close(moved, want[:, :2], rtol=0, atol=1e-12)


def test_gerber_beam():
    """Three supports, a hinge at b behind the middle one, P at the end of the part that hangs: its
    hinge carries P/2, so that the girder has -P b/(2 a) and P (a + b)/(2 a); no moment at the
    hinge. Determinate, to rounding. In space as in the plane.
    """
    a, b, c, P = 4.0, 1.0, 3.0, 1e3
    parts = {"girder": line((0, 0), (a + b, 0), PLAIN, 5),
             "hung": line((a + b, 0), (a + b + c, 0), PLAIN, 2)}  # fmt: skip
    hinge = tb.Hinge(("girder", -1), ("hung", 0), **ABOUT_Y)
    held = [
        tb.Support(("girder", 0), rotation="xz"),
        tb.Support(("girder", 4), position="yz", rotation="xz"),
        tb.Support(("hung", -1), position="yz", rotation="xz"),
    ]
    for plane in (None, "xz"):
        scene = tb.Scene(parts, [tb.PointLoad(("hung", 1), (0, 0, -P))], joints=[hinge],
                         supports=held, plane=plane, small=True)  # fmt: skip
        state = tb.equilibrium(scene)
        want = torch.tensor([-P * b / (2 * a), P * (a + b) / (2 * a), P / 2])
        assert_close(state.reaction[:, 2], want, rtol=1e-11, atol=0)
        force = state.joint[0].force
        assert_close(force, torch.tensor([0.0, 0, P / 2]), rtol=0, atol=1e-8)


def test_beam_on_three_supports():
    """Two spans L under an even load: 3/8, 10/8 and 3/8 q L, which elements of order 2 have to
    rounding; a plane says what space says.
    """
    L, q = 2.0, 1e3
    beam = tb.Beam.straight(2 * L, 16, STIFF, order=2)
    held = [tb.Support(n, position="xyz" if n == 0 else "yz", rotation="xz") for n in (0, 16, 32)]
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -q))], supports=held, small=True)
    space, plane = (tb.equilibrium(x) for x in (scene, replace(scene, plane="xz")))
    assert_close(space.reaction[:, 2], q * L * torch.tensor([3, 10, 3]) / 8, rtol=1e-11, atol=0)
    for name in ("position", "rotation", "stress", "reaction"):
        a, b = getattr(space, name), getattr(plane, name)
        assert_close(a, b, rtol=0, atol=1e-11 * a.abs().max().item())


def test_truss():
    """Two bars at 45 degrees and a tie under P: -P/sqrt(2) and P/2 (method of joints), and the top
    sinks by sum of N n L/(EA) (unit load). To rounding, however large the load.
    """
    P = torch.tensor([1e2, 1e7])
    parts = {"left": line((0, 0), (1, 1), PLAIN), "right": line((2, 0), (1, 1), PLAIN),
             "tie": line((0, 0), (2, 0), PLAIN)}  # fmt: skip
    pairs = ((("left", -1), ("right", -1)), (("left", 0), ("tie", 0)), (("right", 0), ("tie", -1)))
    pins = [tb.Hinge(*pair, **ABOUT_Y) for pair in pairs]
    held = [
        tb.Support(("tie", 0), rotation="xz"),
        tb.Support(("tie", -1), position="yz", rotation="xz"),
    ]
    weight = tb.PointLoad(("left", -1), torch.stack((0 * P, 0 * P, -P), -1))
    scene = tb.Scene(parts, [weight], joints=pins, supports=held, plane="xz", small=True)
    state = tb.equilibrium(scene)
    forces = torch.stack([state[name].stress[:, 0, 0] for name in parts], -1) / P[:, None]
    root = 2**-0.5
    want = torch.tensor([-root, -root, 0.5])
    assert_close(forces, want.expand(2, 3), rtol=1e-10, atol=0)
    sinks = 2 * root**2 * 2**0.5 / EA + 0.25 * 2 / EA
    sunk = 1.0 - state["left"].tip.position[:, 2]
    assert_close(sunk, sinks * P, rtol=1e-7, atol=0)  # 1e-7 m of 1 m
    assert_close(sunk[1], sinks * P[1], rtol=1e-11, atol=0)


def test_balcony_bends_and_twists():
    """An L of two arms a and b, clamped, with P across its plane at its end: P a^3/(3 EI) +
    P b^3/(3 EI) + P b^2 a/GJ. And a grillage: two beams that cross in a Ball share P as 1/L^3.
    """
    a, b, P, GJ = 1.5, 1.0, 1e3, 1e6
    parts = {
        "a": tb.Beam.straight(a, 1, PLAIN).linked(),
        "b": tb.Beam.straight(b, 1, PLAIN, root=(a, 0, 0), direction=(0, 1.0, 0)).linked(),
    }
    down = [tb.PointLoad(("b", -1), (0, 0, -P))]
    scene = tb.Scene(parts, down, joints=[tb.Weld(("a", -1), ("b", 0))],
                     supports=[tb.Support(("a", 0))], small=True)  # fmt: skip
    want = -P * (a**3 / (3 * EI) + b**3 / (3 * EI) + b**2 * a / GJ)
    assert_close(tb.equilibrium(scene)["b"].tip.position[2].item(), want, rtol=1e-10, atol=0)

    parts = {"x": tb.Beam.straight(4.0, 2, PLAIN).linked(),
             "y": tb.Beam.straight(2.0, 2, PLAIN, root=(2.0, -1.0, 0),
                                   direction=(0, 1.0, 0)).linked()}  # fmt: skip
    held = [tb.Support((name, 0), rotation=turn) for name, turn in (("x", "x"), ("y", "y"))]
    held += [tb.Support((name, -1), rotation="") for name in parts]
    scene = tb.Scene(parts, [tb.PointLoad(("x", 1), (0, 0, -P))],
                     joints=[tb.Ball(("x", 1), ("y", 1))], supports=held, small=True)  # fmt: skip
    reaction = tb.equilibrium(scene).reaction[:, 2]
    share = P / (1 + 4.0**3 / 2.0**3)
    want = torch.tensor([share, P - share, share, P - share]) / 2
    assert_close(reaction, want, rtol=1e-9, atol=0)


def test_a_sway_mechanism_of_plastic_hinges():
    """A portal with hinges of the plastic moment M at feet and corners sways under 4 M/H (Neal
    1977). The posts' ends carry P H in all, f M in the mean. So under f times that
    load hinges turn by f M/k in the mean, k their elasticity, and beyond it by (f - 1) M/h of their
    hardening h as well, to rounding.
    """
    H, M, h, k = 3.0, 1e4, 1e3, 1e8
    parts = {"left": line((0, 0), (0, H), STIFF), "right": line((4, 0), (4, H), STIFF),
             "bar": line((0, H), (4, H), STIFF)}  # fmt: skip
    law = tb.ElastoPlastic(stiffness=k, yield_moment=M, hardening=h)
    ends = (None, ("left", 0)), (None, ("right", 0)), (("left", -1), ("bar", 0))
    ends = (*ends, (("right", -1), ("bar", -1)))
    hinges = [tb.Hinge(*pair, **ABOUT_Y, hysteresis=law) for pair in ends]
    f = torch.tensor([0.7, 1.02, 1.5])
    push = f[:, None] * torch.tensor([4 * M / H, 0.0, 0.0])
    load = tb.PointLoad(("left", -1), push)
    scene = tb.Scene(parts, [load], joints=hinges, plane="xz", small=True)
    turns = tb.equilibrium(scene).joints[:, :, 0].abs().mean(-1)
    want = f * M / k + (f - 1).clamp(min=0) * M / h
    assert_close(turns, want, rtol=1e-9, atol=0)


K = torch.tensor([[300.0, 20, 0], [20, 200, 10], [0, 10, 400]])
A, B_, OBLIQUE = ("a", -1), ("b", 0), (0.3, 1.0, 0.2)
LAWS = dict(stiffness=500.0, inertia=0.3)
JOINTS = {
    "weld": tb.Weld(A, B_),
    "hinge": tb.Hinge(A, B_, axis=OBLIQUE, torque=20.0, **LAWS),
    "led hinge": tb.Hinge(A, B_, axis=OBLIQUE, angle=lambda t: 0.01 + 0.0 * t),
    "slider": tb.Slider(A, B_, axis=OBLIQUE, force=20.0, **LAWS),
    "cylindrical": tb.Cylindrical(A, B_, axis=OBLIQUE, stiffness=(500.0, 4e3)),
    "universal": tb.Universal(A, B_, (1.0, 0, 0), (0, 1.0, 0), stiffness=(500.0, 400.0)),
    "ball": tb.Ball(A, B_, stiffness=K, torque=(3.0, 4.0, 5.0)),
    "rod": tb.Distance(("b", 1), None, at=(1.2, 0.3, 1.0)),
}
BENT = tb.Section.rectangle(width=0.03, height=0.02, E=69e9, nu=0.33, rho=2700.0)


def bent(name, scale=1.0, effects=(), **scene):
    """Two arms at an angle with a body at their end, joined in between."""
    parts = {
        "a": tb.Beam.straight(1.0, 2, BENT),
        "b": tb.Beam.straight(
            0.8, 2, BENT, root=(1.0, 0, 0), direction=(0.6, 0.8, 0), up=(0, 0, 1)
        ),
        "hub": tb.Body(2.0, (0.1, 0.2, 0.3), position=(1.48, 0.64, 0)),
    }
    joint = JOINTS[name]
    for field in ("torque", "force"):
        if getattr(joint, field, None) is not None:
            joint = replace(joint, **{field: scale * torch.as_tensor(getattr(joint, field))})
    if name == "led hinge":
        joint = replace(joint, angle=lambda t: scale * 0.01 + 0.0 * t)
    joints = [joint, tb.Weld(("b", -1), "hub")]
    joints += [tb.Weld(A, B_)] if name == "rod" else []
    push = scale * torch.tensor([30.0, 20.0, -50.0])
    return tb.Scene(parts, [tb.PointLoad(("b", -1), push), *effects], joints=joints,
                    supports=[tb.Support(("a", 0))], **scene)  # fmt: skip


@pytest.mark.parametrize("name", JOINTS)
def test_small_is_the_limit_of_large_rotations(name):
    """The large theory's answer over the load's share s tends to the small one as s; both have the
    same modes as drawn. Readings and forces of joints likewise.
    """
    small = tb.equilibrium(bent(name, small=True), engine="eager")
    off = []
    for s in (1e-3, 1e-4):
        large = tb.equilibrium(bent(name, s), engine="eager")
        drawn = bent(name).beam.nodes
        pairs = [((large.position - drawn) / s, small.position - drawn),
                 (large.joints / s, small.joints), (large.stress / s, small.stress)]  # fmt: skip
        off.append(max(((x - y).abs().max() / y.abs().max()).item() for x, y in pairs))
    assert off[1] < 1e-4 and off[1] < 0.2 * off[0]
    here, there = (tb.modes(bent(name, 0.0, small=x), count=4) for x in (True, False))
    assert_close(here.frequency, there.frequency, rtol=1e-8, atol=0)


@pytest.mark.parametrize("name", JOINTS)
def test_a_motion_superposes_and_keeps_its_energy(name):
    """A hundred times the load, a hundred times the motion; one Newton step solves. Kinetic and
    strain energy are what loads and joints do, to rounding of the steps.
    """
    t = torch.linspace(0, 0.01, 6)

    def motion(scale):
        scene = bent(name, scale, small=True)
        return tb.simulate(scene, t, step=2e-3, engine="eager", tolerance=1e-13), scene

    (large, scene), (few, _) = motion(1.0), motion(1e-2)
    moved, less = (x.state.position - scene.beam.nodes for x in (large, few))
    assert_close(moved, 100 * less, rtol=0, atol=1e-11)
    energy = large.energy
    kept = energy.kinetic + energy.strain - energy.work
    assert_close(kept, torch.zeros_like(kept), rtol=0, atol=1e-10 * energy.kinetic.max().item())
    stepper = tb.Stepper(scene, 2e-3, engine="eager")
    stepper(stepper.rest())
    assert stepper.iterations.max() <= 2


def test_work_of_a_ball_by_forces_at_the_ends_of_steps():
    """generalized_alpha counts it by these. That of large rotations over s^2 tends to it as s."""

    def work(scale, **scene):
        more = dict(step=2e-3, engine="eager", method="generalized_alpha")
        energy = tb.simulate(bent("ball", scale, **scene), [0.0, 0.01], **more).energy
        return energy.work[-1].item() / scale**2

    want, off = work(1.0, small=True), [work(s) for s in (1e-2, 1e-3)]
    off = [abs(x / want - 1) for x in off]
    assert off[0] < 1e-4 and off[1] < 0.2 * off[0]


@pytest.mark.parametrize("plane", [None, "xz"])
def test_gradients_of_a_frame(plane):
    """By EI, a hinge's stiffness, the height of a post, the place of the other one and the load, of
    an equilibrium and of a step: the ones that differences show.
    """

    def moved(x):
        EI, k, H, B, P = 1 + x
        bending = tb.Section.from_stiffness(EA=1e3, GA=INF, GJ=1.0, EI=EI, mass=0.2)
        z = torch.stack((0 * H, 0 * H, H))
        left = tb.Beam.straight(H, 2, bending, **UP)
        bar = tb.Beam.straight(B, 2, bending, root=z)
        right = tb.Beam.straight(H, 2, bending, root=torch.stack((B, 0 * B, 0 * B)), **UP)
        joints = [
            tb.Hinge(("left", -1), ("bar", 0), **ABOUT_Y, stiffness=k),
            tb.Weld(("right", -1), ("bar", -1)),
        ]
        load = tb.PointLoad(("left", -1), torch.stack((P, 0 * P, -0.3 * P)))
        scene = tb.Scene(
            dict(left=left, bar=bar, right=right), [load], joints=joints, plane=plane, small=True,
            supports=[tb.Support(("left", 0)), tb.Support(("right", 0))],
        )  # fmt: skip
        still = tb.equilibrium(scene, engine="eager")
        after = tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene))
        return torch.cat((still.position.flatten(), still.reaction.flatten(),
                          after.position.flatten(), after.joints.flatten()))  # fmt: skip

    assert torch.autograd.gradcheck(moved, 0.1 * torch.ones(5, requires_grad=True), fast_mode=True)
