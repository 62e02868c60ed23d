"""Equilibria of joints with limits: what lies between these nothing holds, and it is found where
the limits hold it.

Beyond a limit by x an effort is k (x - e/2) once x is more than e, a hundredth of the range, so
that q = limit + effort/k + e/2.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

LIMIT, K, SOFT = 0.1, 1e3, 0.002
RESIST = dict(limits=(-LIMIT, LIMIT), limit_stiffness=K)
BOTH = dict(limits=[(-LIMIT, LIMIT)] * 2, limit_stiffness=(K, K))
BEAM = tb.Beam.straight(
    1.0, 1, tb.Section.rectangle(width=0.02, height=0.02, E=1e9, nu=0.3, rho=1000.0)
)
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
EFFORT = torch.tensor([10.0, -4.0, 0.0])


def along(axis):
    return EFFORT[:, None] * torch.tensor(axis)


CASES = {
    "slider, force": lambda: (tb.Slider(None, ("a", 0), **RESIST), dict(force=along(X))),
    "hinge, moment": lambda: (
        tb.Hinge(None, ("a", 0), axis=Y, **RESIST),
        dict(force=along((0.0, 0.0, 0.0)), moment=along(Y)),
    ),
    "cylindrical, both": lambda: (
        tb.Cylindrical(None, ("a", 0), **BOTH),
        dict(force=along(X), moment=along(X)),
    ),
    "cylindrical, drives": lambda: (
        tb.Cylindrical(None, ("a", 0), force=EFFORT, torque=EFFORT, **BOTH),
        None,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_loads_drive_comes_to_rest_at_the_limits(case):
    """A batch that is driven to either limit, and a sample that nothing drives: closed form."""
    joint, load = CASES[case]()
    effects = [] if load is None else [tb.PointLoad(("a", 0), **load)]
    state = tb.equilibrium(tb.Scene({"a": BEAM}, effects, joints=[joint]))
    want = EFFORT.sign() * (LIMIT + EFFORT.abs() / K + SOFT / 2)
    turn, travel = (
        state.joint[0].coordinate.expand(3, -1).unbind(-1)
        if (case.startswith("cylindrical"))
        else (state.joint[0].coordinate,) * 2
    )
    # balances to 1e-8 of 10 N, over k
    for coordinate in (turn, travel):
        assert_close(coordinate, want, rtol=0, atol=1e-9)


def test_a_spring_against_a_limit_is_in_balance_by_itself():
    """Drawn outside the limits, against which a spring presses: k_s q = k (0.2 - q - e/2)."""
    joint = tb.Slider(None, ("a", 0), limits=(0.2, 0.4), limit_stiffness=K, stiffness=50.0)
    state = tb.equilibrium(tb.Scene({"a": BEAM}, joints=[joint]))
    want = torch.tensor(K * (0.2 - SOFT / 2 + 0.0) / (K + 50.0))
    assert_close(state.joint[0].coordinate, want, rtol=0, atol=1e-9)


def test_the_place_at_a_limit_has_derivatives():
    """dq/dF = 1/k."""
    force = torch.tensor([10.0, -4.0], requires_grad=True)
    scene = tb.Scene({"a": BEAM}, joints=[tb.Slider(None, ("a", 0), force=force, **RESIST)])
    (slope,) = torch.autograd.grad(tb.equilibrium(scene).joint[0].coordinate.sum(), force)
    assert_close(slope, torch.full_like(force, 1 / K))
