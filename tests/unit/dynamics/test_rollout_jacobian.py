"""rollout_jacobian: rows of a jacobian of many steps, against gradients one by one."""

import sys
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
import torchbeam.dynamics.make_steps as make_steps

DT, STEPS = 0.02, 6
rollout_jacobian = sys.modules["torchbeam.dynamics.rollout_jacobian"]  # the name is the function's


def random(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def read(states):
    """(..., 5): of places, turns, velocities and stresses."""
    parts = states.position[..., -1, :2], states.rotation[..., 1, -1:] ** 2
    return torch.cat((*parts, states.velocity[..., 1, 1:2], states.stress[..., 0, -1:]), -1)


def case(batch=(3,), method="midpoint", engine="compiled", plane=None, **options):
    """Stepper, start, inputs, and what they were made of: the forces of each step through a map, a
    stiffness and a velocity.
    """
    EI = (1 + random(*batch, seed=1).abs()).requires_grad_()
    section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=EI, mass=0.5, inertia=0.01)
    effects = [tb.TipLoad(force=tb.Input("force", 3)), tb.Damping(1e-3)]
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), effects, plane=plane)
    stepper = tb.Stepper(scene, DT, method, engine=engine, **options)
    given = random(*batch, STEPS // 2, 2, seed=2).requires_grad_()
    inside = torch.tensor([1.0, 1.0, 0.0 if plane else 1.0])
    force = (given @ random(2, 3, seed=3) * inside).repeat_interleave(2, -2)
    speed = random(*batch, 1, seed=4).requires_grad_()
    moving = torch.tensor([0.0, 0.1, 0.2])[:, None] * (speed * torch.eye(3)[1])[..., None, :]
    start = replace(stepper.rest(batch), velocity=moving)
    start = stepper.begin(start, force=force[..., 0, :]) if "alpha" in method else start
    return stepper, start, {"force": tb.PerInterval(force)}, (given, EI, speed)


def row_by_row(stepper, start, inputs, by, every):
    states = tb.rollout(stepper, start, STEPS, inputs)
    values = read(states)[every - 1 :: every]
    rows = [
        torch.autograd.grad(x[..., i].sum(), by, retain_graph=True)[0]
        for x in values
        for i in range(values.shape[-1])
    ]
    return values, torch.stack(rows).unflatten(0, (-1, values.shape[-1]))


@pytest.mark.parametrize("every", [1, 2])
@pytest.mark.parametrize(
    "options",
    [
        dict(),
        dict(batch=()),
        dict(batch=(1,), plane="xy"),
        dict(batch=(2, 2)),
        dict(engine="eager"),
        dict(method="generalized_alpha", rho_inf=0.8),
        dict(method="midpoint4"),
    ],
    ids=str,
)
def test_rows_are_the_gradients(options, every):
    """By inputs that are a function of what is given, by a stiffness and by the start; native (in
    one call, and where more than that is made of its steps) and eager.
    """
    stepper, start, inputs, wanted = case(**options)
    for by in wanted:
        values, slopes = tb.rollout_jacobian(stepper, start, STEPS, inputs, read, by, every=every)
        expected, rows = row_by_row(stepper, start, inputs, by, every)
        assert slopes.shape == (STEPS // every, 5, *by.shape) and not slopes.requires_grad
        assert not values.requires_grad and rows.abs().max() > 1e-6
        assert_close(values, expected.detach(), rtol=1e-12, atol=1e-12)
        assert_close(slopes, rows, rtol=1e-9, atol=1e-11)


def test_rows_do_not_depend_on_how_many_are_made_at_once(monkeypatch):
    """Few rows at a time, which sweep the steps alone that they follow from; few steps in a native
    call. By forces, a stiffness and the start.
    """
    for k in range(3):
        stepper, start, inputs, wanted = case()
        whole = tb.rollout_jacobian(stepper, start, STEPS, inputs, read, wanted[k])[1]
        for where, name, value in (
            (rollout_jacobian, "ROOM", 3 * STEPS * 4),
            (rollout_jacobian, "WORTH", 1),
            (make_steps, "AT_ONCE", 4),
        ):
            with monkeypatch.context() as patched:
                patched.setattr(where, name, value)
                parts = tb.rollout_jacobian(stepper, start, STEPS, inputs, read, wanted[k])[1]
            assert_close(parts, whole, rtol=1e-10, atol=1e-12)


def test_no_gradient_mode_and_what_does_not_depend():
    """Within torch.no_grad; of a constant, and by what nothing depends on, zeros."""
    stepper, start, inputs, (by, *_) = case()
    with torch.no_grad():
        values, slopes = tb.rollout_jacobian(stepper, start, STEPS, inputs, read, by)
    assert_close(slopes, row_by_row(stepper, start, inputs, by, 1)[1], rtol=1e-9, atol=1e-11)
    other = torch.ones(2, requires_grad=True)
    for what, of in ((lambda states: torch.ones(*states.t.shape, 2), by), (read, other)):
        values, slopes = tb.rollout_jacobian(stepper, start, STEPS, inputs, what, of)
        assert slopes.shape == (STEPS, values.shape[-1], *of.shape) and not slopes.any()


def test_what_is_read_may_hold_what_it_is_derived_by():
    """As an energy does a stiffness; beside what the states give, and without any of that."""
    stepper, start, inputs, (given, EI, _) = case()
    states = tb.rollout(stepper, start, STEPS, inputs)
    for by, what in (
        (EI, lambda states: states.spin[..., 1, :2] ** 2 * EI[:, None]),
        (given, lambda states: (states.t[..., None] * given[:, 0]).expand(-1, -1, 2)),
    ):
        values, slopes = tb.rollout_jacobian(stepper, start, STEPS, inputs, what, by, every=2)
        expected = what(states)[1::2]
        rows = [
            torch.autograd.grad(x[..., i].sum(), by, retain_graph=True)[0]
            for x in expected
            for i in range(2)
        ]
        assert_close(values, expected.detach(), rtol=1e-12, atol=1e-12)
        assert slopes.any() and not slopes.requires_grad
        assert_close(slopes, torch.stack(rows).unflatten(0, (-1, 2)), rtol=1e-9, atol=1e-11)


def test_nothing_read_and_no_samples():
    for batch, numbers in (((3,), 0), ((0,), 2)):
        stepper, start, inputs, (by, *_) = case(batch=batch)
        few = lambda states, n=numbers: states.spin[..., 1, :n]  # noqa: E731
        values, slopes = tb.rollout_jacobian(stepper, start, STEPS, inputs, few, by, every=2)
        assert values.shape == (STEPS // 2, *batch, numbers)
        assert slopes.shape == (STEPS // 2, numbers, *by.shape) and not slopes.any()


def test_inference_mode_is_refused_in_a_sentence():
    stepper, start, inputs, (by, *_) = case()
    with torch.inference_mode(), pytest.raises(ValueError, match="no_grad"):
        tb.rollout_jacobian(stepper, start, STEPS, inputs, read, by)


def test_refusals():
    stepper, start, inputs, (by, *_) = case()
    for change, sentence in (
        (dict(by=by.detach()), "by was given without gradient; a tensor that requires it"),
        (dict(every=4), "every = 4 was given for 6 steps; a divisor is wanted"),
        (dict(read=lambda states: states.position[0, ..., -1, :]), r"read gave \(3, 3\) of states"),
        (dict(read=lambda states: 1.0), r"read gave float of states \(6, 3\); a tensor with these"),
    ):
        given = dict(steps=STEPS, inputs=inputs, read=read, by=by) | change
        with pytest.raises(ValueError, match=sentence):
            tb.rollout_jacobian(stepper, start, **given)
