"""Parts that are welded to a clamp, one after the other, are held: no search for mechanisms."""

import pytest

import torchbeam as tb
from torchbeam.nodal.discretise import discretise
from torchbeam.statics.mechanism import clamped, unheld

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
