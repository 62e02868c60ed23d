"""Stress that relaxes, by arms of `Viscoelastic`, against closed forms of a standard linear solid.

Whole shares scale the stiffness of all strains alike, so that each mode of an elastic beam of the
angular frequency w becomes a scalar standard solid: s^2 + w^2 (1 - sum g/(1 + s tau)) = 0.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SHARES, TIMES = (0.3, 0.2), (0.05, 0.4)
SECTION = tb.Section.from_stiffness(
    EA=200.0, GA=80.0, GJ=0.8, EI=(1.0, 1.3), mass=0.3, inertia=1e-3
)


def beam(N=2, section=SECTION):
    return tb.Beam.straight(1.0, N, section)


def relaxing(*effects, shares=SHARES, times=TIMES, N=2, section=SECTION, **options):
    return tb.Scene(beam(N, section), [tb.Viscoelastic(shares, times), *effects], **options)


def test_relaxation_at_a_constant_strain():
    """A bar stretched by e = 1 % within no time: N = EA e (1 - sum g (1 - exp(-t/tau))). The mean
    over each step is exact, in steps of 4 times the shorter time as of a 50th, to rounding.
    """
    ends = [tb.Support(0), tb.Support(-1, displacement=(0.01, 0.0, 0.0))]
    pulled = tb.equilibrium(tb.Scene(beam(), supports=ends))
    for h in (0.2, 1e-3):
        t = torch.arange(6) * h
        states = tb.simulate(relaxing(supports=ends), t, initial=pulled, step=h).state
        g, tau = (torch.tensor(x)[:, None] for x in (SHARES, TIMES))
        crept = t + (tau * torch.exp(-t / tau))  # the integral of 1 - exp(-t/tau)
        N = 2.0 * (1 - (g * crept.diff() / h).sum(0))
        assert (states.stress[1:, :, 0] - N[:, None]).abs().max() < 1e-10
        assert (states.reaction[1:, 1, 0] - N).abs().max() < 1e-10
    # at last the long-time equilibrium, which remembers that it has crept
    rest = tb.equilibrium(relaxing(supports=ends))
    assert (rest.stress[..., 0] - 1.0).abs().max() < 1e-10
    assert (rest.inelastic[..., [0, 6]] - 0.01).abs().max() < 1e-12


def test_creep_under_a_constant_force():
    """A light bar pulled by P: e = P/EA (1 + g/(1 - g) (1 - exp(-(1 - g) t/tau))), from the
    instantaneous equilibrium. The step is of second order: 10 to a time leave 4e-4 of the strain,
    20 a quarter of it. (Its inertia, which lets it ring by the rate
    of creep over w = 6e7 rad/s, leaves 1e-7.)
    """
    light = tb.Section.from_stiffness(EA=200.0, GA=80.0, GJ=0.8, EI=1.0, mass=1e-13, inertia=1e-13)
    pull, g, tau = tb.TipLoad(force=(2.0, 0.0, 0.0)), 0.4, 0.1
    start = tb.equilibrium(tb.Scene(beam(1, light), [pull]))
    errors = []
    for steps in (10, 20):
        t = torch.linspace(0, tau, steps + 1)
        scene = relaxing(pull, shares=(g,), times=(tau,), N=1, section=light, plane="xz")
        tip = tb.simulate(scene, t, initial=start, step=tau / steps).tip.position[..., 0] - 1
        e = 0.01 * (1 + g / (1 - g) * -torch.expm1(-(1 - g) * t / tau))
        errors.append((tip - e).abs().max() / 0.01)
    assert errors[0] < 1e-3 and 3.5 < errors[0] / errors[1] < 4.5


def roots(w, shares=SHARES, times=TIMES):
    """All s of a mode w: eigenvalues of a'' = -w^2 (a - sum g q), q' = (a - q)/tau."""
    return torch.linalg.eigvals(solid(w, shares, times))


def solid(w, shares=SHARES, times=TIMES):
    """The matrix of (a, a', q)."""
    g, tau = (torch.as_tensor(x) for x in (shares, times))
    A = torch.zeros(2 + len(g), 2 + len(g))
    A[0, 1], A[1, 0], A[1, 2:] = 1, -(w**2), w**2 * g
    A[2:, 0], A[2:, 2:] = 1 / tau, -torch.diag(1 / tau)
    return A


def test_modes_are_roots_of_the_dynamic_stiffness():
    """Damped frequencies of a cantilever's four slowest modes, to 1e-9; what only decays is slower
    and comes behind.
    """
    elastic = tb.modes(tb.Scene(beam(4)), count=4).frequency
    found = tb.modes(relaxing(N=4), count=4)
    wanted = torch.stack([max(roots(w), key=lambda s: s.imag) for w in elastic])
    assert ((found.eigenvalue - wanted).abs() < 1e-9 * wanted.abs()).all()
    assert (found.damping_ratio > 0.02).all()


def test_a_vibration_decays_as_the_dynamic_stiffness_says():
    """A cantilever, small rotations, that starts with the velocity of its first mode: the tip is
    that of the scalar solid, by its matrix exponential, over three periods. Second order: 30 steps
    a period leave 1 %, 60 a quarter.
    """
    mode = tb.modes(tb.Scene(beam(), small=True), count=1)
    w, shape = mode.frequency[0], mode.shape[0].real
    scene = relaxing(small=True)
    period = 2 * math.pi / w.item()
    still = tb.rest(scene)
    spin = (still.axes.mT @ shape[..., 3:, None])[..., 0]
    start = replace(still, velocity=shape[..., :3], spin=spin)
    errors = []
    for steps in (30, 60):
        t = torch.arange(3 * steps + 1) * (period / steps)
        tip = tb.simulate(scene, t, initial=start, step=period / steps).tip.position[..., 2]
        a = torch.linalg.matrix_exp(solid(w) * t[:, None, None])[:, 0, 1] * shape[-1, 2]
        errors.append((tip - a).abs().max() / a.abs().max())
    assert a[-40:].abs().max() < 0.5 * a.abs().max()
    assert errors[0] < 1e-2 and 3.7 < errors[0] / errors[1] < 4.3


def test_energy_only_falls():
    """Kinetic and stored energy less the work of loads, of 24 beams with random shares, times from
    1e-4 to 1e3 s and steps of 20 ms, free after a push: it never rises by more than rounding. With
    small rotations as it is; with large ones where conserve=True closes the balance, which it does
    to within 1e-13 of what is there.
    """
    g = torch.Generator().manual_seed(3)
    shares, times = (
        0.45 * torch.rand(24, 2, generator=g),
        10 ** (7 * torch.rand(24, 2, generator=g) - 4),
    )
    push = tb.TipLoad(force=lambda t: torch.stack((0 * t, 0 * t, torch.where(t < 0.3, 0.5, 0.0))))
    t = torch.linspace(0, 2, 101)
    for options, conserve in ((dict(small=True), False), ({}, True)):
        scene = relaxing(push, shares=shares, times=times, **options)
        solution = tb.simulate(scene, t, step=0.02, conserve=conserve)
        energy = solution.energy
        total = energy.kinetic + energy.strain - energy.work
        size = (energy.kinetic + energy.strain).amax(0)
        rest = solution.state.defect if conserve else 0.0
        assert ((total - rest).diff(dim=0) < 1e-12 * size).all()
        assert (total[-1] < 0).all() and (total[-1] < -0.02 * size).any()


def test_order_beside_an_explicit_method():
    """A cantilever with large rotations, pushed smoothly: place and creep at the end against dopri5
    at 1e-10, which integrates q' = (e - q)/tau by itself. Halving the step divides errors by 4, of
    midpoint4 by 16.
    """
    push = tb.TipLoad(force=lambda t: torch.stack((0 * t, 0 * t, 3 * torch.sin(4 * t) ** 4)))
    heavy = tb.Section.from_stiffness(EA=20.0, GA=8.0, GJ=0.8, EI=1.0, mass=3.0, inertia=0.3)
    scene = relaxing(push, N=1, section=heavy, plane="xz")
    t = torch.tensor([0.0, 0.6])
    exact = tb.simulate(scene, t, method="dopri5", rtol=1e-10, atol=1e-12).state[-1]

    def error(method, steps):
        end = tb.simulate(scene, t, method=method, step=0.6 / steps, lumped=True).state[-1]
        pairs = ((end.position, exact.position), (end.inelastic, exact.inelastic))
        return max((a - b).abs().max().item() for a, b in pairs)

    for method, order in (("midpoint", 2), ("generalized_alpha", 2), ("midpoint4", 4)):
        coarse, fine = error(method, 60), error(method, 120)
        assert 0.8 * 2**order < coarse / fine < 1.25 * 2**order, method
    assert fine < 1e-7


def test_a_column_buckles_under_its_long_time_stiffness():
    """Half of what the instantaneous stiffness carries, to 1e-6."""
    column = tb.TipLoad(force=tb.Input("push", 3))

    def load(scene):
        return tb.critical_load(scene, 5.0, inputs={"push": (-1.0, 0.0, 0.0)}).factor

    rigid = tb.Section.from_stiffness(EA=1e6, GA=1e6, GJ=1.0, EI=1.0, mass=0.3)
    plain = load(tb.Scene(beam(2, rigid), [column], plane="xz"))
    assert (load(relaxing(column, section=rigid, plane="xz")) / plain - 0.5).abs() < 1e-6


def driven(*effects, **options):
    """A linear model from a tip force to the tip's place."""
    tip, inputs = tb.TipLoad(force=tb.Input("u", 3)), {"u": torch.zeros(3)}
    scene = relaxing(tip, *effects, **options)
    return tb.linearize(scene, outputs=tb.sensors.TipPosition(), inputs=inputs)


def test_a_reduced_model_relaxes_as_the_whole_one():
    """Its poles are those of scalar standard solids, s^2 + w^2 (1 - sum g/(1 + s tau)) = 0; a model
    of all modes has the whole transfer function, to rounding.
    """
    whole = driven(plane="xz")
    small = whole.reduced(2)
    assert (small.A.shape[-1], small.arms) == (8, 4)
    poles = torch.linalg.eigvals(small.A).numpy()
    (g, h), (a, b) = SHARES, (np.poly1d([tau, 1]) for tau in TIMES)
    for w in tb.modes(tb.Scene(beam(), plane="xz"), count=2).frequency.numpy():
        exact = (np.poly1d([1, 0, w**2]) * a * b - w**2 * (g * b + h * a)).roots
        assert (np.abs(poles[:, None] - exact).min(0) < 1e-8 * np.abs(exact)).all()
    omega = torch.logspace(-2, 2, 20, dtype=torch.float64)
    full, all_modes = whole.response(omega), whole.reduced(whole.mass.shape[-1]).response(omega)
    assert (all_modes - full).abs().max() < 1e-9 * full.abs().max()


@pytest.mark.parametrize("kind", ["whole", "six", "loaded", "no inertia"])
def test_a_reduced_model_against_the_whole_one(kind):
    """Response up to half of the first frequency, by six modes: less than 0.1 % is left of
    the modes left out, as of elastic ones.
    """
    six = torch.tensor(((0.1, 0.0),) * 4 + ((0.3, 0.2),) * 2)
    times = torch.tensor(((0.02, 0.1),) * 4 + (TIMES,) * 2)
    light = tb.Section.from_stiffness(EA=200.0, GA=80.0, GJ=0.8, EI=1.0, mass=0.3)
    whole = {
        "whole": lambda: driven(),
        "six": lambda: driven(shares=six, times=times),
        "loaded": lambda: driven(tb.Gravity((0, 0, -2.0)), tb.Damping(1e-3)),
        "no inertia": lambda: driven(section=light, N=4),
    }[kind]()
    omega = torch.logspace(-2, 0.5, 12, dtype=torch.float64)
    full, small = whole.response(omega), whole.reduced(6, static=True)
    error = (small.response(omega) - full).abs().amax((-1, -2)) / full.abs().amax((-1, -2))
    assert small.A.shape[-1] < whole.A.shape[-1] and error.max() < 1e-3
    state = whole.state
    assert_close(small.departure(state), torch.zeros_like(small.departure(state)))


def test_a_batch_of_reduced_models_and_its_gradient():
    """Samples with shares of their own, each as alone; the derivative of the response by a share
    against differences.
    """
    shares = torch.tensor([SHARES, (0.1, 0.4)], dtype=torch.float64)

    def small(shares):
        return driven(shares=shares, plane="xz").reduced(1, static=True).response(4.0).abs().sum()

    both = driven(shares=shares, plane="xz").reduced(1)
    alone = driven(shares=shares[1], plane="xz").reduced(1)
    assert_close(both.response(4.0)[1], alone.response(4.0), rtol=1e-9, atol=1e-12)
    own, shift = shares[0].clone().requires_grad_(), torch.tensor([1e-5, 0.0])
    (slope,) = torch.autograd.grad(small(own), own)
    change = (small(shares[0] + shift) - small(shares[0] - shift)) / 2e-5
    assert_close(slope[0], change, rtol=1e-6, atol=0)


def test_what_relaxes_and_follows_is_not_reduced():
    follower = tb.TipLoad(force=(0.3, 0.0, 0.1), follower=True)
    with pytest.raises(ValueError, match="symmetric stiffness and damping are wanted"):
        driven(follower, plane="xz").reduced(1)


def test_each_part_of_a_structure_has_its_own():
    """Two beams in a row, of which one relaxes in bending alone by two arms and one wholly by one:
    the long-time tip is that of stiffnesses scaled by hand; a state of a part has its own memory.
    """
    bend = ((0.0, 0.0),) * 4 + ((0.3, 0.2),) * 2
    arms = [tb.Viscoelastic(bend, (0.1, 1.0), on="a"), tb.Viscoelastic((0.25,), (0.3,), on="b")]
    push = tb.PointLoad(("b", -1), force=(0.0, 0.1, 0.2))

    def chain(of_a, of_b, effects):
        parts = {"a": tb.Beam.straight(1.0, 24, of_a), "b": tb.Beam.straight(0.5, 2, of_b)}
        return tb.Scene(parts, [push, *effects], joints=[tb.Weld(("a", -1), ("b", 0))],
                        supports=[tb.Support(("a", 0))])  # fmt: skip

    S = torch.as_tensor(SECTION.compliance)
    own = torch.tensor([1.0, 1, 1, 1, 2, 2])
    soft = tb.Section(torch.diag(own) @ S, SECTION.mass), tb.Section(S / 0.75, SECTION.mass)
    found = tb.equilibrium(chain(SECTION, SECTION, arms))
    wanted = tb.equilibrium(chain(*soft, []))
    moved = (found.position - wanted.position).abs().max() / wanted.position[..., 1:].abs().max()
    assert moved < 3e-4  # linked interpolation's share of bending in shear, which falls as h^2
    assert found["b"].inelastic.shape == (2, 12) and found["a"].inelastic.shape == (24, 12)
