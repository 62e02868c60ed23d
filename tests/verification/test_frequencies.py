"""Modes about an equilibrium: cantilever frequencies, flutter, damping, and what they say about
motion.

Buckling and flutter loads: unit/linear/test_critical.py.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import quaternions as quat

INF = math.inf


def planar(N, *effects, GA=INF, EI=1.0, inertia=0.0, mass=1.0):
    """A cantilever that bends in the x-z plane alone: everything else is rigid."""
    section = tb.Section.from_stiffness(
        EA=INF, GA=(INF, GA), GJ=INF, EI=(EI, INF), mass=mass, inertia=(inertia, 0.0)
    )
    return tb.Scene(tb.Beam.straight(1.0, N, section), effects)


def test_frequencies_do_not_know_directions():
    """A circular section turned at random: bending frequencies come in pairs, the same whatever the
    direction.
    """
    torch.manual_seed(0)
    section = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
    R = quat.matrix(quat.normalize(torch.randn(4)))
    of = [
        tb.Scene(tb.Beam.straight(1.0, 6, section, direction=Q[:, 0], up=Q[:, 2]))
        for Q in (torch.eye(3), R)
    ]
    one, other = (tb.modes(scene, count=6).frequency for scene in of)
    assert_close(one, other, rtol=1e-9, atol=0)
    assert_close(one[0], one[1], rtol=1e-9, atol=0)


def test_torsion():
    """omega = (pi/2 L) sqrt(GJ/i): the lumped one-point chain has omega_h = (2 c/h) sin(k h/2), so
    (k h)^2/24 below: 4.0e-4 at N = 16, which is met to its next term.
    """
    section = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=0.8, EI=INF, mass=0.2, inertia=1e-3)
    modes = tb.modes(tb.Scene(tb.Beam.straight(1.0, 16, section)), count=1)
    c, k, h = math.sqrt(0.8 / 2e-3), math.pi / 2, 1 / 16
    assert_close(modes.frequency.item(), 2 * c / h * math.sin(k * h / 2), rtol=1e-6, atol=0)


@pytest.mark.parametrize("six", [False, True])
def test_damping_ratio(six):
    """Stiffness-proportional damping: zeta = tau omega/2 with the undamped omega,
    |eigenvalue| = omega, exactly.
    """
    tau = (0.01,) * 6 if six else 0.01
    damped = tb.modes(tb.Scene(tb.Beam.straight(1.0, 8, finite()), [tb.Damping(tau)]), count=3)
    free = tb.modes(tb.Scene(tb.Beam.straight(1.0, 8, finite())), count=3)
    assert_close(damped.eigenvalue.abs(), free.frequency, rtol=1e-8, atol=0)
    assert_close(damped.damping_ratio, 0.01 * free.frequency / 2, rtol=1e-8, atol=0)


def finite():
    return tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=(1.0, 2.0), mass=0.2, inertia=1e-3)


def test_overdamped_modes_do_not_oscillate():
    """tau omega/2 > 1: two real eigenvalues, damping ratio 1, frequency 0."""
    modes = tb.modes(tb.Scene(tb.Beam.straight(1.0, 4, finite()), [tb.Damping(1.0)]), count=4)
    assert (modes.frequency == 0).all() and (modes.eigenvalue.real < 0).all()
    assert_close(modes.damping_ratio, torch.ones(4))


def test_overdamped_motions_come_behind_those_that_oscillate():
    """s^2 + tau w^2 s + w^2 = 0 of each mode w: with tau = 2e-3 s a steel shaft's bending
    oscillates up to 1000 rad/s, all that is faster decays, at 1/tau at the slowest. That does not
    take the places of slow bending; a mode without either has both of its real roots.
    """
    tau, shaft = 2e-3, tb.Section.circle(0.01, E=210e9, nu=0.3, rho=7850.0)
    beam = tb.Beam.straight(0.8, 4, shaft, order=2)
    w = tb.modes(tb.Scene(beam), count=48).frequency
    fast = -tau / 2 * w**2 - torch.complex((tau * w / 2) ** 2 - 1, 0 * w).sqrt() * w
    roots = (w**2 / fast).conj()  # the other one of each
    roots = torch.where(roots.imag < 0, roots.conj(), roots)
    swings = roots.imag > 0
    relaxed = torch.cat((roots[~swings], fast[~swings])).real
    damped = tb.modes(tb.Scene(beam, [tb.Damping(tau)]), count=12)
    n = int(swings.sum())
    assert n == 4
    assert_close(damped.eigenvalue[:n], roots[swings], rtol=1e-7, atol=0)
    assert_close(damped.natural[:n], w[swings], rtol=1e-7, atol=0)
    zeta = damped.damping_ratio[:n]
    assert_close(damped.frequency[:n], (1 - zeta**2).sqrt() * w[swings], rtol=1e-7, atol=0)
    assert (damped.frequency[n:] == 0).all()
    slow = relaxed.sort(descending=True).values[: 12 - n]
    assert_close(damped.eigenvalue[n:].real, slow, rtol=1e-7, atol=0)
    few = tb.modes(tb.Scene(beam, [tb.Damping(tau)]), count=3)
    assert_close(few.eigenvalue, damped.eigenvalue[:3], rtol=1e-9, atol=0)
    poles = tb.linearize(
        tb.Scene(beam, [tb.Damping(tau)]), outputs=tb.sensors.TipPosition()
    ).poles  # all of them
    assert (poles.real - damped.eigenvalue[-1].real).abs().min() < 1.0


def test_rigid_motions_come_first_and_what_damps_them_last():
    """A free bar in drag: rigid motions of eigenvalue 0, bending, and drag's own rates -c/m."""
    beam = tb.Beam.straight(1.0, 4, finite())
    modes = tb.modes(tb.Scene(beam, [tb.MassDamping(0.5)], supports=[]), count=12)
    assert (modes.eigenvalue[:6] == 0).all() and (modes.frequency[6:] > 1).all()


def test_shape_moves_as_it_says():
    """Released from the bent equilibrium plus a small second mode shape, the beam oscillates about
    it at that frequency: the tip is back after one period. (Midpoint at period/200: phase error
    8e-5 of a turn; amplitude 1e-4 m: squares 1e-4.)
    """
    scene = tb.Scene(
        tb.Beam.straight(1.0, 6, finite()),
        [tb.TipLoad(force=(0, 0.5, 1.0)), tb.Gravity((0, 0, -2.0))],
    )
    bent = tb.equilibrium(scene, tolerance=1e-12)
    modes = tb.modes(scene, bent, count=2)
    move, omega = 1e-4 * modes.shape[1].real, modes.frequency[1].item()
    start = replace(
        bent,
        position=bent.position + move[:, :3],
        rotation=quat.multiply(quat.exponential(move[:, 3:]), bent.rotation),
    )
    period = 2 * math.pi / omega
    sol = tb.simulate(
        scene, [0.0, period / 2, period], initial=start, step=period / 200, tolerance=1e-11
    )
    away = sol.nodes - bent.nodes
    assert_close(away[1], -away[0], rtol=0, atol=2e-7)
    assert_close(away[2], away[0], rtol=0, atol=2e-7)


def test_batches_and_gradients():
    """Frequencies of a batch of EI, each as alone; d(omega)/d(EI) = omega/(2 EI) where bending
    alone gives, by backward.
    """
    EI = torch.tensor([0.5, 1.0, 2.0], requires_grad=True)
    frequency = tb.modes(planar(6, EI=EI), count=2).frequency
    assert_close(frequency[2], tb.modes(planar(6, EI=2.0), count=2).frequency, rtol=1e-9, atol=0)
    (by_EI,) = torch.autograd.grad(frequency[:, 0].sum(), EI)
    # rigid strains count 1e-7
    assert_close(by_EI, (frequency[:, 0] / (2 * EI)).detach(), rtol=1e-5, atol=0)


def test_too_many_modes_are_refused():
    with pytest.raises(ValueError, match="count = 13 was given; 2 elements have at most 12 modes"):
        tb.modes(planar(2), count=13)


@pytest.mark.parametrize("batch", [2, 3])
def test_a_batch_of_loads_is_each_alone(batch):
    """Elements of unlike mass under an input of 2 or 3 loads (3 is also the number of inner
    elements): each load's frequencies are those that it has alone, to rounding (1e-9: the
    equilibria are found to 1e-8 of their scaled residual, in batch and alone alike).
    """
    sections = [
        tb.Section.from_stiffness(EA=4e4, GA=1e4, GJ=0.8, EI=1.0, mass=m, inertia=5e-6)
        for m in (0.1, 0.2, 0.4, 0.8)
    ]
    scene = tb.Scene(tb.Beam.straight(1.0, 4, sections), [tb.TipLoad(force=tb.Input("u", 3))])
    loads = torch.tensor([[0.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.3, 0.0, 2.0]])[:batch]
    together = tb.modes(scene, count=3, inputs={"u": loads}).frequency
    alone = torch.stack([tb.modes(scene, count=3, inputs={"u": load}).frequency for load in loads])
    torch.testing.assert_close(together, alone, rtol=1e-9, atol=0)
