"""Compiled steps beside eager ones where something changes from place to place or from step to step: values, and gradients by
all that it brings.
"""

from dataclasses import replace

import pytest
import torch
from compiled_step_cases import moving, section
from torch.testing import assert_close

import torchbeam as tb

pytest.importorskip("llvmlite")
FIELDS = ("position", "rotation", "velocity", "spin", "stress", "reaction", "work", "defect", "t", "frame", "internal")


class Draw(dict):
    """Tensors by name, made where they are asked for."""

    def __call__(self, name, *shape):
        generator = torch.Generator().manual_seed(len(self))
        self[name] = torch.rand(shape, generator=generator).add_(0.5).requires_grad_()
        return self[name]


def beam(by, N=3, **more):
    return tb.Beam.straight(by("length"), N, section(EI=3 * by("EI"), mass=0.5 * by("mass"), **more))


def wave(by, name, size=1.0):
    """A function of t, zero at t = 0 with its rate."""
    amplitude, rate = by(name, 3), by(f"{name} rate")
    return lambda t: size * amplitude * (1 - torch.cos(20 * rate * t))


def line_loads(by):
    def pull(r, R, v, w, t, k, c, b):
        return -k[..., None] * r - c[..., None] * v * torch.cos(t) + b[..., None] * R[..., 1], None

    turning = by("turning", 3, 3)
    return dict(effects=[
        tb.LineLoad(force=tb.PerElement(by("force", 2, 3, 3)), moment=0.01 * by("moment", 3), follower=True),
        tb.LineLoad(force=tb.PerElement(lambda t: torch.sin(9 * t) * turning), follower=True),
        tb.LineLoad(moment=tb.Along(lambda s, t: 0.01 * torch.stack((s * t, torch.cos(s), 0 * s), -1)), follower=True),
        tb.Load(pull, node=None, of=("position", "rotation", "velocity"),
                values=dict(k=by("of all"), c=by("of nodes", 4), b=by("of elements", 2, 3)))])


CASES = {"line loads by place": line_loads}


def ran(make, engine, gradient):
    """Four steps of two samples: (states, iterations, a number's gradients)."""
    by = Draw()
    given = make(by)
    scene = tb.Scene(given.pop("beam", None) or beam(by), **given)
    by["t"] = torch.linspace(0, 0.04, 5, requires_grad=True)
    with torch.no_grad():
        start = tb.rest(scene, (2,)) if scene.has_prescribed_motion else moving(scene, (2,), size=0.3)
    if not scene.has_prescribed_motion:
        by["velocity"] = start.velocity.clone().requires_grad_()
    inputs = {name: by(name, 2, size) for name, size in scene.inputs.items()}
    with torch.set_grad_enabled(gradient):
        solution = tb.simulate(scene, by["t"], replace(start, velocity=by.get("velocity", start.velocity)), step=0.01,
                               inputs=inputs, engine=engine)
    found = {name: x for name in FIELDS if (x := getattr(solution.state, name)) is not None}
    if not gradient:
        return found, solution
    generator = torch.Generator().manual_seed(3)
    value = sum((torch.randn(x.shape, generator=generator) * x).sum() for x in found.values()) + solution.energy.strain.sum()
    return dict(zip(by, torch.autograd.grad(value, list(by.values()), allow_unused=True), strict=True))


@pytest.mark.parametrize("name", CASES)
def test_steps_are_the_eager_ones(name):
    """Each field to 1e-12 of its largest number, each gradient to 1e-9."""
    (wanted, eager), (found, compiled) = (ran(CASES[name], engine, False) for engine in ("eager", "compiled"))
    assert not eager.status.any() and not compiled.status.any()
    assert_close(compiled.stats.iterations, eager.stats.iterations)
    for field, x in wanted.items():
        assert_close(found[field], x, rtol=0, atol=1e-12 * max(float(x.abs().max()), 1e-3), msg=lambda m, f=field: f"{f}: {m}")
    wanted, found = (ran(CASES[name], engine, True) for engine in ("eager", "compiled"))
    for field, x in wanted.items():
        assert (x is None) == (found[field] is None), field
        if x is not None:
            assert_close(found[field], x, rtol=0, atol=1e-9 * float(x.abs().max()), msg=lambda m, f=field: f"{f}: {m}")
