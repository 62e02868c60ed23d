"""What is written before a page is read: it works where one meaning is near, or a sentence says
what is wanted.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import with_values

SECTION = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 4, SECTION)
UP = (0.0, 0.0, 1.0)
PUSH = tb.TipLoad(force=(0, 0, 0.1))
SCENE, DRIVEN = tb.Scene(BEAM, [PUSH]), tb.Scene(BEAM, [tb.TipLoad(force=tb.Input("u", 3))])


def at_rest(*effects, **more):
    return tb.equilibrium(tb.Scene(BEAM, effects, **more), engine="eager", tolerance=1e-10)


@pytest.mark.parametrize("by_place, by_name", [
    (lambda: tb.PointLoad(3, UP), lambda: tb.PointLoad(3, force=UP)),
    (lambda: tb.TipLoad(UP), lambda: tb.TipLoad(force=UP)),
    (lambda: tb.LineLoad(UP), lambda: tb.LineLoad(force=UP)),
])  # fmt: skip
def test_a_force_by_place(by_place, by_name):
    assert_close(at_rest(by_place()).nodes, at_rest(by_name()).nodes, rtol=0, atol=0)


def test_a_spring_without_a_point_is_tied_where_its_node_is_drawn():
    """The same as with that point, with an offset too, on another beam and on a part."""
    for own, offset, at in (({}, None, (0.75, 0, 0)), ({"offset": UP}, UP, (0.75, 0, 1.0))):
        spring = tb.Spring(3, 10.0, **own)
        tied = tb.Spring(3, 10.0, at, offset=offset)
        assert_close(at_rest(PUSH, spring).nodes, at_rest(PUSH, tied).nodes)
    longer = replace(tb.Scene(BEAM, [tb.Spring(3, 10.0)]), beam=tb.Beam.straight(2.0, 4, SECTION))
    assert longer.effects[0].to.tolist() == [1.5, 0, 0]
    part = tb.Scene({"a": BEAM}, [tb.Spring(("a", 3), 1.0)], supports=[tb.Support(("a", 0))])
    assert part.effects[0].to.tolist() == [0.75, 0, 0]
    length = torch.ones((), dtype=torch.float64, requires_grad=True)
    beam = tb.Beam.straight(length, 4, SECTION)
    (slope,) = torch.autograd.grad(tb.Scene(beam, [tb.Spring(3, 1.0)]).effects[0].to[0], length)
    assert slope == 0.75


def test_a_step_jacobian_without_inputs():
    stepper = tb.Stepper(SCENE, 0.01, engine="eager")
    model = tb.linearize(SCENE, outputs=tb.sensors.TipPosition())
    A, B = stepper.jacobian(model.state, None, model)
    assert A.shape[-1] == 2 * tb.describe(SCENE).unknowns and B.shape[-1] == 0


SENTENCES = {
    "a count for a state": (lambda: tb.modes(SCENE, 4), "state = 4 was given.*count=4"),
    "no inputs": (lambda: tb.modes(DRIVEN), r"'u' is missing; inputs={'u': 3 numbers} is wanted"),
    "no inputs of a step": (
        lambda: tb.Stepper(DRIVEN, 0.1).jacobian(
            tb.rest(DRIVEN), None, tb.linearize(DRIVEN, inputs={"u": UP})),
        "'u' is missing"),
    "an arclength": (lambda: tb.Load(lambda x, R, v, w, t, s: (x, None), node=None),
                     r"function of 's' was given; .* is wanted, to which of=\(..., 's'\)"),
    "an arclength alone": (lambda: tb.Load(lambda s: (s, None), node=None),
                           r"function of 's' was given; .* is wanted, to which of=\(..., 's'\)"),
    "a part beside a node": (lambda: tb.Load(lambda x, R, v, w, t: (x, None), -1, on="nosuch"),
                             "on = 'nosuch' and the node -1"),
    "a picture's scale": (lambda: tb.plot.shape(tb.rest(SCENE), scale=10),
                          "the keyword 'scale' was given to a picture"),
    "no error": (lambda: tb.simulate(SCENE, [0.0, 0.1], accuracy=5e-324),
                 "accuracy = 4.94066e-324 was given; double precision"),
    "a fork in space": (lambda: tb.Scene(BEAM, supports=[tb.Support(0, rotation="x")]),
                        "axis along y and second along z"),
    "contact of a body that weighs nothing": (
        lambda: tb.Scene({"b": tb.Body(1.0, 0.1)},
                         [tb.Contact("b", tb.Plane((0, 0, -1.0), UP), radius=0.1)]),
        "Contact without a force was given where no weight"),
}  # fmt: skip


@pytest.mark.parametrize("guess", SENTENCES)
def test_a_sentence_says_what_is_wanted(guess):
    call, said = SENTENCES[guess]
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 250


def test_a_fork_holds_one_turn_and_leaves_two():
    """With small rotations and in a plane, by both engines; in space a `Universal` to the ground
    does.
    """
    soft = tb.Beam.straight(1.0, 6, tb.Section.from_stiffness(
        EA=1e5, GA=1e5, GJ=0.8, EI=(9.0, 1.0), mass=0.2, inertia=1e-4))  # fmt: skip

    def acting(node):
        return [tb.PointLoad(node, (0, 1e-6, 2e-6), moment=(1e-6, 0, 0))]

    roller = dict(position="yz", rotation="")
    held = [tb.Support(0, rotation="x"), tb.Support(-1, **roller)]
    fork = tb.Scene(soft, acting(4), supports=held, small=True)
    joint = tb.Scene(
        {"a": soft},
        acting(("a", 4)),
        joints=[tb.Universal(None, ("a", 0), axis=(0, 1, 0), second=(0, 0, 1))],
        supports=[tb.Support(("a", -1), **roller)],
    )
    small, large = (tb.equilibrium(one, engine="eager") for one in (fork, joint))
    assert_close(small.nodes, large.nodes, rtol=0, atol=1e-12)
    force, moment = small.reaction_of(0)
    assert_close(moment, torch.tensor([-1e-6, 0, 0], dtype=moment.dtype), rtol=0, atol=1e-12)
    assert_close(moment, large.joint[0].moment, rtol=0, atol=1e-12)
    assert_close(force, large.joint[0].force, rtol=0, atol=1e-12)
    frequencies = (tb.modes(one, count=4).frequency for one in (fork, joint))
    assert_close(*frequencies, rtol=1e-5, atol=0)
    t = [0.0, 0.02]
    runs = [tb.simulate(one, t, step=0.005, engine=engine).nodes[-1] - soft.nodes
            for one, engine in ((fork, "eager"), (fork, "compiled"), (joint, "eager"))]  # fmt: skip
    for other in runs[1:]:
        assert_close(other, runs[0], rtol=0, atol=1e-4 * runs[0].abs().max().item())
    for letter, known in (("x", ""), ("y", "xyz"), ("z", "")):
        a, b = (
            at_rest(
                PUSH, plane="xz", supports=[tb.Support(0, rotation=r), tb.Support(-1, **roller)]
            )
            for r in (letter, known)
        )
        assert_close(a.nodes, b.nodes, rtol=0, atol=0)


def test_a_contact_by_its_radius_alone():
    """A tenth of the radius; four times the weight and 16 EI/L^3; `describe` says both, they follow
    the beam, and gradients by EI see them.
    """
    floor = tb.Contact(tb.Plane((0, 0, -1.0), UP), radius=0.01)

    def scene(EI):
        own = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
        return tb.Scene(tb.Beam.straight(2.0, 4, own), [tb.Gravity((0, 0, -0.5)), floor])

    contact = scene(1.0).effects[1]
    assert_close(contact.thickness.item(), 0.001)
    assert_close(contact.force.item(), 4 * (0.2 * 0.5 + 16 / 8))
    (line,) = [
        line for line in str(tb.describe(scene(1.0))).splitlines() if "Contact along" in line
    ]
    assert "thickness = 0.001 (by default), force = 8.4 (by default)" in line
    stiffer = replace(scene(1.0), beam=scene(3.0).beam).effects[1]
    assert_close(stiffer.force.item(), 4 * (0.2 * 0.5 + 3 * 16 / 8))
    (own,) = tb.Scene(
        scene(3.0).beam, [with_values(contact, force=torch.tensor(5.0))]
    ).effects  # what is set stays set; the thickness follows still
    assert own.force == 5.0 and own.thickness == contact.thickness
    assert own.follows == ("thickness",)

    EI = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(scene(EI).effects[1].force, EI)
    assert_close(slope.item(), 4 * 16 / 8)


def test_contacts_of_parts_by_their_radii_alone():
    """Of a ball four times its weight, in N; of beams the heavier one's; of a beam without a radius
    that of a round section."""
    rod = tb.Section.circle(0.01, 1e8, 0.3, 1e3)
    parts = {
        "a": tb.Beam.straight(1.0, 4, rod),
        "b": tb.Beam.straight(1.0, 4, SECTION, root=(0, 0, 0.1)),
        "ball": tb.Body(0.5, 0.1, position=(0, 0, 0.5)),
        "box": tb.Body(0.5, 0.1, position=(0, 0, 0.9),
                       surface=tb.Box((0, 0, 0), (0.2, 0.2, 0.2), 0.01)),
    }  # fmt: skip
    floor = tb.Plane((0, 0, -1.0), UP)
    contacts = [
        tb.Contact("ball", floor, radius=0.03),
        tb.Contact("box", floor),
        tb.Contact("a", "b", radius=0.01, other_radius=0.02),
        tb.Contact("a", floor),
        tb.SelfContact("a", radius=0.01, stiffness=7.0),
    ]
    held = [tb.Support(("a", 0)), tb.Support(("b", 0))]
    scene = tb.Scene(parts, [tb.Gravity((0, 0, -9.81)), *contacts], supports=held)
    ball, box, pair, bare, itself = scene.effects[1:]
    assert_close([ball.thickness.item(), ball.force.item()], [0.003, 4 * 0.5 * 9.81])
    assert_close(box.force.item(), 4 * 0.5 * 9.81)
    assert 0 < box.thickness < 0.02
    weights = [part.mass[0, 0, 0] * 9.81 + 16 / part.compliance[0, 4, 4]
               for part in (parts["a"], parts["b"])]  # fmt: skip
    assert_close([pair.thickness.item(), pair.force.item()], [0.001, 4 * max(weights).item()])
    assert_close(bare.thickness.item(), 0.001)
    assert itself.force is None and itself.thickness.item() == 0.001
