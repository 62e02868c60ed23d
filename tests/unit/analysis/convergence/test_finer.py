"""Runs that are finer than the user asked for, read at the nodes of the user's mesh."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.analysis.convergence.finer import finer


def column(elements, order=1, force=-1.0):
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=1.0, inertia=1e-4)
    beam = tb.Beam.straight(1.0, elements, section, order=order)
    return tb.Scene(beam, [tb.TipLoad(force=(0.3 * force, 0, force))], plane="xz")


def simulated(elements, order):
    scene = column(elements, order)
    start = tb.equilibrium(scene)
    return tb.simulate(scene, [0.0, 0.1], start, step=0.05, engine="eager").nodes


CALLS = {
    "equilibrium": lambda *mesh: tb.equilibrium(column(*mesh)).position,
    "simulate from an equilibrium": simulated,
    "modes": lambda *mesh: tb.modes(column(*mesh), count=2).shape.abs(),
    "modes about a state": lambda *mesh: tb.modes(
        column(*mesh), tb.equilibrium(column(*mesh)), 2
    ).shape.abs(),
    "path": lambda *mesh: tb.path(column(*mesh), step=1.0).state.position,
    "rest": lambda *mesh: tb.rest(column(*mesh)).position,
    "critical_load": lambda *mesh: tb.critical_load(
        lambda f: column(*mesh, force=-f), 4.0, points=3, count=2
    ).shape.abs(),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", CALLS)
def test_results_have_the_nodes_of_the_users_mesh(name, order):
    """Twice the elements, at every second node: the numbers of a scene that was drawn so."""
    with finer(elements=2) as runs:
        runs.as_drawn = True
        coarse = CALLS[name](2, order)
    fine = CALLS[name](4, order)
    axis = -2
    assert runs.used and coarse.shape[axis] == 2 * order + 1
    assert_close(coarse, fine[..., ::2, :], rtol=1e-6, atol=1e-8)


def test_sensors_of_a_linear_model_stay_where_they_are():
    """A sensor at a node, and a function of states that reads one, at half of the length."""
    with finer(elements=2) as runs:
        runs.as_drawn = True
        coarse = tb.linearize(
            column(2), None, [tb.sensors.NodePosition(1), lambda state: state.position[..., 1, :]]
        )
    half = tb.linearize(column(4), None, [tb.sensors.NodePosition(2)]).output
    assert_close(coarse.output, torch.cat((half, half), -1))


def test_stress_of_elements_is_no_number_on_another_mesh():
    with finer(elements=2) as runs:
        runs.as_drawn = True
        state = tb.equilibrium(column(2))
    assert state.stress.shape == (2, 6) and state.stress.isnan().all()
    assert torch.isfinite(state.reaction).all()
