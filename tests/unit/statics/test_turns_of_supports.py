"""Supports that turn by more than once: what holds a node tells its rotation, not how often it has
turned.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SHAFT = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=0.7, EI=1.0, mass=1.0, inertia=1e-4)


def shaft(turn):
    """Clamped at one end, turned about its axis at the other, which may slide."""
    turned = tb.Support(-1, "yz", "xyz", turn=(turn, 0.0, 0.0))
    return tb.Scene(tb.Beam.straight(1.0, 8, SHAFT), [], supports=[tb.Support(0), turned])


FOUND = {
    "eager": lambda scene: tb.equilibrium(scene, engine="eager"),
    "compiled": lambda scene: tb.equilibrium(scene, engine="compiled"),
    "relax": lambda scene: tb.equilibrium(scene, relax=True),
    "path": lambda scene: tb.path(scene, 1.0).state[-1],
}


@pytest.mark.steps
@pytest.mark.parametrize("how", FOUND)
@pytest.mark.parametrize("turn", [2.0, 6.2, -12.0])
def test_a_shaft_is_twisted_by_all_of_it(how, turn):
    """Moment at the clamp GJ turn/L, to 2 %: elements of one eighth turn by up to 1.5 rad. 6.2 rad
    are nearly a whole turn, of which nothing was left.
    """
    state = FOUND[how](shaft(turn))
    assert int(state.status) == 0
    assert_close(state.reaction[0, 3], torch.tensor(-0.7 * turn), rtol=0.02, atol=0)
