"""Position: a marker at any place along a beam, and off its axis."""

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals

SECTION = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1.0, EI=1.0, mass=0.2, inertia=1e-5)
BEAM = tb.Beam.straight(1.0, 6, SECTION)


def bent(beam=BEAM, force=(0.0, 0.4, 1.5)):
    return tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=force)]))


def test_at_nodes_it_is_where_they_are_with_their_sections():
    state = bent()
    for node in (0, 2, 6):
        point = torch.tensor([0.01, -0.02, 0.03])
        marker = tb.sensors.Position(node / 6, BEAM, point=point)
        there = state.position[node] + state.axes[node] @ point
        torch.testing.assert_close(marker(state), there, rtol=0, atol=1e-13)


@pytest.mark.parametrize("order", [1, 2])
def test_a_bent_circle_to_the_order_of_the_elements(order):
    """Under a tip moment the axis is a circle of curvature 2 per m, the section turned by 2 s."""
    s = torch.tensor([0.13, 0.5, 0.77])
    wrong = []
    for elements in (4, 8):
        beam = tb.Beam.straight(1.0, elements, SECTION, order=order)
        state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(moment=(0, -2.0, 0))]))
        a = 2 * s
        axis = torch.stack((a.sin() / 2, 0 * a, (1 - a.cos()) / 2), -1)
        exact = axis + 0.02 * torch.stack((-a.sin(), 0 * a, a.cos()), -1)
        wrong.append((tb.sensors.Position(s, beam, point=(0, 0, 0.02))(state) - exact).norm())
    assert wrong[1] < wrong[0] / (3.5 if order == 1 else 7)
    assert wrong[1] < (4e-3 if order == 1 else 1e-4)


def test_between_the_nodes_of_an_arc_it_is_on_the_arc():
    """The interpolation alone: nodes on a circle of radius 0.5 m, 0.25 rad apart. At the angle a
    the chord to the root is 2 R sin(a/2). A cubic errs by R phi^4/384 = 5e-6 m, a straight line by
    R phi^2/8 = 4e-3 m.
    """
    arc, share = tb.Beam.arc(0.5, 1.5, 6, SECTION), torch.linspace(0.03, 0.97, 9)
    points = tb.sensors.Position(share * arc.length.sum(), arc)(tb.rest(tb.Scene(arc)))
    chord = torch.linalg.vector_norm(points - arc.nodes[0], dim=-1)
    torch.testing.assert_close(chord, (1.5 * share / 2).sin(), rtol=0, atol=6e-6)


def test_gradients_by_state_station_and_point_are_those_of_differences():
    def read(force, station, point):
        return tb.sensors.Position(station, BEAM, point=point)(bent(force=force))

    given = [
        torch.tensor(x, dtype=torch.float64, requires_grad=True)
        for x in ((0.1, 0.4, 1.5), 0.37, (0.0, 0.02, 0.01))
    ]
    assert torch.autograd.gradcheck(read, given, eps=1e-5, atol=1e-6)


def test_a_batch_is_each_of_its_samples():
    forces = torch.tensor([[0, 0, 1.0], [0, 0.5, -1.0], [0.2, 0, 2.0]])
    stations, points = torch.tensor([0.2, 0.55, 0.9]), 0.01 * torch.eye(3)
    together = tb.sensors.Position(stations, BEAM, point=points)(bent(force=forces))
    for k in range(3):
        alone = tb.sensors.Position(stations[k], BEAM, point=points[k])(bent(force=forces[k]))
        torch.testing.assert_close(together[k], alone, rtol=0, atol=1e-12)


def test_its_rate_is_the_velocity_of_the_point():
    load = tb.TipLoad(force=lambda t: torch.stack((0 * t, 0.3 * t, t)) * 20)
    t = torch.linspace(0, 0.1, 41)
    solution = tb.simulate(tb.Scene(BEAM, [load, tb.Damping(0.01)]), t, step=2.5e-3)
    point = torch.tensor([0.0, 0.01, 0.02])
    marker = tb.sensors.Position(4 / 6, BEAM, point=point)
    rate = tb.observe(solution, marker, t[5:35], rate=True)
    spin, axes = tb.sensors.Spin(4)(solution.state), solution.state.axes[:, 4]
    rigid = solution.state.velocity[:, 4] + torch.linalg.cross(spin, axes @ point)
    torch.testing.assert_close(rate, rigid[5:35], rtol=2e-3, atol=2e-3 * rigid.abs().max().item())


def test_on_a_part_of_a_structure():
    supports = [tb.Support((name, 0)) for name in "ab"]
    load = tb.PointLoad(("b", -1), force=(0, 0, 1.0))
    scene = tb.Scene({"a": BEAM, "b": BEAM}, [load], supports=supports)
    state = tb.equilibrium(scene)
    marker = tb.sensors.Position(0.5, scene, on="b", point=(0, 0, 0.01))
    alone = tb.sensors.Position(0.5, BEAM, point=(0, 0, 0.01))
    torch.testing.assert_close(marker(state), alone(state["b"]))


@refusals(
    (dict(station=1.2), "0 to that are wanted"),
    (dict(station=0.5, point=(0, 0)), "point"),
    (dict(station=float("nan")), "station"),
)
def test_what_is_no_place_is_refused(given):
    tb.sensors.Position(**given, beam=BEAM)
