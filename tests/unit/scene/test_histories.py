"""Samples in time: a load's History, in every form; a record of accelerations."""

import pytest
import torch

import torchbeam as tb

T = [0.0, 0.1, 0.3]
VALUES = [[0.0, 0, 0], [0, 1.0, 0], [0, 0, 2.0]]


def test_value_and_rate():
    """On the lines, at the samples and outside: arithmetic."""
    load = tb.History(T, VALUES)
    cases = [
        (0.05, [0, 0.5, 0], [0, 10.0, 0]),
        (0.2, [0, 0.5, 1.0], [0, -5.0, 10.0]),
        (-1.0, VALUES[0], [0.0, 0, 0]),
        (9.0, VALUES[2], [0.0, 0, 0]),
    ]
    for t, value, rate in cases:
        got = torch.func.jvp(load, (torch.tensor(t),), (torch.tensor(1.0),))
        torch.testing.assert_close(got[0], torch.tensor(value), rtol=0, atol=1e-15)
        torch.testing.assert_close(got[1], torch.tensor(rate), rtol=1e-13, atol=1e-13)
    assert torch.equal(load(torch.tensor(0.1)), torch.tensor(VALUES[1]))


def test_batch_and_gradient():
    values = torch.tensor(VALUES).expand(5, 3, 3).clone().requires_grad_()
    at = tb.History(T, values)(torch.tensor(0.05))
    (gradient,) = torch.autograd.grad(at.sum(), values)
    assert at.shape == (5, 3) and torch.allclose(gradient[0, :, 0], torch.tensor([0.5, 0.5, 0.0]))


def test_block_rate_follows_it():
    """A ramp given as samples and as a function is one load: the same steps to rounding."""
    section = tb.Section.from_stiffness(100.0, 40.0, 0.8, 1.0, 1.0, 0.05)

    def tip(load):
        scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.TipLoad(force=load)])
        return tb.simulate(
            scene, [0.0, 0.1], form="block_rate", method="rk4", options={"step_size": 0.01}
        ).tip.position[-1]

    sampled = tip(tb.History([0.0, 1.0], [[0, 0, 0], [0, 1.0, 3.0]]))
    torch.testing.assert_close(
        sampled, tip(lambda t: t * torch.tensor([0, 1.0, 3.0])), rtol=0, atol=1e-13
    )


def test_what_it_refuses():
    with pytest.raises(ValueError, match="strictly increasing"):
        tb.History([0.0, 0.0], [[0, 0, 0], [0, 0, 1.0]])
    with pytest.raises(ValueError, match=r"shape \(3, 3\) were given; \(..., 2, 3\) are wanted"):
        tb.History([0.0, 1.0], VALUES)


def test_accelerogram_is_the_double_integral():
    """Its second derivative is the History of the record, at samples and between; a sine comes back
    up to dt^2/12 of it.
    """
    torch.manual_seed(0)
    t, a = torch.tensor([0.1, 0.3, 0.35, 0.9]), torch.randn(2, 4, 3)
    u, lines = tb.Accelerogram(t, a), tb.History(t, a)
    slope = torch.func.jacfwd(u)
    for at in (0.15, 0.3, 0.34, 0.6):
        at = torch.tensor(at)
        torch.testing.assert_close(torch.func.jacfwd(slope)(at), lines(at), rtol=1e-12, atol=1e-12)
    # displacement and velocity are continuous
    for at, before in ((0.3, 0.3 - 1e-12), (0.9, 0.9 - 1e-12), (1.5, 0.9)):
        at, before = torch.tensor(at), torch.tensor(before)
        torch.testing.assert_close(slope(at), slope(before), rtol=0, atol=1e-10)
        torch.testing.assert_close(
            u(at), u(before) + (at - before) * slope(before), rtol=0, atol=1e-10
        )
    assert (u(torch.tensor(0.0)) == 0).all() and (slope(torch.tensor(0.05)) == 0).all()
    t = torch.linspace(0, 6.2, 201)
    sine = tb.Accelerogram(t, torch.stack((torch.sin(t), 0 * t, 0 * t), -1))(t[-1])
    torch.testing.assert_close(
        sine[0], t[-1] - torch.sin(t[-1]), rtol=1.001 * (6.2 / 200) ** 2 / 12, atol=0
    )
    with pytest.raises(ValueError, match="an Accelerogram's values of shape"):
        tb.Accelerogram([0.0, 1.0], [[0, 0, 0]])


# fmt: off
HELD = {
    "Actuation": lambda p: dict(effects=[tb.Actuation(curvature=p * torch.tensor([0, 0, 1.0]))]),
    "Input": lambda p: dict(effects=[tb.TipLoad(force=tb.Input("u", 3))],
                            inputs=dict(u=p * torch.tensor([0, 1.0, 0]))),
    "Frame": lambda p: dict(frame=tb.Frame(angular_velocity=p * torch.tensor([0, 0, 1.0]))),
    "RootMotion": lambda p: dict(root=tb.RootMotion(displacement=lambda t: p * t * torch.tensor([0,
        1.0, 0]))),
    "function of t": lambda p: dict(effects=[tb.TipLoad(force=lambda t: p * torch.tensor([0, 1.0,
                                                                                          0]))]),
    "mass that loads know": lambda p: dict(effects=[tb.PointMass(p),
        tb.TipLoad(force=p * torch.tensor([0, 1.0, 0]))]),
}
# fmt: on


@pytest.mark.parametrize(
    "what", [pytest.param(what, marks=[pytest.mark.long] * (what == "RootMotion")) for what in HELD]
)
def test_the_adjoint_finds_whatever_the_rates_read(what):
    """Effects that are no loads, inputs, motions, and what functions close over: the continuous
    adjoint gives the derivative through the steps. Both differ by the integration's own error (rk4
    at 2 ms of waves that take 100).
    """
    slopes = []
    for adjoint in (False, True):
        p = torch.tensor(0.5, requires_grad=True)
        given = HELD[what](p)
        soft = tb.Section.from_stiffness(EA=10.0, GA=10.0, GJ=0.1, EI=0.1, mass=1.0, inertia=0.01)
        beam = tb.Beam.straight(0.3, 2, soft)
        sol = tb.simulate(
            tb.Scene(beam, **{k: v for k, v in given.items() if k != "inputs"}), [0.0, 0.02],
            method="rk4", initial=tb.rest(tb.Scene(beam)), options={"step_size": 2e-3},
            adjoint=adjoint, inputs=given.get("inputs"),
        )  # fmt: skip
        slopes.append(torch.autograd.grad(sol.tip.position[-1, :2].sum(), p)[0])
    assert slopes[0] != 0
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-5, atol=0)
