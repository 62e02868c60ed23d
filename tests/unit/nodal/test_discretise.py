"""A scene's model is shared by what asks for it while something holds it, and never one of other
numbers.
"""

import copy
import pickle

import pytest
import torch

import torchbeam as tb
from torchbeam.nodal.discretise import discretise


def scene() -> tb.Scene:
    section = tb.Section.rectangle(3e-3, 10e-3, 68.9e9, 0.33, 2700.0)
    beam = tb.Beam.straight(1.0, 2, section)
    return tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), tb.PointMass(torch.tensor([0.1, 0.2]))])


def test_a_model_is_that_of_the_last_call():
    """As long as something holds it; copies of the scene have one of their own."""
    own = scene()
    stepper = tb.Stepper(own, 0.01)
    assert discretise(own) is stepper.model
    assert discretise(own, lumped=True) is not stepper.model
    for other in (copy.copy(own), copy.deepcopy(own), pickle.loads(pickle.dumps(own))):
        assert discretise(other) is not stepper.model


@pytest.mark.parametrize("write", ["torch", "numpy", "data"])
def test_numbers_that_were_written_to_make_another_model(write):
    """By whatever way: the equilibrium is that of a scene made anew with these numbers, to the bit
    (the same operations on the same shapes).
    """
    own = scene()
    stepper, before = tb.Stepper(own, 0.01), tb.equilibrium(own)
    mass = own.effects[1].mass
    if write == "torch":
        mass.mul_(2)
    elif write == "numpy":
        mass.numpy()[:] *= 2
    else:
        mass.data *= 2
    after, anew = tb.equilibrium(own), tb.equilibrium(copy.deepcopy(own))
    assert discretise(own) is not stepper.model
    assert torch.equal(after.position, anew.position)
    assert not torch.allclose(after.position, before.position, rtol=1e-6)


@pytest.mark.parametrize("write", ["torch", "numpy", "data"])
def test_numbers_that_were_written_to_and_back_are_as_before(write):
    """A step between the two leaves nothing with the model that others share, by whatever way: the
    equilibrium and a step are to the bit those of a copy of the scene.
    """
    pytest.importorskip("llvmlite")
    force = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    section = tb.Section.rectangle(3e-3, 10e-3, 68.9e9, 0.33, 2700.0)
    own = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.PointLoad(-1, force=force)])
    tb.Stepper(copy.deepcopy(own), 0.01, engine="compiled")  # its structure is known from here on
    kept = tb.Stepper(own, 0.01, engine="compiled")
    value = {"torch": force, "numpy": force.numpy(), "data": force.data}[write]
    value *= 2
    kept(kept.rest())
    value /= 2
    pairs = [
        (tb.equilibrium(scene, engine="compiled"), stepper(stepper.rest()))
        for scene in (own, copy.deepcopy(own))
        for stepper in [tb.Stepper(scene, 0.01, engine="compiled")]
    ]
    for after, anew in zip(*pairs, strict=True):
        assert torch.equal(after.position, anew.position)


def test_a_model_with_derivatives_is_nobody_elses():
    """A second backward pass does not meet the freed graph of the first."""
    section = tb.Section.rectangle(3e-3, 10e-3, 68.9e9, 0.33, 2700.0)
    mass = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)
    own = tb.Scene(
        tb.Beam.straight(1.0, 2, section), [tb.Gravity((0, 0, -9.81)), tb.PointMass(mass)]
    )
    with torch.no_grad():
        stepper = tb.Stepper(own, 0.01)
    first, second = (
        torch.autograd.grad(tb.equilibrium(own).tip.position[2], mass)[0] for _ in range(2)
    )
    assert discretise(own) is not stepper.model
    assert first == second < 0
