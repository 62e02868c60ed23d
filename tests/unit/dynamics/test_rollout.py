"""rollout and PerInterval: many steps in one call, with inputs of their own."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=0.5, inertia=0.01)
DT, STEPS = 0.02, 6


def scene(**options):
    wind = tb.LineLoad(force=lambda t: torch.stack((0 * t, 0 * t, torch.cos(9 * t))))
    effects = [tb.TipLoad(force=tb.Input("force", 3)), wind, tb.Damping(1e-3)]
    return tb.Scene(tb.Beam.straight(1.0, 3, SECTION), effects, **options)


def forces(*batch):
    return torch.randn(*batch, STEPS, 3, generator=torch.Generator().manual_seed(1))


def same(a, b, **tolerance):
    for name, x in vars(a).items():
        assert (x is None) == (getattr(b, name) is None)
        if x is not None:
            assert_close(x, getattr(b, name), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_rollout_is_so_many_steps(engine):
    """With a function of t, and inputs that are held, functions of t, or of each step; samples at
    one instant, or each at its own. To rounding: times are k dt here, and sums of dt there.
    """
    stepper, u = tb.Stepper(scene(), DT, engine=engine), forces(2)
    held = {
        "values": (tb.PerInterval(u), lambda k, t: u[:, k]),
        "held": (u[:, 0], lambda k, t: u[:, 0]),
        "function": (
            lambda t: torch.stack((0 * t, t, 0 * t)),
            lambda k, t: (t + DT / 2)[..., None] * torch.eye(3)[1],
        ),
    }
    for t in (torch.zeros(2), torch.tensor([0.0, 0.3])):
        start = stepper.rest((2,)).at(t)
        for given, at in held.values():
            made, state, states = tb.rollout(stepper, start, STEPS, force=given), start, []
            for k in range(STEPS):
                state = stepper(state, force=at(k, state.t))
                states.append(state)
            same(made, tb.State.stack(states), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha"])
def test_inputs_of_intervals_are_those_of_steps(method):
    """simulate with two steps in each interval of its own force = a rollout with each force given
    twice, and its gradient.
    """
    u = forces().requires_grad_()
    found = tb.simulate(
        scene(), DT * torch.arange(STEPS + 1), method=method, step=DT / 2,
        inputs={"force": tb.PerInterval(u)},
    )  # fmt: skip
    stepper = tb.Stepper(scene(), DT / 2, method)
    twice = tb.rollout(
        stepper, stepper.rest(), 2 * STEPS, force=tb.PerInterval(u.repeat_interleave(2, 0))
    )
    assert_close(found.tip.position[1:], twice.tip.position[1::2], rtol=1e-10, atol=1e-12)
    by_simulate, by_rollout = (
        torch.autograd.grad(x.tip.position[-1].sum(), u)[0] for x in (found, twice)
    )
    assert (by_simulate.abs().amax(-1) > 1e-6).all()
    assert_close(by_simulate, by_rollout, rtol=1e-8, atol=1e-10)


def test_energy_of_a_beam_that_an_input_bends():
    """The strain that stores no energy is that of the interval which ends at the instant: a beam
    that stands as it is bent by itself, to 0.3 1/m, stores nothing until it is let go
    (and 0.045 J from then on).
    """
    bent = torch.tensor([0.0, 0.3, 0.0])
    actuated = tb.Scene(
        tb.Beam.straight(1.0, 3, SECTION), [tb.Actuation(curvature=tb.Input("bend", 3))]
    )
    given = {"bend": tb.PerInterval(torch.stack((bent, 0 * bent)))}
    energy = tb.simulate(
        actuated,
        [0.0, 0.02, 0.021],
        tb.equilibrium(actuated, inputs={"bend": bent}),
        step=0.01,
        inputs=given,
    ).energy
    assert energy.strain[1] < 1e-12 and energy.strain[2] > 0.04


def test_refusals():
    stepper, t = tb.Stepper(scene(), DT), DT * torch.arange(4)
    for call, sentence in (
        (
            lambda: tb.PerInterval(torch.ones(3)),
            r"PerInterval of shape \(3,\) was given; \(..., intervals, size\)",
        ),
        (
            lambda: tb.rollout(stepper, stepper.rest(), 5, force=tb.PerInterval(forces())),
            "for 6 intervals; there are 5",
        ),
        (lambda: tb.rollout(stepper, stepper.rest(), 0, force=[0, 0, 1]), "steps = 0"),
        (lambda: tb.rollout(scene(), None, 1), "a stepper of type Scene"),
        (
            lambda: tb.simulate(scene(), t, inputs={"force": tb.PerInterval(forces())}),
            "for 6 intervals; there are 3",
        ),
        (
            lambda: tb.simulate(
                scene(), t, method="rk4", inputs={"force": tb.PerInterval(forces())}
            ),
            "to 'rk4'; 'midpoint'",
        ),
        (lambda: stepper(stepper.rest(), force=tb.PerInterval(forces())), "numbers or a tensor"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_rows_of_a_jacobian_are_taken_at_once(engine):
    """Of steps that were made once, by torch.func.vmap: by forces of each step, of each sample and
    of all, a stiffness of each sample, one for all and the start; of many steps and of one; twice
    with other numbers, and with a cotangent that all rows have in common. As row by row. (Native
    code refused them with an error about torch's insides.)
    """
    generator = torch.Generator().manual_seed(3)

    def check(batch, steps):
        damping = torch.tensor(1e-3).requires_grad_()
        EI = (1 + torch.rand(batch, generator=generator)).requires_grad_()
        section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=EI, mass=0.5, inertia=0.01)
        effects = [tb.TipLoad(force=tb.Input("force", 3)), tb.Damping(damping)]
        held = tb.Scene(tb.Beam.straight(1.0, 2, section), effects)
        stepper = tb.Stepper(held, DT, engine=engine)
        u = torch.randn(*batch, steps, 3, generator=generator).requires_grad_()
        everywhere = torch.randn(steps, 3, generator=generator).requires_grad_()
        velocity = (0.1 * torch.rand(*batch, 3, 3, generator=generator)).requires_grad_()
        moving = velocity * torch.tensor([0.0, 1.0, 1.0])[:, None]
        start = replace(stepper.rest(batch), velocity=moving)
        if steps == 1:
            tip = stepper(start, force=u[..., 0, :] + everywhere[0]).tip.position
        else:
            way = tb.rollout(stepper, start, steps, force=tb.PerInterval(u + everywhere))
            tip = way.tip.position
        wanted = u, everywhere, damping, EI, velocity

        def row(seed, common=None):
            ends = tip if common is None else (tip, (tip**2).sum())
            seeds = seed if common is None else (seed, common)
            return torch.autograd.grad(ends, wanted, seeds, retain_graph=True)

        rows = torch.randn(5, *tip.shape, generator=generator)
        for given in ((), (torch.tensor(0.3),)):
            alone = [row(seed, *given) for seed in rows]
            together = torch.func.vmap(row, in_dims=(0, *(None,) * len(given)))(rows, *given)
            for x, each in zip(together, zip(*alone, strict=True), strict=True):
                assert x.abs().max() > 1e-9
                assert_close(x, torch.stack(each), rtol=1e-9, atol=1e-12)

    for batch, steps in (((3,), STEPS), ((3,), STEPS), ((), 4), ((2,), 1)):
        check(batch, steps)
