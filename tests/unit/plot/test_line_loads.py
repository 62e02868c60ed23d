"""Loads along beams as they are drawn: at nodes, and on both sides of a jump."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.loads import Nodes
from torchbeam.plot.line_loads import line_loads
from torchbeam.sensors.section_forces import bare_beams

SECTION = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)


def drawn(scene):
    """z of each node."""
    beam, model = scene.beam, discretise(scene)
    now = conditions(model, torch.tensor(0.0), {})
    nodes = Nodes(beam.nodes, beam.frames)
    return [
        [f[2].item() for f in each] for each in line_loads(model, bare_beams(scene), nodes, now)
    ]


@pytest.mark.parametrize("order, linked", [(1, False), (2, False), (1, True)])
def test_linear_loads_and_jumps(order, linked):
    """A triangle has its values at nodes, the ends included, with another load on top; a load by
    element has both values at a jump. To rounding.
    """
    beam = tb.Beam.straight(1.0, 4, SECTION, order=order)
    beam = beam.linked() if linked else beam
    triangle = tb.LineLoad(force=tb.Along(lambda s, t: (0.0, 0.0, 6 * s)))
    at_nodes = torch.tensor(drawn(tb.Scene(beam, [triangle, tb.LineLoad(force=(0, 0, 1.0))])))
    assert_close(at_nodes, 1 + torch.linspace(0, 6, 4 * order + 1)[:, None], rtol=0, atol=1e-12)
    half = torch.zeros(4, 3)
    half[2:, 2] = 5.0
    each = drawn(tb.Scene(beam, [tb.LineLoad(force=tb.PerElement(half))]))
    middle = 2 * order
    assert each[middle] == pytest.approx([0, 5], abs=1e-12)
    values = torch.tensor(each[:middle] + each[middle + 1 :])
    assert_close(values, 5.0 * (torch.arange(4 * order) >= middle)[:, None], rtol=0, atol=1e-12)
