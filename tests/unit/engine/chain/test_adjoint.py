"""Gradients of compiled steps where samples fail, in forward mode and through checkpoints; by all
that a scene holds: properties/test_parity.py.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.engine.chain.adjoint import AdjointProgram

pytest.importorskip("llvmlite")


def wanted(*shape):
    return torch.rand(shape, generator=torch.Generator().manual_seed(2)).add_(0.5).requires_grad_()


def bent(batch, **where):
    """A bow in the plane xz, each sample with its own."""
    by = {"EI": wanted(*batch), "u": wanted(3), "bow": wanted(*batch)}
    section = tb.Section.from_stiffness(
        EA=2e3, GA=8e2, GJ=2.0, EI=3 * by["EI"], mass=0.5, inertia=1e-3
    )
    x, bow = torch.linspace(0, 1, 4), by["bow"][..., None]
    nodes = torch.stack((x + 0 * bow, 0 * x * bow, 0.2 * bow * x**2), -1)
    return tb.Scene(
        tb.Beam.from_nodes(nodes, section), [tb.TipLoad(force=tb.Input("u", 3))], **where
    ), by


def loss(state):
    """A number that depends on every field."""
    generator = torch.Generator().manual_seed(3)
    return sum(
        (torch.randn(x.shape, generator=generator) * x).sum()
        for x in (
            state.position,
            state.rotation,
            state.velocity,
            state.spin,
            state.stress,
            state.reaction,
            state.work,
        )
    )


def test_a_failed_sample_is_differentiated_as_standing_still_and_harms_nobody():
    def slopes(engine, u):
        scene, _ = bent((), plane="xz")
        u = u.clone().requires_grad_()
        start = tb.rest(scene, (3,))
        velocity = start.velocity.clone().requires_grad_()
        after = tb.Stepper(scene, 0.01, engine=engine, halvings=0)(
            replace(start, velocity=velocity), u=u
        )
        return after.status, *torch.autograd.grad(
            after.position.sum() + after.velocity.square().sum(), (u, velocity)
        )

    u = torch.tensor([[0.1, 0, 0.2], [torch.nan, 0, 0], [0.3, 0, 0.1]])
    (status, *compiled), (expected, *eager) = (
        slopes(engine, u) for engine in ("compiled", "eager")
    )
    assert status.tolist() == expected.tolist() and status[1] != 0
    for a, b in zip(compiled, eager, strict=True):
        assert_close(a, b, rtol=1e-10, atol=1e-12)
    assert torch.isfinite(compiled[0]).all() and (compiled[0][1] == 0).all()


def test_what_native_code_cannot_differentiate_is_made_eagerly():
    """Forward mode, and the gradients where strains are impossible."""

    def slope(engine, **section):
        beam = tb.Beam.straight(
            1.0,
            2,
            tb.Section.from_stiffness(
                **{**dict(EA=2e3, GA=8e2, GJ=2.0, EI=3.0, mass=0.5, inertia=1e-3), **section}
            ),
        )
        stepper = tb.Stepper(
            tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))], plane="xz"), 0.01, engine=engine
        )
        u = torch.tensor([0.1, 0.0, 0.3])

        def tip(u):
            return stepper(stepper.rest(), u=u).tip.position

        forwards = torch.func.jvp(tip, (u,), (torch.ones(3),))
        return *forwards, torch.func.jacrev(tip)(u), torch.autograd.functional.jacobian(tip, u)

    for section in ({}, dict(EA=torch.inf)):
        for a, b in zip(slope("compiled", **section), slope("eager", **section), strict=True):
            assert_close(a, b, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("engine", ["compiled", "auto"])
def test_a_checkpoint_makes_the_same_gradients(engine):
    """What native steps keep from the first run is no part of a graph, which the second run would
    miss; nor are they made only then, with what that saves.
    """
    found = []
    for checkpoint in (False, True):
        scene, by = bent((), plane="xz")
        solution = tb.simulate(
            scene,
            torch.linspace(0, 0.2, 5),
            step=0.05,
            inputs={"u": by.pop("u")},
            checkpoint=checkpoint,
            engine=engine,
        )
        found.append(torch.autograd.grad(loss(solution.state[-1]), tuple(by.values())))
    assert_close(found[1], found[0], rtol=1e-12, atol=0)


def test_an_adjoint_that_is_first_wanted_in_a_checkpoint_is_compiled(monkeypatch, tmp_path):
    """Of a load whose tangent is by automatic differentiation, with no program kept; the engine
    does not change on the way.
    """
    monkeypatch.setattr("torchbeam.engine.chain.kept_programs.PROGRAMS", {})
    monkeypatch.setenv("TORCHBEAM_CACHE", str(tmp_path))
    found = []
    for checkpoint in (True, False):
        length = torch.tensor(0.1, requires_grad=True)
        section = tb.Section.from_stiffness(EA=2e3, GA=8e2, GJ=2.0, EI=3.0, mass=0.5, inertia=1e-3)
        scene = tb.Scene(
            tb.Beam.straight(1.0, 1, section),
            [tb.Spring(1, 30.0, (1, 0.3, 0), length, 0.2)],
            plane="xy",
        )
        solution = tb.simulate(
            scene, [0.0, 0.02, 0.04], step=0.02, checkpoint=checkpoint, engine="compiled"
        )
        found.append(torch.autograd.grad(solution.tip.position[-1, 1], length)[0])
    assert_close(found[0], found[1], rtol=1e-12, atol=0)


def test_an_adjoint_of_an_elastic_tendon_that_is_first_wanted_in_a_checkpoint():
    """Whose constants are made of the scene's by operations: tracing them saves nothing for the
    graph of the part, which is not traced again.
    """
    section = tb.Section.from_stiffness(EA=100.0, GA=50.0, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
    eyelets = [(None, (0.0, 0, 0.1)), (1, (0, 0, 0.05))]
    found = []
    for checkpoint in (True, False):
        stiffness = torch.tensor(10.0, requires_grad=True)
        tendon = tb.Tendon(eyelets, stiffness=stiffness, length=0.9)
        scene = tb.Scene(tb.Beam.straight(1.0, 1, section), [tendon])
        solution = tb.simulate(
            scene, [0.0, 0.02, 0.04], step=0.02, checkpoint=checkpoint, engine="compiled"
        )
        found.append(torch.autograd.grad(solution.tip.position[-1, 2], stiffness)[0])
    assert found[0].abs() > 1e-6
    assert_close(found[0], found[1], rtol=1e-12, atol=0)


def test_the_text_is_the_same_in_whatever_order_cotangents_are_asked_for():
    """Sets are ordered differently in each process, and objects are kept by their text."""
    step = tb.Stepper(bent((), plane="xz")[0], 0.01, engine="compiled").compiled
    names, dt = sorted(one.name for one in step.constant), torch.tensor(0.01)
    nothing = {name: torch.zeros(size) for name, size in step.model.scene.inputs.items()}
    local = step.local(step.constants.at(dt, dt / 2, nothing))
    texts = [
        AdjointProgram(local, step.program.kinds, True, order).text(1)
        for order in (names, names[::-1])
    ]
    assert texts[0] == texts[1]
