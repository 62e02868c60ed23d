"""Loads, springs and masses at points of bodies, and at an offset from nodes of beams: they are
as on a body without mass that is welded there.
"""

import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

SECTION = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
POINT = torch.tensor([0.1, 0.05, -0.2])
NOTHING = dict(mass=1e-12, inertia=1e-14)  # of a body whose inertia nothing of 1e-9 sees


def scene(node, *, welded=False, spring=True, offset=None):
    """A hub on a beam, with a load, a spring and a mass at a point of it: itself, or a welded
    body.
    """
    hub = tb.Body(0.2, (1e-3, 2e-3, 1.5e-3), position=(0.5, 0, 0))
    parts, joints = {"arm": tb.Beam.straight(0.5, 2, SECTION), "hub": hub}, []
    if welded:
        parts["pin"] = tb.Body(**NOTHING, position=(0.5 + POINT[0], POINT[1], POINT[2]))
        joints.append(tb.Weld("hub", "pin"))
    at = {} if offset is None else {"offset": offset}
    damped = dict(length=0.05, damping=0.1, **at)
    effects = [
        tb.PointLoad(node, force=(0.3, 0.2, 1.0), moment=(0.01, 0, 0), **at),
        tb.PointMass(0.05, node=node, **at),
        tb.Gravity((0, 0, -9.81)),
    ]
    effects += [tb.Spring(node, 5.0, (0.2, 0.3, 0.1), **damped)] if spring else []
    joints.append(tb.Weld(("arm", -1), "hub"))
    return tb.Scene(parts, effects, joints=joints, supports=[tb.Support(("arm", 0))])


def test_a_point_of_a_body_is_a_body_welded_there():
    """Equilibria and frequencies about them, damped, to what the welded body's own mass does; of
    masses at the nodes alone, for what neighbours share of a beam's does not swing with an offset.
    """
    found = []
    for own in (scene(("hub", POINT)), scene("pin", welded=True), scene(("arm", -1), offset=POINT)):
        state = tb.equilibrium(own, tolerance=1e-12, engine="eager")
        found.append((state["hub"].position, tb.modes(own, state, count=4, lumped=True).eigenvalue))
    for other in found[1:]:
        assert_close(found[0][0], other[0], rtol=0, atol=1e-10)
        assert_close(found[0][1], other[1], rtol=1e-8, atol=0)


def test_it_moves_natively_as_eagerly_and_keeps_its_energy():
    """Two steps to 1e-12 by both engines; kinetic and strain energy less work stay to what a lever
    turns in a step, third order: a tenth of the step leaves less than a hundredth.
    """
    own, last, off = scene(("hub", POINT), spring=False), {}, {}
    for engine, step in (("eager", 2e-3), ("compiled", 2e-3), ("compiled", 2e-4)):
        t = [0.0, 4e-3]
        run = tb.simulate(own, t, step=step, tolerance=1e-13, engine=engine)
        assert int(run.status) == 0
        last[engine, step] = run["hub"].position[-1]
        energy = run.energy.kinetic + run.energy.strain - run.energy.work
        off[step] = (energy[-1] - energy[0]).abs() / run.energy.kinetic[-1]
    assert_close(last["eager", 2e-3], last["compiled", 2e-3], rtol=0, atol=1e-12)
    assert off[2e-4] <= off[2e-3] / 100 or off[2e-4] < 1e-9


def test_gradient_by_a_point():
    """Of an equilibrium, against a difference."""

    def tip(point):
        return tb.equilibrium(scene(("hub", point)), tolerance=1e-12, engine="eager")[
            "hub"
        ].position

    point = POINT.clone().requires_grad_()
    (slope,) = torch.autograd.grad(tip(point).sum(), point)
    e = 1e-5 * torch.eye(3)
    wanted = torch.stack([(tip(POINT + d) - tip(POINT - d)).sum() / 2e-5 for d in e])
    assert_close(slope, wanted, rtol=1e-7, atol=1e-8)


@refusals(
    (lambda: tb.PointLoad(("hub", (0.1, 0)), force=(0, 0, 1.0)), r"offset of shape \(2,\)"),
    (
        lambda: tb.PointLoad(("hub", (0.1, 0, 0)), force=(0, 0, 1.0), offset=(0, 0, 0.1)),
        "PointLoad with an offset and a point of 'hub' was given",
    ),
    (
        lambda: tb.Scene(
            tb.Beam.straight(1.0, 2, SECTION),
            [tb.PointLoad(-1, force=(0, 0, 1.0), offset=(0, 0.1, 0))],
            plane="xz",
        ),
        "PointLoad out of the plane 'xz'",
    ),
    (
        lambda: tb.simulate(
            tb.Scene(
                tb.Beam.straight(1.0, 2, SECTION),
                [tb.PointLoad(-1, force=(0, 0, 1.0), offset=(0, 0.1, 0))],
                small=True,
            ),
            [0.0, 0.1],
            step=0.1,
        ),
        "small=True with PointLoad was given",
    ),
    (
        lambda: tb.Scene(
            {"arm": tb.Beam.straight(1.0, 2, SECTION)},
            [tb.PointLoad(("arm", (0, 0, 0.1)), force=(0, 0, 1.0))],
            supports=[],
        ),
        "the structure has the nodes",
    ),
)
def test_refusals(make):
    scene = make()
    tb.equilibrium(scene)
