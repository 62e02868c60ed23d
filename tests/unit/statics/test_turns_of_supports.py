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


@pytest.mark.steps
@pytest.mark.parametrize("how", ["eager", "compiled", "relax"])
@pytest.mark.parametrize("first, then", [(2.0, 3.0), (6.0, 7.0), (12.0, 11.0), (11.0, 11.0)])
def test_supports_go_on_from_an_initial_shape(how, first, then):
    """Not from where the beam has them: of a shaft that had been turned by 6 rad, 7 rad became
    13.3, as the way there led back through less than 6.
    """
    options = dict(relax=True) if how == "relax" else dict(engine=how)
    begun = tb.equilibrium(shaft(first))
    state = tb.equilibrium(shaft(then), initial=begun, **options)
    assert int(state.status) == 0
    assert_close(state.reaction[0, 3], torch.tensor(-0.7 * then), rtol=1e-6, atol=0)


def test_each_sample_goes_on_from_its_own():
    """By turns and with a displacement; a shape that no support has moved yet is turned by all of
    it; derivatives by the turn are those from there.
    """
    first, then = torch.tensor([0.0, 2.0, 6.0, 6.0]), torch.tensor([7.0, 3.0, 7.0, 5.0])
    then.requires_grad_()

    def scene(turn):
        zero = torch.zeros_like(turn)
        to = torch.stack((turn, zero, zero), -1)
        move = torch.stack((zero, 0.002 * turn, zero), -1)
        turned = tb.Support(-1, "yz", "xyz", turn=to, displacement=move)
        return tb.Scene(tb.Beam.straight(1.0, 8, SHAFT), [], supports=[tb.Support(0), turned])

    begun = tb.equilibrium(scene(first))
    state, anew = (tb.equilibrium(scene(then), initial=at) for at in (begun, None))
    assert_close(state.reaction[:, 0, 3], anew.reaction[:, 0, 3], rtol=1e-6, atol=0)
    slopes = [torch.autograd.grad(x.reaction[:, 0, 3].sum(), then)[0] for x in (state, anew)]
    assert_close(*slopes, rtol=1e-5, atol=0)
