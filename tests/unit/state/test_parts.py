"""States, solutions and sensors of structures, part by part."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.structures import TIGHT, alone_and_together, beams, structure


@pytest.mark.parametrize("plane", [None, "xy"])
def test_results_are_read_by_name(plane):
    """Views of parts are what a scene of the beam alone has, planar ones as well."""
    alone, both = alone_and_together({}, plane=plane)
    both = replace(both, beam={**beams(), "hub": tb.Body(0.3, 1e-3, position=(0, 2.0, 0))})
    t = torch.linspace(0, 0.04, 3)
    sol, own = tb.simulate(both, t, **TIGHT), tb.simulate(alone["bow"], t, **TIGHT)
    view = sol["bow"]
    for a, b in (
        (view.tip.position, own.tip.position),
        (view.nodes, own.nodes),
        (view.stress, own.state.stress),
        (view.tip.velocity, sol.state.node(("bow", -1)).velocity),
        (view[-1].axes, own.state[-1].axes),
        (sol.state[-1]["bow"].reaction_of(0).force, own.state[-1].reaction_of(0).force),
        (sol["arm"].root.force, tb.simulate(alone["arm"], t, **TIGHT).root.force),
        (sol["hub"].position, sol.nodes[..., -1, :]),
        (sol.state["hub"].spin, torch.zeros(3, 2, 3)),
    ):
        assert_close(a, b, rtol=0, atol=1e-10)
    assert sol["hub"].rotation.shape == (3, 2, 3, 3) and sol.state[-1]["hub"].velocity.shape == (
        2,
        3,
    )
    assert (
        "parts 'arm', 'bow', 'hub'" in repr(sol)
        and "parts" in repr(sol.state)
        and "tip at" in repr(view)
    )


def frame():
    """Two columns and a beam between them, with a body at a rod's end: one loop, by the ground."""
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
    columns = [
        tb.Beam.straight(1.0, 2, section, root=(x, 0, 0), direction=(0, 1, 0)) for x in (0, 2)
    ]
    girder = tb.Beam.straight(2.0, 4, section, root=(0, 1, 0))
    joints = [
        tb.Weld(("left", -1), ("girder", 0)),
        tb.Hinge(("girder", -1), ("right", -1), axis=(0, 0, 1)),
        tb.Distance(("girder", 2), "load"),
    ]
    load = tb.Body(1.0, 0.1, position=(1, 0.5, 0))
    return tb.Scene(
        {"left": columns[0], "girder": girder, "load": load, "right": columns[1]},
        [tb.Gravity((0, -9.81, 0)), tb.LineLoad(force=(0, -1.0, 0), on="girder")],
        joints=joints,
        supports=[tb.Support(("left", 0)), tb.Support(("right", 0))],
    )


def test_a_structure_is_described():
    text = str(tb.describe(frame()))
    for words in (
        "'load': a body of 1 kg",
        "LineLoad on 'girder'",
        "node ('left', 0): clamped",
        "1 closed loop",
        "Hinge of ('girder', -1) and ('right', -1): holds 5 components",
        "12 forces of joints",
        f"'midpoint': {2 * (6 * 12 - 12 - 12)} states",
        "minimal: no, a structure was given",
    ):
        assert words in text, words
    assert "3 closed loops" in str(
        tb.describe(
            replace(
                frame(),
                supports=[tb.Support((name, k)) for name in ("left", "right") for k in (0, 1)],
            )
        )
    )
    assert "0 closed loops" in str(tb.describe(replace(frame(), supports=())))


def test_a_structure_is_drawn():
    """Each beam a line of its own, bodies and joints marked; in animations too."""
    state = tb.rest(frame())
    drawn = tb.plot.shape(state).lines
    (curve,) = (line for line in drawn if len(line.get_xdata()) > 20)
    gaps = torch.isnan(torch.as_tensor(curve.get_xdata())).sum()
    assert gaps == 2 and [line.get_marker() for line in drawn] == ["None", "o", "s", "o", "o", "o"]
    rod = drawn[-1]
    assert list(zip(rod.get_xdata(), rod.get_ydata(), strict=True)) == [(1, 1), (1, 0.5)]


def test_what_is_of_one_beam_asks_for_a_name():
    state, own = tb.rest(structure()), tb.rest(alone_and_together({})[0]["bow"])
    for read, words in (
        (lambda: state.tip, "[name].tip of one of its beams is wanted: 'arm', 'bow'"),
        (lambda: state.root, "[name].root"),
        (lambda: state["leg"], "the part 'leg' was asked for"),
        (lambda: state.node(3), "node = 3 was given in a structure"),
        (
            lambda: tb.State.from_nodes(structure(), structure().beam.nodes),
            "frames of all of its nodes",
        ),
        (lambda: own["bow"], "a scene of one beam has no names"),
        (lambda: own.node(("bow", 1)), "which has no names"),
    ):
        with pytest.raises(ValueError) as caught:
            read()
        assert words in str(caught.value)


def test_sensors_are_of_parts():
    """By `on`, or the name in the node: what the same sensor reads of the beam by itself."""
    alone, both = alone_and_together({})
    both = replace(both, beam={**beams(), "hub": tb.Body(0.3, 1e-3, position=(0, 2.0, 0))})
    t, s = torch.linspace(0, 0.04, 3), tb.sensors
    sol, expected = tb.simulate(both, t, **TIGHT).state, tb.simulate(alone["bow"], t, **TIGHT).state
    bow = alone["bow"]
    for of_part, of_beam in (
        (s.TipPosition(on="bow"), s.TipPosition()),
        (s.NodeVelocity(("bow", 2)), s.NodeVelocity(2)),
        (s.Spin(1, on="bow"), s.Spin(1)),
        (s.Stress(element=1, beam=both, on="bow"), s.Stress(element=1, beam=bow)),
        (s.Angles(2, on="bow", reference=tb.rest(both)), s.Angles(2, reference=tb.rest(bow))),
        (s.NodePosition(2, tb.rest(both), on="bow"), s.NodePosition(2, tb.rest(bow))),
        (s.Strain(0.3, both, on="bow"), s.Strain(0.3, bow)),
        (s.NodeAcceleration(("bow", 1), both), s.NodeAcceleration(1, bow)),
    ):
        assert_close(of_part(sol), of_beam(expected), rtol=0, atol=1e-8)
        assert of_part.name == ("" if of_part.on is None else "bow ") + of_beam.name
    assert_close(s.RootForce(on="arm")(sol), sol["arm"].root.force)
    assert_close(s.NodePosition("hub")(sol), sol["hub"].position)
    for read, words in (
        (lambda: s.TipPosition()(sol), "a sensor with on = one of 'arm', 'bow', 'hub' is wanted"),
        (lambda: s.TipPosition(on="bow")(expected), "a scene of one beam has no names"),
        (lambda: s.Strain(0.3, both), "the part None was asked for"),
        (lambda: s.NodePosition(("bow", 1), on="arm"), "one of them is wanted to say the part"),
        (lambda: s.NodeAcceleration(0, structure()), "was given to NodeAcceleration"),
    ):
        with pytest.raises(ValueError) as caught:
            read()
        assert words in str(caught.value)
