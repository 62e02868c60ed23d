"""Conditions: what loads hold is asked once for an instant; the physics, and native code, have
numbers alone.
"""

import pytest
import torch

import torchbeam as tb
from torchbeam.core.leaves import constant
from torchbeam.engine.chain.constants import Constants
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.discretise import discretise
from torchbeam.scene.effects import Along, PerElement

SECTION = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)
F = torch.tensor([0.1, -0.2, 0.3])


def scene(*loads):
    return tb.Scene(tb.Beam.straight(1.0, 3, SECTION), loads)


LOADS = {
    "function of t": lambda asked: tb.TipLoad(force=lambda t: asked(F * torch.cos(t))),
    "follower": lambda asked: tb.TipLoad(force=lambda t: asked(F * torch.cos(t)), follower=True),
    "along": lambda asked: tb.LineLoad(
        force=Along(lambda s, t: asked(s[..., None] * F * t)), follower=True
    ),
    "per element": lambda asked: tb.LineLoad(
        force=PerElement(lambda t: asked(F * t * torch.arange(3.0)[:, None]))
    ),
    "spring": lambda asked: tb.Spring(-1, stiffness=2.0, to=lambda t: asked(F * t), damping=0.1),
    "gravity": lambda asked: tb.Gravity(lambda t: asked(F * t)),
    "input": lambda asked: tb.TipLoad(force=tb.Input("u", 3), follower=True),
}


@pytest.mark.parametrize("name", LOADS)
def test_loads_hold_numbers_that_are_those_of_native_code(name):
    model = discretise(scene(LOADS[name](lambda x: x)))
    t, inputs = torch.tensor(0.3), {"u": F} if name == "input" else {}
    now = conditions(model, t, inputs)
    assert all(constant(one.load) for one in now.loads) and not constant(model.scene.loads[0])
    constants = Constants(model)
    nodes, _, common, *_ = constants.at(torch.tensor(0.1), t, inputs)
    loads = [row or load for row, load in zip(nodes.now.loads, common.now.loads, strict=True)]
    assert all(map(constant, loads)) and (bool(loads) or nodes.now.dead is not None)


@pytest.mark.parametrize("name", [name for name in LOADS if name not in ("input", "spring")])
def test_a_step_asks_a_function_of_time_once(name):
    """However many iterations it takes."""
    calls = []

    def asked(value):
        calls.append(value)
        return value

    stepper = tb.Stepper(scene(LOADS[name](asked)), 0.05, engine="eager")
    state = stepper.rest()
    calls.clear()
    state = stepper(state)
    assert stepper(state).status == 0 and len(calls) == 2
