"""Sensors of contact against what must hold them: weight on a floor."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-4)


def resting(**given):
    """A beam at rest on a floor, and one that hangs far above."""
    q, d, P = 0.2 * 9.81, 1e-3, 4.0
    height = torch.stack((torch.tensor(0.01 + d * (1 - (q / P) ** 0.5)), torch.tensor(1.0)))
    beam = tb.Beam.straight(1.0, 3, SECTION)
    contact = tb.Contact(
        tb.Plane((0, 0, 0), (0, 0, 1.0)), thickness=d, force=P, radius=0.01, **given
    )
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), contact], supports=())
    state = tb.rest(scene, (2,))
    up = height[:, None, None] * torch.tensor([0.0, 0, 1])
    return scene, state.map(lambda x: x + up if x is state.position else x)


def test_force_gap_and_slip():
    """The weight, by elements too; the gap that the law states; a beam pulled along slips."""
    scene, state = resting(friction=0.3, slip_speed=0.1)
    weight = torch.tensor([[0.0, 0, 0.2 * 9.81], [0.0, 0, 0]])
    S = tb.sensors
    assert_close(S.ContactForce(scene)(state), weight, rtol=0, atol=1e-12)
    forces = S.ContactForces(scene)(state)
    assert forces.shape == (2, 3, 3)
    assert_close(forces.sum(-2), weight, rtol=0, atol=1e-12)
    assert_close(
        S.ContactGap(scene)(state)[:, 0], torch.tensor([1e-3 * (1 - (1.962 / 4) ** 0.5), 0.99])
    )
    points = S.ContactPoints(scene)(state)
    assert_close(points[..., 3:6].sum(-2), weight, rtol=0, atol=1e-12)
    assert_close(points[..., 2], S.ContactGap(scene)(state).expand(2, 6))  # of the floor at 0
    pressure = torch.stack((weight[:, 2], torch.tensor([1e-3 * (1 - (1.962 / 4) ** 0.5), 0.0])), -1)
    assert_close(S.ContactPressure(scene)(state), pressure)
    assert_close(S.ContactSlip(scene)(state), torch.tensor([[0.0, 1.0], [0.0, 0.0]]))
    moving = state.map(lambda x: x + torch.tensor([0.5, 0, 0]) if x is state.velocity else x)
    assert_close(S.ContactSlip(scene)(moving), torch.tensor([[0.5, 0.0], [0.0, 0.0]]))
    assert_close(S.ContactForce(scene)(moving)[0, 0], torch.tensor(-0.3 * 1.962))


ROD = tb.Section.circle(0.005, E=1e8, nu=0.35, rho=1200.0)
LAW = dict(radius=0.005, thickness=2e-3, force=500.0)


def crossing():
    """Two rods, one across the other, which overlap."""
    upper = tb.Beam.straight(0.1, 3, ROD, root=(0, -0.05, 0.0095), direction=(0.1, 1, 0))
    parts = {"lower": tb.Beam.straight(0.12, 3, ROD, root=(-0.06, 0, 0)), "upper": upper}
    return tb.Scene(parts, [tb.Contact("lower", "upper", **LAW, points=5)])


def on_a_body():
    """A rod that a box stands in, which stands on a floor."""
    box = tb.Body(0.1, 1e-5, surface=tb.Box((0, 0, 0), (0.04, 0.04, 0.03), 0.005))
    parts = {"rod": tb.Beam.straight(0.12, 3, ROD, root=(-0.06, 0, 0.0205)), "box": box}
    floor = tb.Contact("box", tb.Plane((0, 0, -0.0155), (0.01, 0, 1)), thickness=1e-3, force=1.0)
    return tb.Scene(parts, [tb.Contact("box", "rod", **LAW | dict(radius=None), other_radius=0.005),
                            floor])  # fmt: skip


PLACES = {
    "two rods": (crossing, 0, 40, 0.0, 0.0095),
    "a rod on a box": (on_a_body, 0, 8, 0.0155, 0.0155),
    "a box on a floor": (on_a_body, 1, 8, -0.0151, 0.0151),
}


@pytest.mark.parametrize("case", PLACES)
def test_each_place_by_itself(case):
    """They sum up to the whole, and the smallest of the gaps is the gap; where forces are, is the
    surface between two heights.
    """
    build, number, count, low, high = PLACES[case]
    scene = build()
    state = tb.rest(scene)
    sensor = tb.sensors.ContactPoints(scene, number)
    points = sensor(state)
    assert points.shape == sensor.shape == (count, 7) and len(sensor.labels) == 7 * count
    force = tb.sensors.ContactForce(scene, number)(state)
    assert force.norm() > 0.1
    assert_close(points[:, 3:6].sum(0), force)
    assert_close(points[:, 6].amin()[None], tb.sensors.ContactGap(scene, number)(state))
    there = points[points[:, 3:6].norm(dim=-1) > 0]
    assert (there[:, 6] < 2e-3).all() and 0 < len(there) < count
    assert (there[:, 2] > low - 1e-3).all() and (there[:, 2] < high + 1e-3).all()


def test_forces_of_a_structure():
    """A contact of one beam has a force for each of its elements; of all, for all of them."""
    bars = {
        name: tb.Beam.straight(1.0, n, SECTION, root=(0, y, 0.0105))
        for name, n, y in (("one", 3, 0.0), ("two", 2, 1.0))
    }
    for on, count in (("two", 2), (None, 5)):
        floor = tb.Plane((0, 0, 0), (0, 0, 1.0))
        contact = tb.Contact(floor, thickness=1e-3, force=4.0, radius=0.01, on=on)
        scene = tb.Scene(bars, [contact], supports=())
        sensor = tb.sensors.ContactForces(scene)
        assert sensor(tb.rest(scene)).shape == sensor.shape == (count, 3)
        assert sensor["z of element 1"](tb.rest(scene)) > 0
        assert len(sensor.labels) == sensor.size


@pytest.mark.steps
def test_first_touch_is_an_event():
    """A free fall by a metre's hundredth less the thickness: t = sqrt(2 h/g)."""
    beam = tb.Beam.straight(1.0, 2, SECTION)
    contact = tb.Contact(tb.Plane((0, 0, -0.01), (0, 0, 1.0)), thickness=1e-3, force=4.0)
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), contact], supports=())
    gap = tb.sensors.ContactGap(scene)
    solution = tb.simulate(
        scene, torch.linspace(0, 0.1, 6), rtol=1e-4, events=lambda state: gap(state)[..., 0] - 1e-3
    )
    assert_close(solution.event.t, torch.tensor((2 * 0.009 / 9.81) ** 0.5), rtol=1e-3, atol=0)


def test_what_has_no_such_contact_is_refused():
    scene, state = resting()
    with pytest.raises(ValueError, match="contact = 1"):
        tb.sensors.ContactGap(scene, 1)
    with pytest.raises(ValueError, match="without friction"):
        tb.sensors.ContactSlip(scene)(state)


def test_the_force_of_a_step_is_that_of_its_middle():
    """A body that sticks on a slope: m g sin(a). The midpoint rule lets velocities alternate from
    step to step where friction g dt is far above the slip speed, and forces read at the ends with
    them, by more than 1 %. At the mean of two states it is the force of the step, to 1e-3: its
    normal part still settles.
    """
    a, R, m = math.radians(20), 0.02, 0.2
    out, down = (-math.sin(a), 0.0, math.cos(a)), (math.cos(a), 0.0, math.sin(a))
    law = dict(thickness=1e-3, force=20.0, damping=0.5, friction=0.8, slip_speed=1e-4)
    scene = tb.Scene(
        {"box": tb.Body(m, 1e-5, position=tuple(R * x for x in out))},
        [tb.Contact("box", tb.Plane((0, 0, 0), out), radius=R, **law), tb.Gravity((0, 0, -9.81))],
        supports=[tb.Support("box", position="", rotation="xyz")],
    )
    solution = tb.simulate(scene, torch.linspace(0, 0.2, 101), step=2e-3, engine="compiled")
    states, along = solution.state[-5:], torch.tensor(down, dtype=torch.float64)
    middle = states[:-1].map(lambda x, y: (x + y) / 2, states[1:])
    ends, steps = (tb.sensors.ContactForce(scene)(x) @ along for x in (states, middle))
    exact = m * 9.81 * math.sin(a)
    assert_close(steps, torch.full_like(steps, exact), rtol=1e-3, atol=0.0)
    assert ((ends - exact).abs() > 1e-2 * exact).all()


def test_a_reading_far_away_costs_no_pairs():
    """The force of beams that are far apart is 0; the gap is that of all places."""
    parts = {
        name: tb.Beam.straight(1.0, 4, SECTION, root=(0, y, 0))
        for name, y in (("a", 0.0), ("b", 1.0))
    }
    law = dict(radius=0.01, thickness=1e-3, force=10.0)
    scene = tb.Scene(parts, [tb.Contact("a", "b", **law)], supports=[])
    state, sensors = tb.rest(scene), tb.sensors
    assert sensors.ContactForce(scene)(state).tolist() == [0, 0, 0]
    assert sensors.ContactPressure(scene)(state).tolist() == [0, 0]
    assert_close(sensors.ContactGap(scene)(state), torch.tensor([0.98], dtype=torch.float64))
