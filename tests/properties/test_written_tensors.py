"""Tensors that are written to after something was made of them: everything is that of the old
values, or of the new, never some of each.
"""

import pytest
import torch

import torchbeam as tb
from cases.rows import ENDS, JOINTS, NEW, OLD, ROWS, joined

FORCE = torch.tensor([0.1, 0.3, 0.2])
COMPLIANCE, MASS = (
    torch.diag(torch.tensor(x))
    for x in ([0.01, 0.02, 0.02, 1.0, 1.0, 0.5], [0.2, 0.2, 0.2, 1e-3, 1e-3, 1e-3])
)


def section(**numbers):
    return tb.Section.from_stiffness(
        **{**dict(EA=100.0, GA=50.0, GJ=0.8, EI=(1.0, 2.0), mass=0.2, inertia=1e-3), **numbers}
    )


def straight(**place):
    return tb.Beam.straight(**{**dict(length=1.0, elements=2, section=section()), **place})


def loaded(*effects, beam=None, **parts):
    return tb.Scene(beam or straight(), [tb.TipLoad(force=FORCE.clone()), *effects], **parts)


def touching(**numbers):
    """Two beams across each other, nearer than the thickness of their contact."""
    parts = {"lower": straight(), "upper": straight(root=(0.5, -0.5, 0.11), direction=(0, 1.0, 0))}
    law = dict(radius=0.05, thickness=0.02, force=10.0) | numbers
    return tb.Scene(parts, [tb.Contact("lower", "upper", **law)])


def hinged(**numbers):
    return joined(tb.Hinge(*ENDS, **numbers))


def hubbed(point):
    """A hub that swings about a point of its own, to which a beam is fixed."""
    hub = tb.Body(position=(1.2, 0, 0), mass=0.3, inertia=(1e-3,) * 3)
    joints = [tb.Ball(None, ("hub", point), stiffness=0.5), tb.Weld("hub", ("bar", 0))]
    parts = {"hub": hub, "bar": straight(root=(1.2, 0, 0))}
    return tb.Scene(parts, [tb.PointLoad(("bar", -1), force=FORCE.clone())], joints=joints)


def falling(mass):
    """A beam that ends in a body of this mass."""
    hub = tb.Body(mass, inertia=(1e-3,) * 3, position=(1.0, 0, 0))
    parts = {"bar": straight(), "hub": hub}
    supports, joints = [tb.Support(("bar", 0))], [tb.Weld(("bar", -1), "hub")]
    return tb.Scene(parts, [tb.Gravity((0, 0, -9.81))], supports=supports, joints=joints)


def rung(point):
    """Pulled by a tendon through this point of the middle node."""
    eyelets = [(None, (0.0, 0, 0.1)), (1, point), (2, (0, 0, 0.05))]
    return loaded(tb.Tendon(eyelets, stiffness=10.0, length=0.9))


def pressed(obstacle, **numbers):
    """A beam that lies within the thickness of an obstacle."""
    law = dict(radius=0.05, thickness=0.05, force=10.0) | numbers
    return loaded(tb.Contact(obstacle, **law))


# a scene of one tensor, that tensor, and whose values hold after it was written to: those of a
# beam, its section, a point mass, a record, a joint's place and laws, and eyelets are looked at
# once, and kept; those of other effects,
# supports and frames are read where they are needed
# fmt: off
SCENES = {
    **{name: (lambda x, row=row: loaded(row.make(x, 2)), row.draw, row.after)
       for name, row in ROWS.items() if row.draw is not None},
    **{name: (lambda x, row=row: joined(row.make(x, *ENDS)), row.draw, row.after)
       for name, row in JOINTS.items() if row.draw is not None},
    "nodes": (lambda x: loaded(beam=tb.Beam.from_nodes(x, section())),
              [[0.0, 0, 0], [0.5, 0, 0], [1, 0.1, 0]], OLD),
    "nodes of order 2": (lambda x: loaded(beam=tb.Beam.from_nodes(x, section(), order=2)),
                         [[0.0, 0, 0], [0.5, 0.06, 0], [1, 0.1, 0]], OLD),
    "root": (lambda x: loaded(beam=straight(root=x), frame=tb.Frame(angular_velocity=(0, 0, 2.0))),
             [0.1, 0.2, 0.3], OLD),
    "length": (lambda x: loaded(beam=straight(length=x)), 1.0, OLD),
    "bending stiffness": (lambda x: loaded(tb.Damping(1e-2), beam=straight(section=section(EI=x))),
                          [1.0, 2.0], OLD),
    "compliance": (lambda x: loaded(tb.Damping(1e-2), beam=straight(section=tb.Section(x, MASS))),
                   COMPLIANCE, OLD),
    "mass": (lambda x: loaded(tb.Gravity((0, 0, -9.81)),
                              beam=straight(section=tb.Section(COMPLIANCE, x))), MASS, OLD),
    "accelerogram": (lambda x: loaded(root=tb.RootMotion(displacement=tb.Accelerogram([0.0, 1.0],
        x))), [[1.0, 2, 3]] * 2, OLD),
    "instants of an accelerogram":
    (lambda x: loaded(root=tb.RootMotion(displacement=tb.Accelerogram(x, torch.ones(2, 3)))),
                                    [0.01, 1.0], OLD),
    "history": (lambda x: loaded(tb.PointLoad(1, force=tb.History([0.0, 1.0], x))),
                [[1.0, 2, 3]] * 2, NEW),
    "function": (lambda x: loaded(tb.TipLoad(force=lambda t: x * (1 + t))), [0.1, 0.3, 0.2], NEW),
    "mass of a body": (lambda x: falling(x), 0.3, OLD),
    "turning frame": (lambda x: loaded(frame=tb.Frame(angular_velocity=x)), [1.0, 3.0, 2.0], NEW),
    "support": (lambda x: loaded(supports=[tb.Support(0), tb.Support(2, displacement=x)]),
                [0.0, 0.01, 0.02], NEW),
    "radius of beams that touch": (lambda x: touching(radius=x), 0.05, NEW),
    "radii along beams that touch": (lambda x: touching(radius=tb.Table((0.0, 1.0), x)),
                                     [0.06, 0.05], NEW),
    "radii along a beam": (
        lambda x: pressed(tb.Plane((0, 0, -0.08), (0, 0, 1.0)), radius=tb.Table((0.0, 1.0), x)),
        [0.06, 0.05], NEW),
    "thickness between beams": (lambda x: touching(thickness=x), 0.02, NEW),  # sets the places
    "force between beams": (lambda x: touching(force=x), 10.0, NEW),
    "an eyelet": (rung, [0.01, 0.02, 0.05], OLD),
    "eyelets along a beam": (lambda x: loaded(tb.Tendon.along(straight(), x, tension=2.0)),
                             [0.01, 0.02, 0.05], OLD),
    "slip speed of a hinge": (lambda x: hinged(friction=0.1, slip_speed=x), 0.1, OLD),
    "limits of a hinge": (lambda x: hinged(limits=x, limit_stiffness=5.0), [-1e-4, 1e-4], OLD),
    "limits of a universal joint": (lambda x: joined(tb.Universal(*ENDS, limits=x,
        limit_stiffness=(5.0, 4.0))), [[-1e-4, 1e-4], [-2e-4, 2e-4]], OLD),
    "limit of a ball": (lambda x: joined(tb.Ball(*ENDS, limit=x, limit_stiffness=5.0)), 1e-4, OLD),
    "point of a body in a joint": (hubbed, [-0.2, 0.0, 0.0], OLD),
    "centre of a sphere": (lambda x: pressed(tb.Sphere(x, 0.1)), [0.5, 0.03, -0.16], NEW),
    "radius of a sphere": (lambda x: pressed(tb.Sphere((0.5, 0.03, -0.16), x)), 0.1, NEW),
    "point of a plane": (lambda x: pressed(tb.Plane(x, (0.1, 0, 1.0))), [0.1, 0, -0.07], NEW),
    "end of a capsule": (lambda x: pressed(tb.Capsule((0.5, -1.0, -0.16), x, 0.1)),
                         [0.5, 1.0, -0.16], NEW),
    "size of a box": (lambda x: pressed(tb.Box((0.5, 0.0, -0.3), x, rounding=0.01)),
                      [0.6, 0.6, 0.43], NEW),
}
# fmt: on
# others: long
COMPILED = (
    "nodes",
    "mass",
    "accelerogram",
    "history",
    "PointMass.mass",
    "Damping.tau",
    "Spring.stiffness, of a length",
    "turning frame",
    "thickness between beams",
    "Tendon.stiffness",
    "an eyelet",
    "Hinge.stiffness",
    "Ball.damping",
)  # fmt: skip
assert {*COMPILED} <= {*SCENES}


def after(stepper):
    state = stepper(stepper(stepper.rest()))
    return torch.cat([x.flatten() for x in (state.position, state.velocity, state.stress)])


def stepper_of(scene, engine):
    return tb.Stepper(scene, 0.05, engine=engine, tolerance=1e-12)


@pytest.mark.parametrize(
    "engine, what",
    [
        pytest.param(
            engine, what, marks=[pytest.mark.long] * (engine == "compiled" and what not in COMPILED)
        )
        for engine in ("eager", "compiled")
        for what in SCENES
    ],
)
def test_a_scene_takes_all_values_or_none(engine, what):
    """Two steps of a stepper that is kept, and of one that is made afterwards, are both those of a
    scene of the values that the rule names, to 1e-8 of the difference between the two (Newton's
    last residual is 1e-12). NumPy writes: no version of a tensor counts that.
    """
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    make, value, rule = SCENES[what]
    old = torch.as_tensor(value).clone()
    new = 1.1 * old
    x = old.clone()
    scene = make(x)
    stepper = stepper_of(scene, engine)
    first, second = after(stepper), after(stepper_of(make(new.clone()), engine))
    size = (second - first).abs().max()
    assert size > 1e-7
    x.numpy()[...] = new
    wanted = {OLD: first, NEW: second}[rule]
    for given in (stepper, stepper_of(scene, engine)):
        assert (after(given) - wanted).abs().max() < 1e-8 * size


# fmt: off
KEPT = {
    "nodes": (lambda x: tb.Beam.from_nodes(x, section()), [[0.0, 0, 0], [0.5, 0, 0], [1, 0.1, 0]]),
    "nodes of order 2": (lambda x: tb.Beam.from_nodes(x, section(), order=2),
                         [[0.0, 0, 0], [0.5, 0.06, 0], [1, 0.1, 0]]),
    "frames": (lambda x: tb.Beam.from_nodes([[0.0, 0, 0], [1.0, 0, 0]], section(), frames=x),
               torch.eye(3)[None]),
    "radius": (lambda x: tb.Beam.arc(x, 1.0, 2, section()), 1.0),
    "direction": (lambda x: straight(direction=x), [1.0, 0.2, 0]),
    "twist": (lambda x: straight(twist=x), 0.3),
    "compliance": (lambda x: tb.Section(x, MASS), COMPLIANCE),
    "mass": (lambda x: tb.Section(COMPLIANCE, x), MASS),
    "EI": (lambda x: section(EI=x), [1.0, 2.0]),
    "width": (lambda x: tb.Section.rectangle(width=x, height=0.01, E=1e9, nu=0.3, rho=1e3), 0.03),
    "stations": (lambda x: tb.Stations([0.0, 1.0],
                                       [section(mass=x), section(mass=0.5)])(torch.tensor([0.2])),
                 0.2),
    "mass of a body": (lambda x: tb.Body(x, inertia=1e-3), 0.3),
    "inertia of a body": (lambda x: tb.Body(0.3, inertia=x), torch.eye(3) / 50),
    "place of a body": (lambda x: tb.Body(0.3, position=x), [1.0, 0, 0]),
    "axes of a body": (lambda x: tb.Body(0.3, rotation=x), torch.eye(3)),
    "accelerogram": (lambda x: tb.Accelerogram([0.0, 1.0], x), [[1.0, 2, 3]] * 2),
    "instants": (lambda x: tb.Accelerogram(x, torch.ones(2, 3)), [0.01, 1.0]),
    "record with a gradient": (lambda x: tb.Accelerogram(x, torch.ones(2, 3, requires_grad=True)),
                               [0.01, 1.0]),
}
# fmt: on


@pytest.mark.parametrize("what", KEPT)
def test_what_derives_numbers_keeps_its_own(what):
    """Every tensor of a beam, a section or a record is as it was."""
    make, value = KEPT[what]
    x = torch.as_tensor(value).clone()
    made = make(x)
    before = {
        name: value.detach().clone()
        for name, value in vars(made).items()
        if isinstance(value, torch.Tensor)
    }
    assert before
    x.mul_(1.1).add_(0.01)
    for name, value in before.items():
        assert torch.equal(getattr(made, name).detach(), value), name
