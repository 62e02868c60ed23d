"""Loads as users write them run natively, as eager ones: values, gradients by numbers of the beam and of networks."""

import re

import pytest
import torch
from torch.testing import assert_close
from user_loads import LOADS, REFUSED

import torchbeam as tb
from torchbeam.dynamics.compiled.coverage import why_eager, why_not_traced
from torchbeam.nodal.discretise import discretise

pytest.importorskip("llvmlite")


def scene(load, EI=1.0):
    section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=EI, mass=0.3, inertia=1e-4)
    return tb.Scene(tb.Beam.straight(1.0, 2, section), [load, tb.TipLoad(force=(0.2, 0, 0.8)), tb.MassDamping(0.3)], plane="xz")


def parameters(load):
    """Of networks that a load closes over."""
    cells = getattr(getattr(load, "function", None), "__closure__", None) or ()
    return [p for cell in cells if isinstance(cell.cell_contents, torch.nn.Module) for p in cell.cell_contents.parameters()]


@pytest.mark.parametrize("name", LOADS)
def test_loads_that_users_write_run_natively_as_they_stand(name):
    """Three steps of 10 ms. float32: eager steps round the network's numbers, native ones do not."""
    load, found = LOADS[name](), {}
    single = any(p.dtype == torch.float32 for p in parameters(load))
    for engine in ("compiled", "eager"):
        EI = torch.tensor(1.0, requires_grad=True)
        run = scene(load, EI)
        stepper = tb.Stepper(run, 0.01, engine=engine)
        state = stepper.rest()
        for _ in range(3):
            state = stepper(state)
        assert not state.status.any()
        value = state.position[-1] + 0.1 * state.velocity[-1]
        slopes = torch.autograd.grad(value.sum(), [EI, *parameters(load)])
        found[engine] = value.detach(), slopes
    (value, slopes), (expected, gradient) = found.values()
    assert_close(value, expected, rtol=0, atol=1e-6 if single else 1e-12)
    for x, y in zip(slopes, gradient, strict=True):
        assert_close(x, y, rtol=1e-4 if single else 1e-9, atol=1e-4 if single else 1e-9 * max(1e-3, float(y.abs().max())))
    assert why_eager(discretise(run), "midpoint") is None  # "auto" takes it


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_native_code_says_why_and_runs_eagerly(name):
    load, said = REFUSED[name]
    load = load()
    model = discretise(scene(load))
    reason = why_eager(model, "midpoint") or why_not_traced(model, "midpoint")
    assert re.search(said, reason), reason
    with pytest.raises(ValueError, match="engine = 'compiled' was given"):
        tb.Stepper(scene(load), 0.01, engine="compiled")
