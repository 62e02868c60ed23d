"""Reduced states: what a solution reads of the tip, the nodes and the root without its states is
what these hold.
"""

import pickle

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.operations import Counter

SECTION = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)


def swing(force=0.3, engine="eager", step=0.01, **options):
    """Three samples, two steps of 10 ms from one instant to the next."""
    force = torch.as_tensor(force) * torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 3]])
    scene = tb.Scene(
        tb.Beam.straight(1.0, 2, SECTION, up=(0.0, 0, 1), root=(0, 0.1, 0)),
        [tb.TipLoad(force=force)],
        **options,
    )
    return tb.simulate(scene, torch.linspace(0, 0.06, 4), step=step, engine=engine)


def views(of):
    return {
        **dict(zip(("position", "velocity", "rotation", "spin"), of.tip, strict=True)),
        "nodes": of.nodes,
        "force": of.root.force,
        "moment": of.root.moment,
    }


@pytest.mark.parametrize("options", [{}, {"plane": "xz"}, {"small": True}], ids=str)
def test_a_solution_reads_what_its_states_hold(options):
    """To the rounding of products with ones and zeros, before and after the states are made;
    energies and pickles likewise.
    """
    solution = swing(**options)
    before = views(solution)
    assert len(solution.states.parts) > 1 and solution.status.shape == (3,)
    energy, wanted = solution.energy, views(solution.state)
    assert len(solution.states.parts) == 1  # what was joined is not kept twice
    again = pickle.loads(pickle.dumps(solution))
    for name, value in wanted.items():
        for found in (before, views(solution), views(again)):
            assert_close(found[name], value, rtol=0, atol=1e-15, msg=name)
    assert_close(again.energy.strain, energy.strain)
    assert "4 instants" in repr(solution) and "State of 3 nodes" in repr(solution)


def test_reading_the_tip_makes_no_other_field():
    """Operations of torch: those of one node's position (a cut and a join of each part, and two or
    three of the plane), whatever else the states hold.
    """

    solution = swing(plane="xz")
    with Counter() as made:
        _ = solution.tip.position
    assert made.count <= 6 * len(solution.states.parts) + 6


def test_a_gradient_survives_what_was_read_without():
    """The tip's derivative by the force, after the states were asked for without a graph."""
    found = []
    for first in (True, False):
        force = torch.tensor(0.3, requires_grad=True)
        solution = swing(force, plane="xz")
        if first:
            with torch.no_grad():
                _ = solution.state
        found += [
            torch.autograd.grad(x[-1].sum(), force, retain_graph=True)[0]
            for x in (solution.tip.position, solution.state.position[..., -1, :])
        ]
    for other in found[1:]:
        assert_close(other, found[0])


@pytest.mark.parametrize("step", [0.01, 0.02])
def test_native_code_keeps_what_is_asked_for_alone(step):
    """One state of two steps, or of one; a gradient keeps all. The answers are the same."""
    pytest.importorskip("llvmlite")
    with torch.no_grad():
        few = swing(plane="xz", engine="compiled", step=step)
    force = torch.tensor(0.3, requires_grad=True)
    every = swing(force, plane="xz", engine="compiled", step=step)
    assert len(few.stats.iterations) == len(every.stats.iterations) == round(0.06 / step)
    assert_close(few.state.position, every.state.position.detach(), rtol=0, atol=0)
    assert_close(few.state.t, every.state.t)
    assert_close(few.state.stress, swing(plane="xz", step=step).state.stress, rtol=0, atol=1e-10)


def test_a_sample_that_fails_between_two_instants():
    """One of three samples stops within an interval: its neighbours go on as alone, and it keeps
    its last good state.
    """
    pytest.importorskip("llvmlite")
    found = []
    for engine in ("eager", "compiled"):
        force = torch.tensor([[0.0, 0, 0.3], [0, 0, 0.3], [0, 0, 0.6]])

        def pull(t, force=force):
            return torch.where((t > 0.033) & (torch.arange(3) == 1)[:, None], torch.nan, force)

        scene = tb.Scene(tb.Beam.straight(1.0, 2, SECTION), [tb.TipLoad(force=pull)], plane="xz")
        with torch.no_grad(), pytest.warns(RuntimeWarning, match=r"sample 1 \(1 of 3\) stopped"):
            found.append(tb.simulate(scene, torch.linspace(0, 0.06, 4), step=0.005, engine=engine))
    assert found[0].status.tolist() == found[1].status.tolist() and found[1].status[1] != 0
    assert_close(found[1].state.position, found[0].state.position, rtol=0, atol=1e-12)
    assert_close(found[1].state.t, found[0].state.t)
