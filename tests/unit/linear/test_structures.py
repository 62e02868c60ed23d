"""Modes, critical loads and equilibria of structures: a welded beam is the beam; joints leave what
they leave.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = dict(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
LOAD = {"F": torch.tensor([-1.0, 0.0, 0.0])}
HALVES = [tb.Weld(("a", -1), ("b", 0))]


def halves(order=1, **section):
    section = tb.Section.from_stiffness(**SECTION | section)
    return {
        "a": tb.Beam.straight(0.5, 2, section, order=order),
        "b": tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0), order=order),
    }


def scenes(order=1, plane=None, **section):
    """(the beam, the welded halves): clamped, with a force at the tip."""
    whole = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(**SECTION | section), order=order)
    force = tb.Input("F", 3)
    return (
        tb.Scene(whole, [tb.TipLoad(force=force)], plane=plane),
        tb.Scene(
            halves(order, **section),
            [tb.PointLoad(("b", -1), force=force)],
            joints=HALVES,
            supports=[tb.Support(("a", 0))],
            plane=plane,
        ),
    )


@pytest.mark.parametrize(("order", "plane"), [(1, None), (2, "xy")])
def test_a_beam_that_was_welded_has_the_modes_of_the_beam(order, plane):
    """About an equilibrium under load; frequencies and shapes, these node by node."""
    given = {"F": torch.tensor([-0.3, 0.5, 0.0])}
    one, two = (tb.modes(scene, count=3, inputs=given) for scene in scenes(order, plane))
    assert_close(one.frequency, two.frequency, rtol=1e-9, atol=0)
    n = one.shape.shape[-2] // 2 + 1
    rows = [*range(n), *range(n + 1, 2 * n)]
    agree = [
        (a * b).sum() / (a.norm() * b.norm())
        for a, b in zip(one.shape.real, two.shape.real[:, rows], strict=True)
    ]
    assert_close(torch.stack(agree).abs(), torch.ones(3), rtol=0, atol=1e-9)


def test_a_welded_column_buckles_as_the_column():
    """By divergence, under the same load; with its derivative by the stiffness."""
    one, two = (tb.critical_load(scene, 4.0, points=5, inputs=LOAD) for scene in scenes(plane="xy"))
    assert_close(one.factor, two.factor, rtol=1e-7, atol=0)
    assert int(two.kind) == 1
    EI = torch.tensor(1.0, requires_grad=True)
    found = tb.critical_load(scenes(plane="xy", EI=EI)[1], 4.0, points=5, inputs=LOAD).factor
    (slope,) = torch.autograd.grad(found, EI)
    expected = [
        tb.critical_load(scenes(plane="xy", EI=1.0 + e)[0], 4.0, points=5, inputs=LOAD).factor
        for e in (1e-3, -1e-3)
    ]
    assert_close(slope, (expected[0] - expected[1]) / 2e-3, rtol=1e-4, atol=0)


def test_a_hinge_leaves_one_motion_of_no_frequency():
    """Nothing holds the second half of a hinged beam: a frequency of zero beside those of the beam;
    as many modes as free moves less constraints.
    """
    scene = tb.Scene(
        halves(),
        joints=[tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0))],
        supports=[tb.Support(("a", 0))],
    )
    found = tb.modes(scene, tb.rest(scene), count=5 * 6 - 5).frequency
    assert found[0] < 1e-6 < 1.0 < found[1]
    with pytest.raises(ValueError, match="25 modes"):
        tb.modes(scene, tb.rest(scene), count=26)
    with pytest.raises(ValueError, match="takes a scene of one beam"):
        tb.linearize(scene, tb.rest(scene))


@pytest.mark.parametrize(
    "rub", [dict(damping=0.02), dict(friction=0.002, slip_speed=0.1)], ids=["damping", "friction"]
)
def test_what_damps_a_joint_damps_its_mode(rub):
    """A body on a hinge with a spring: J q'' + c q' + k q = 0; friction is a damper of mu over the
    slip speed.
    """
    scene = tb.Scene(
        {"wheel": tb.Body(0.3, 0.01)},
        joints=[tb.Hinge(None, "wheel", axis=(0, 1, 0), stiffness=0.5, **rub)],
    )
    found = tb.modes(scene, count=1)
    assert_close(found.eigenvalue.abs(), torch.tensor([(0.5 / 0.01) ** 0.5]), rtol=1e-9, atol=0)
    assert_close(
        found.damping_ratio, torch.tensor([0.02 / (2 * (0.5 * 0.01) ** 0.5)]), rtol=1e-9, atol=0
    )


@pytest.mark.parametrize("damping", [None, 0.1])
def test_an_inverted_pendulum_falls(damping):
    """A body that a spring of k holds up, pushed down by a force on its centre at the height h: F
    h = k, damped or not, though past that nothing of its stiffness is positive.
    """

    def of(factor):
        down = torch.as_tensor(factor)[..., None] * torch.tensor([0.0, 0.0, -1.0])
        return tb.Scene(
            {"pole": tb.Body(2.0, 0.05, position=(0, 0, 0.5))},
            [tb.PointLoad("pole", force=down)],
            joints=[
                tb.Hinge(None, "pole", at=(0, 0, 0), axis=(0, 1, 0), stiffness=3.0, damping=damping)
            ],
        )

    assert_close(tb.critical_load(of, 20.0, points=5).factor, torch.tensor(6.0), rtol=1e-6, atol=0)


def test_derivative_of_modes_of_a_strut():
    """By a bending stiffness, with a rod to the ground, against a difference."""

    def frequency(EI):
        scene = tb.Scene(
            halves(EI=EI),
            [tb.Gravity((0, 0, -9.81))],
            supports=[tb.Support(("a", 0))],
            joints=[
                tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0)),
                tb.Distance(("b", -1), None, at=(1.0, 0, 1.0)),
            ],
        )
        return tb.modes(scene, count=3).frequency[1]

    EI = torch.tensor(1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(frequency(EI), EI)
    assert_close(slope, (frequency(1.0 + 1e-4) - frequency(1.0 - 1e-4)) / 2e-4, rtol=1e-4, atol=0)


def test_vmap_over_equilibria_is_the_batch():
    """With a rigid motion that the load holds."""

    def tip(EI):
        scene = tb.Scene(
            halves(EI=EI),
            [tb.Gravity((0, 0, -9.81))],
            supports=[tb.Support(("a", 0))],
            joints=[tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0))],
        )
        return tb.equilibrium(scene, relax=True, throw=False).position[..., -1, :]

    EI = torch.tensor([1.0, 2.0])
    assert_close(torch.func.vmap(tip)(EI), tip(EI), rtol=0, atol=1e-7)


def test_modes_of_a_batch_are_those_of_each():
    """Of halves on a hinge with three springs: more modes than samples, and fewer."""

    def of(k):
        hinge = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), stiffness=k)
        return tb.Scene(halves(), joints=[hinge], supports=[tb.Support(("a", 0))], plane="xz")

    k = torch.tensor([0.5, 1.0, 2.0])
    for count in (2, 4):
        together = tb.modes(of(k), count=count)
        for i, own in enumerate(k):
            alone = tb.modes(of(own), count=count)
            assert_close(together.frequency[i], alone.frequency, rtol=1e-9, atol=0)
            assert_close(together.shape[i].abs(), alone.shape.abs(), rtol=0, atol=1e-6)
