"""Parts that are welded to a clamp, one after the other, and a beam in an elastic clamp, are held:
no search for mechanisms.
"""

import pytest
import torch

import torchbeam as tb
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.nodal.discretise import discretise
from torchbeam.statics.mechanism import clamped, unheld
from torchbeam.statics.rigid_motions import free_motions

SECTION = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
ARM, LEG = tb.Support(("arm", 0)), tb.Support(("leg", 0), "xyz", "")
CORNER, TIP = tb.Weld(("leg", 0), ("arm", -1)), tb.Weld("hub", ("leg", -1))


@pytest.mark.parametrize(
    ("joints", "supports", "held"),
    [
        ([CORNER, TIP], [ARM], True),
        ([TIP, CORNER, tb.Weld(("leg", 1), None)], [], True),
        ([CORNER], [ARM], False),
        ([CORNER, TIP], [LEG], False),
        ([CORNER, tb.Ball("hub", ("leg", -1))], [ARM], False),
    ],
)
def test_parts(joints, supports, held):
    """It says so where the search finds nothing, and not where it finds a motion."""
    parts = {
        "arm": tb.Beam.straight(1.0, 2, SECTION),
        "leg": tb.Beam.straight(1.0, 2, SECTION, root=(1.0, 0, 0), direction=(0, 0, 1)),
        "hub": tb.Body(0.1, 0.1, position=(1.0, 0, 1.0)),
    }
    model = discretise(tb.Scene(parts, joints=joints, supports=supports))
    assert clamped(model) == held
    assert (unheld(model, model.length.new_zeros(()), {})[0] == 0) == held


@pytest.mark.parametrize("length", [0.01, 1.0, 100.0])
def test_an_elastic_clamp(length):
    """It holds, alone, where all of its springs resist in all samples, in lengths of the beam.
    Where one of them does not, or hardly, or another load depends on how the beam stands, there is
    a search. It finds a motion in the first case alone.
    """
    beam, free = tb.Beam.straight(length, 2, SECTION), torch.ones(6).double()
    pull = tb.TipLoad(force=(0, 0, 1.0))
    even = torch.tensor([1 / length**2] * 3 + [1.0] * 3).double()
    softer = [
        even * torch.where(torch.arange(6) == k, s, free) for k in range(6) for s in (0, 1e-9)
    ]
    batch = torch.stack((even, 10 * even, even))
    for k, held, effects in (
        (even, True, []),
        (even * torch.tensor([1e4] * 3 + [1.0] * 3).double(), True, [pull]),
        (batch, True, []),
        (torch.cat((batch, softer[0][None])), False, []),
        *((one, False, []) for one in softer),
        (even, False, [tb.Spring(-1, stiffness=1.0, to=(0.0, 0.0, 1.0))]),
    ):
        model = discretise(tb.Scene(beam, [tb.RootSpring(k), *effects]))
        assert clamped(model) == held
        problem = SteadyProblem(model, even.new_zeros(()), {}, even.new_ones(()))
        x = model.space.start(tb.rest(model.scene))
        x = Configuration(x.position, x.rotation, torch.zeros_like(x.stress))
        left = free_motions(problem, x).diagonal(dim1=-2, dim2=-1).sum(-1).round()
        assert bool(left.any()) == (not held and not effects)
