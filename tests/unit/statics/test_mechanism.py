"""Equilibria of what swings and of what nothing holds: statics gives the reactions, whatever the
mesh.
"""

import math
import re

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

STRIP = tb.Section.rectangle(0.02, 0.002, E=70e9, nu=0.3, rho=2700)
STIFF = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=math.inf, EI=1.0, mass=1.0)
WEIGHT = {STRIP: 2700 * 0.02 * 0.002 * 9.81, STIFF: 9.81}
HINGE, PIN = tb.Support(0, rotation="xz"), tb.Support(0, rotation="")


def hung(section, elements, support, angle=0.0):
    beam = tb.Beam.straight(
        1.0, elements, section, direction=(math.sin(angle), 0.0, -math.cos(angle)),
        up=(0.0, 1.0, 0.0),
    )  # fmt: skip
    return tb.Scene(beam, [tb.Gravity((0.0, 0.0, -9.81))], supports=[support])


@pytest.mark.parametrize("section", WEIGHT, ids=["strip", "inextensible"])
@pytest.mark.parametrize("support", [HINGE, PIN], ids=["hinge", "pin"])
def test_a_pendulum_hangs_from_every_mesh(section, support):
    """1 and 4 elements, and 15: rounding had refused some of them. A pin leaves the turn about the
    beam itself to nothing.
    """
    for elements in (1, 4, 15):
        state = tb.equilibrium(hung(section, elements, support))
        assert_close(
            state.root.force, torch.tensor([0.0, 0.0, WEIGHT[section]]), rtol=1e-9, atol=1e-9
        )


def test_a_pendulum_swings_to_where_it_hangs_if_that_is_near():
    """0.2 rad away; at 1.2 rad the sentence says what to do, and a damped run comes there."""
    assert_close(
        tb.equilibrium(hung(STRIP, 3, PIN, 0.2)).tip.position,
        torch.tensor([0.0, 0.0, -1.0]),
        rtol=0,
        atol=1e-6,
    )
    for support in (HINGE, PIN):
        with pytest.raises(RuntimeError, match=r"nothing holds the rotation about .*relax=True"):
            tb.equilibrium(hung(STRIP, 3, support, 1.2))
    there = tb.equilibrium(hung(STRIP, 2, PIN, 1.2), relax=True).tip.position
    assert_close(there, torch.tensor([0.0, 0.0, -1.0]), rtol=0, atol=1e-6)


def test_derivatives_of_a_pendulum():
    """It lengthens by W L/2EA: derivative by E."""
    E = torch.tensor(70e9, requires_grad=True)
    section = tb.Section.rectangle(0.02, 0.002, E=E, nu=0.3, rho=2700)
    (slope,) = torch.autograd.grad(tb.equilibrium(hung(section, 4, PIN)).tip.position[2], E)
    assert_close(
        slope, torch.tensor(WEIGHT[STRIP] / (2 * 70e9**2 * 0.02 * 0.002)), rtol=1e-6, atol=0
    )


@pytest.mark.parametrize("plane", [None, "xz"])
def test_reactions_to_loads_on_what_supports_hold(plane):
    """A hinge under a force in a beam that is free to turn: it takes it, with the derivative -1."""
    force = torch.tensor([0.0, 0.0, 1.0], requires_grad=True)
    beam = tb.Beam.straight(1.0, 3, STRIP)
    state = tb.equilibrium(
        tb.Scene(beam, [tb.PointLoad(0, force=force)], supports=[HINGE], plane=plane)
    )
    assert_close(state.root.force, -force, rtol=1e-12, atol=1e-12)
    assert_close(
        torch.autograd.grad(state.root.force[2], force)[0],
        torch.tensor([0.0, 0.0, -1.0]),
        rtol=0,
        atol=1e-9,
    )


@pytest.mark.parametrize("order", [1, 2])
def test_a_free_bar_that_is_pulled_at_both_ends(order):
    """Nothing holds it and the loads balance: it is longer by F/EA of its length, its stress is
    F.
    """
    pull = [tb.PointLoad(0, force=(-10.0, 0.0, 0.0)), tb.TipLoad(force=(10.0, 0.0, 0.0))]
    state = tb.equilibrium(
        tb.Scene(tb.Beam.straight(1.0, 3, STRIP, order=order), pull, supports=())
    )
    assert_close(state.stress[:, 0], torch.full_like(state.stress[:, 0], 10.0), rtol=1e-9, atol=0)
    assert_close(
        state.position[-1, 0] - state.position[0, 0],
        torch.tensor(1 + 10 / (70e9 * 4e-5)),
        rtol=1e-12,
        atol=0,
    )


def test_a_batch_of_what_hangs_and_what_is_driven():
    force = torch.tensor([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scene = tb.Scene(tb.Beam.straight(1.0, 3, STRIP), [tb.TipLoad(force=force)], supports=[HINGE])
    state = tb.equilibrium(scene, throw=False)
    assert state.status.tolist() == [0, 0, 1]
    assert_close(state.root.force[:2], -force[:2], rtol=1e-9, atol=1e-12)


def test_a_body_that_turns_freely_on_its_axle():
    """A wheel at a beam's end, on a hinge through its own centre: nothing resists its turn, and
    nothing drives it; the beam carries its weight as that of a mass.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3)
    beam, gravity = tb.Beam.straight(1.0, 2, section), tb.Gravity((0, 0, -9.81))
    wheel = tb.Scene(
        {"arm": beam, "wheel": tb.Body(0.2, 1e-3, position=(1.0, 0, 0))},
        [gravity],
        joints=[tb.Hinge(("arm", -1), "wheel", axis=(0, 1, 0))],
        supports=[tb.Support(("arm", 0))],
    )
    found = tb.equilibrium(wheel)
    mass = tb.equilibrium(tb.Scene(beam, [gravity, tb.PointMass(0.2, node=-1)]))
    torch.testing.assert_close(found["arm"].position, mass.position, rtol=0, atol=1e-9)
    assert len(tb.modes(wheel, found, count=2).frequency) == 2
    way = tb.path(wheel, step=0.5)
    assert way.reached
    torch.testing.assert_close(way.state.position[-1], found.position, rtol=0, atol=1e-8)


def test_a_joint_within_what_is_free_holds_none_of_it():
    """A beam without a support, two nodes of which keep their distance: all six motions are named;
    pulled at both ends, it is at rest.
    """
    beam = {"bar": tb.Beam.straight(1.0, 4, STRIP)}
    joints = [tb.Distance(("bar", 1), ("bar", 4))]
    falls = tb.Scene(beam, [tb.Gravity((0, 0, -9.81))], joints=joints)
    with pytest.raises(RuntimeError, match="nothing holds 6 motions of 'bar'"):
        tb.equilibrium(falls)
    pulls = [tb.PointLoad(("bar", k), (f, 0, 0)) for k, f in ((0, -3e3), (-1, 3e3))]
    state = tb.equilibrium(tb.Scene(beam, pulls, joints=joints))
    ends = state.position[..., [0, 1, 4], :]
    assert state.status == 0 and (ends[1] - ends[2]).norm() == pytest.approx(0.75, abs=1e-12)
    assert (ends[0] - ends[1]).norm() > 0.25 * (1 + 1e-3)


def test_a_held_structure_without_equilibrium_says_so():
    """Two inextensible halves, welded, and pinned at ends that stand further apart than they
    reach: nothing is loose, and the sentence names nothing that is.
    """
    halves = {
        "a": tb.Beam.straight(0.5, 1, STIFF),
        "b": tb.Beam.straight(0.5, 1, STIFF, root=(0.5, 0, 0)),
    }
    scene = tb.Scene(
        halves,
        [tb.PointLoad(("a", -1), force=(0, 0, 1.0))],
        joints=[tb.Weld(("a", -1), ("b", 0))],
        supports=[
            tb.Support(("a", 0), rotation="xz"),
            tb.Support(("b", -1), rotation="", displacement=(0.1, 0, 0)),
        ],
        plane="xz",
    )
    with pytest.raises(RuntimeError) as refusal:
        tb.equilibrium(scene, engine="eager")
    assert "nothing holds" not in str(refusal.value)


def test_the_path_of_a_body_that_hangs():
    """Drawn aside by a force of up to its weight: 45 degrees; at no load nothing holds it, and a
    warning says so."""

    def hung(*loads):
        hinge = tb.Hinge(None, "bob", at=(0, 0, 0))
        return tb.Scene({"bob": tb.Body(1.0, 0.01, position=(0, 0, -1))}, loads, joints=[hinge])

    aside = tb.PointLoad("bob", force=tb.Input("F", 3))
    scene = hung(tb.PointLoad("bob", force=(0, 0, -2.0)), aside)
    hangs = tb.equilibrium(scene, inputs={"F": (0, 0, 0)})
    found = tb.path(scene, load="F", initial=hangs, step=0.3, inputs={"F": (2.0, 0, 0)})
    wanted = torch.tensor([0.5**0.5, 0, -(0.5**0.5)])
    torch.testing.assert_close(found.state.position[-1, 0], wanted, rtol=0, atol=1e-8)
    with pytest.warns(RuntimeWarning, match=r"nothing holds one motion of 'bob' \(.*\) there"):
        tb.path(hung(tb.PointLoad("bob", force=(0.3, 0, -2.0))))


HALVES = {
    "a": tb.Beam.straight(2.0, 2, STRIP),
    "b": tb.Beam.straight(2.0, 2, STRIP, root=(2.0, 0, 0)),
}
TURNS, SLIDES = dict(rotation="xz"), dict(position="yz", rotation="xz")
MECHANISMS = {
    "hinge at the middle": (
        [tb.Support(("a", 0), **TURNS), tb.Support(("b", -1), **SLIDES)], tb.Hinge,
        "one motion of 'a' and 'b' ('a': the rotation about y at (0, 0, 0) m; "
        "'b': the rotation about y at (4, 0, 0) m)",
    ),
    "two slides at a right angle": (  # about where their normals meet
        [tb.Support(("a", 0), position="xy", rotation="xz"), tb.Support(("b", -1), **SLIDES)],
        tb.Weld,
        "one motion of 'a' and 'b' ('a': a rotation about y at (4, 0, 0) m; "
        "'b': the rotation about y at (4, 0, 0) m)",
    ),
    "an arm": (
        [tb.Support(("a", 0))], tb.Hinge,
        "one motion of 'b' (the rotation about y at (2, 0, 0) m)",
    ),
    "a slide": (
        [tb.Support(("a", 0), **SLIDES), tb.Support(("b", -1), **SLIDES)], tb.Weld,
        "one motion of 'a' and 'b' ('a': the displacement along x; 'b': the displacement along x)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("name", MECHANISMS)
def test_a_mechanism_of_several_parts_is_named(name, plane):
    """Each part's motion, a rotation about where it stands still."""
    supports, joint, sentence = MECHANISMS[name]
    joints, pull = [joint(("a", -1), ("b", 0))], tb.Gravity((0.01, 0, -9.81))
    scene = tb.Scene(HALVES, [pull], joints=joints, supports=supports, plane=plane)
    if plane == "xz":
        assert "nothing holds " + sentence in str(tb.describe(scene))
    with pytest.raises(RuntimeError, match=re.escape(f"nothing holds {sentence}; a support")):
        tb.equilibrium(scene)
