"""Warnings of elements that a shape bends or stretches too far: against arcs, whose elements bend
by their known share, and what is warned of in runs and equilibria.
"""

import math
import re
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.nodal.deformed_elements import deformations
from torchbeam.nodal.discretise import discretise

ROD = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1.0, EI=1.0, mass=0.1)
WARNED = "element {}, sample 1 \\(1 of 2\\),{} bends by"


def arc(angle, twist=0.0, order=1, elements=2):
    """A scene, and a state whose elements bend by `angle` and twist by `twist` rad each."""
    beam = tb.Beam.straight(1.0, elements, ROD, order=order)
    s = torch.linspace(0, elements, beam.node_count, dtype=torch.float64)
    a, R = angle * s, 1 / (angle * elements)
    nodes = torch.stack((R * a.sin(), 0 * a, R * (1 - a.cos())), -1)
    turn = twist * s
    c, d = torch.stack((0 * a, 1 + 0 * a, 0 * a), -1), torch.stack((-a.sin(), 0 * a, a.cos()), -1)
    t = torch.stack((a.cos(), 0 * a, a.sin()), -1)
    y = turn.cos()[:, None] * c + turn.sin()[:, None] * d
    frames = torch.stack((t, y, torch.linalg.cross(t, y)), -1)
    scene = tb.Scene(beam)
    return scene, tb.State.from_nodes(scene, nodes, frames)


@pytest.mark.parametrize("angle", [0.5, 1.2, 3.0])
def test_an_arc_bends_by_its_angle(angle):
    """Of order 1 to rounding, a pure twist not at all; its chord is sin(a/2)/(a/2) of it. Of order
    2, whose stations each see half of it, to 1 % at 3 rad.
    """
    scene, state = arc(angle)
    bend, length = deformations(discretise(scene), state.position, state.rotation)
    assert_close(bend, torch.full_like(bend, angle))
    assert_close(length, torch.full_like(length, math.sin(angle / 2) / (angle / 2)))
    scene, state = arc(1e-9, twist=angle)
    assert deformations(discretise(scene), state.position, state.rotation)[0].max() < 1e-6
    scene, state = arc(angle, order=2)
    bend, _ = deformations(discretise(scene), state.position, state.rotation)
    assert_close(bend, torch.full_like(bend, angle), rtol=1e-2, atol=0.0)


def said(call):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in seen]


@pytest.mark.parametrize("plane", [None, "xz"])
@pytest.mark.parametrize("order", [1, 2])
def test_an_equilibrium_names_the_element(plane, order):
    """Under a moment each element bends by M h/EI: by 0.7 rad of order 1 without a word, by 0.9 of
    the second sample with one; of order 2, whose error is that of half the angle, by twice that.
    """
    moments = 4 * order * torch.tensor([0.7, 0.9], dtype=torch.float64)
    moment = torch.stack((0 * moments, -moments, 0 * moments), -1)
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, ROD, order=order), [tb.TipLoad(moment=moment)], plane=plane
    )
    with pytest.warns(RuntimeWarning, match=WARNED.format(r"\d", "")) as seen:
        tb.equilibrium(scene)
    assert len(seen) == 1


def struck():
    """A structure; its second beam's tip is struck, in the second sample hard."""
    rod = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=0.1)
    beams = {
        name: tb.Beam.straight(1.0, n, rod, root=(0, float(n), 0))
        for name, n in (("a", 4), ("b", 3))
    }
    force = torch.tensor([[0, 0, 0.1], [0, 0, 40.0]])
    loads = [tb.PointLoad(("b", -1), force=force), tb.Damping(1e-2)]
    return tb.Scene(beams, loads, supports=[tb.Support((name, 0)) for name in beams])


@pytest.mark.parametrize("steps", [dict(step=1e-2), dict(rtol=1e-1)])
def test_a_motion_says_which_since_when(steps):
    (sentence,) = said(lambda: tb.simulate(struck(), torch.linspace(0, 0.05, 6), **steps))
    assert "element 0 of 'b', sample 1 (1 of 2), at t = 0.0" in sentence


def test_an_explicit_motion_is_looked_at():
    scene, state = arc(1.2)
    solid = tb.Section.circle(0.01, E=1e6, nu=0.3, rho=1000.0)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, solid))
    (sentence,) = said(lambda: tb.simulate(scene, [0.0, 1e-4], initial=state, method="dopri5"))
    assert "bends by 1.2 rad" in sentence


def test_steps_are_not_looked_at():
    """Nothing is asked of what a `Stepper` makes, as environments do."""
    stepper = tb.Stepper(struck(), 1e-2)

    def run():
        state = stepper.rest((2,))
        for _ in range(5):
            state = stepper(state)

    assert not said(run)


def test_a_stiffness_in_other_units():
    """E in GPa: a beam of 4 m under 10 kN/m stretches ten thousand times, and is told so."""
    section = tb.Section.rectangle(width=0.1, height=0.2, E=210, nu=0.3, rho=7850.0)
    ends = [tb.Support(0, rotation="xz"), tb.Support(-1, position="yz", rotation="xz")]
    beam = tb.Beam.straight(4.0, 4, section)
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -1e4))], supports=ends, plane="xz")
    with pytest.warns(RuntimeWarning, match=r"stretched to .* times its length: are stiffness"):
        tb.equilibrium(scene)
    small = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -1e4))], supports=ends, small=True)
    assert not any("stretched" in sentence for sentence in said(lambda: tb.equilibrium(small)))


@pytest.mark.parametrize("steps", [dict(step=1e-2), dict(rtol=1e-3)])
def test_a_failed_step_names_the_element_that_folds(steps):
    """One element cannot be bent by half a turn: no advice of a smaller step helps."""
    rod = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=0.1)
    scene = tb.Scene(tb.Beam.straight(1.0, 1, rod), [tb.TipLoad(moment=(0, -30.0, 0))], plane="xz")
    solution = tb.simulate(scene, torch.linspace(0, 0.2, 21), **steps)
    (reason,) = solution.stats.reason.values()
    assert re.search("element 0.* bends by", reason) and "smaller" not in reason, reason
