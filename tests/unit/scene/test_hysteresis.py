"""Laws with memory, by themselves: `ElastoPlastic`, `BoucWen`."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.core.leaves import bound
from torchbeam.scene.coordinate_law import Travel

NOW, STEP = torch.zeros((), dtype=torch.float64), torch.ones(1, dtype=torch.float64)
LAWS = {
    "perfect": tb.ElastoPlastic(100.0, 2.0),
    "kinematic": tb.ElastoPlastic(100.0, 2.0, hardening=15.0),
    "mixed": tb.ElastoPlastic(100.0, 2.0, hardening=15.0, kinematic=0.3),
    "Bouc-Wen": tb.BoucWen(100.0, 2.0, ratio=0.1, n=2.0, beta=0.6, gamma=0.4),
    "Bouc-Wen, n = 1": tb.BoucWen(100.0, 2.0, n=1.0, beta=0.6, gamma=-0.3),
}


@pytest.fixture(params=LAWS)
def law(request):
    return bound(LAWS[request.param], torch.float64, torch.device("cpu"))


def start(law, count):
    """Coordinates (count,) and what is remembered there, after some way of each."""
    generator = torch.Generator().manual_seed(1)
    q, memory = torch.zeros(count, dtype=torch.float64), torch.zeros(count, law.memory).double()
    for _ in range(6):
        after = 0.08 * (2 * torch.rand(count, generator=generator, dtype=torch.float64) - 1)
        memory, q = law.response(Travel(q, after, memory, NOW, STEP)).memory, after
    return q, memory, generator


@pytest.mark.parametrize("dt", [STEP, None])
def test_the_slope_is_the_derivative(law, dt):
    """Of the load by the coordinate after, elastic, through yield and turning around; rounding of
    the implicit root is 1e-15 of it.
    """
    q, memory, generator = start(law, 60)
    after = q + 0.1 * (2 * torch.rand(60, generator=generator, dtype=torch.float64) - 1)
    after.requires_grad_()
    response = law.response(Travel(q, after, memory, NOW, dt))
    (slope,) = torch.autograd.grad(response.load.sum(), after)
    assert_close(response.slope.detach(), slope, rtol=1e-11, atol=1e-9)


def random_loops(count):
    """Bouc-Wen laws with exponents from 1 to 20 and shapes of the loop, two in ten with n = 1 and
    one in ten without slope on the way back; bounds of z.
    """
    generator = torch.Generator().manual_seed(3)

    def draw(low, high):
        return low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)

    n = torch.where(draw(0, 1) < 0.2, 1.0, draw(0, 3).exp())
    beta = draw(0.1, 1.1)
    gamma = torch.where(draw(0, 1) < 0.1, beta, beta * draw(-0.9, 1))
    law = tb.BoucWen(10.0, 2.0, ratio=draw(0, 0.5), n=n, beta=beta, gamma=gamma)
    most = (beta + gamma) ** (-1 / n)
    return bound(law, torch.float64, torch.device("cpu")), most, draw


@pytest.mark.parametrize("dt", [STEP, None])
def test_z_stays_within_its_bound_in_any_step(dt):
    """2,000 random loops, from any z, by ways of 1e-5 to 1e4 times the yield one: |z| <=
    (beta + gamma)^(-1/n) (to rounding of a power), nothing is gained, M (q_after - q) is what is
    stored and lost, and the slope is the derivative. The midpoint rule overstepped by three.
    """
    law, most, draw = random_loops(2000)
    z, q, size = most * draw(-1, 1), draw(-1, 1), 10 ** draw(-5, 4)
    after = (q + torch.where(draw(0, 1) < 0.5, -0.2, 0.2) * size).requires_grad_()
    memory = torch.stack((z, 0 * z), -1)
    response = law.response(Travel(q, after, memory, NOW, dt))
    (slope,) = torch.autograd.grad(response.load.sum(), after, retain_graph=True)
    z, lost = response.memory.detach().unbind(-1)
    assert (z.abs() <= most * (1 + 1e-14)).all() and (lost >= 0).all()
    assert_close(response.slope.detach(), slope, rtol=1e-6, atol=1e-6)
    if dt is not None:
        energy = law.stored(after, response.memory) - law.stored(q, memory) + lost
        assert_close(energy, response.load * (after - q), rtol=1e-9, atol=1e-9)


def test_z_comes_to_its_place_in_an_equilibrium():
    """In one step of any length, against z' = 1 - f(z) by scipy: 0.011 of the bound at most."""
    law, most, draw = random_loops(40)
    start, ways = most * draw(-1, 1), 10 ** draw(-1, 1.5)
    memory = torch.stack((start, 0 * start), -1)
    after = law.response(Travel(0 * ways, ways / 5, memory, NOW, None)).memory[:, 0]

    def rate(x, z, n, beta, gamma):
        return 1 - np.abs(z) ** n * (gamma + beta * np.sign(z))

    for k, shape in enumerate(torch.stack((law.n, law.beta, law.gamma), -1).numpy()):
        exact = solve_ivp(
            rate, (0, ways[k]), start[k : k + 1], method="LSODA", rtol=1e-8, args=tuple(shape)
        )
        assert abs(after[k] - exact.y[0, -1]) < 0.012 * most[k]


def test_a_step_stores_and_loses_what_it_takes(law):
    """M (q_after - q) is the change of what is stored and what is lost, exactly; never less than
    nothing is lost, in steps of any length.
    """
    q, memory, generator = start(law, 200)
    way = 10.0 ** (3 * torch.rand(200, generator=generator, dtype=torch.float64) - 3)
    after = q + torch.where(torch.arange(200) % 2 == 0, 1, -1) * way
    response = law.response(Travel(q, after, memory, NOW, STEP))
    stored = law.stored(after, response.memory) - law.stored(q, memory)
    lost = response.memory[..., 1] - memory[..., 1]
    assert (lost >= 0).all()
    assert_close(response.load * (after - q), stored + lost, rtol=1e-12, atol=1e-13)


def cycled(law, amplitude, cycles, steps):
    """Load, memory after steps (time, *) of a sine from zero; steps: of a quarter."""
    q = amplitude * torch.sin(torch.arange(4 * cycles * steps + 1) * (math.pi / 2 / steps)).double()
    memory, kept, loads = torch.zeros(law.memory).double(), [], []
    for a, b in pairwise(q):
        response = law.response(Travel(a, b, memory, NOW, STEP))
        memory = response.memory
        kept.append(memory)
        loads.append(response.load)
    return q, torch.stack(loads), torch.stack(kept)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_cycle_of_a_perfect_hinge_loses_its_area(steps):
    """4 M_y (q_max - q_y) a cycle, to rounding, in steps of any length: turning points are ends of
    steps.
    """
    law = LAWS["perfect"]
    *_, memory = cycled(bound(law, torch.float64, torch.device("cpu")), 0.05, 2, steps)
    lost = memory[8 * steps - 1, 1] - memory[4 * steps - 1, 1]
    assert lost.item() == pytest.approx(4 * 2.0 * (0.05 - 0.02), rel=1e-12)


def test_hardening_of_one_kind_shakes_down_and_of_the_other_does_not():
    """Isotropic hardening widens the elastic range until a cycle is elastic: kappa tends to
    (k q_max - M_y)/H. Kinematic hardening has the same loop in each cycle, which loses
    4 M_y (q_max - q_y) k/(k + H), and does not ratchet.
    """
    lost, plastic = {}, {}
    for name, share in (("isotropic", 0.0), ("kinematic", 1.0)):
        law = tb.ElastoPlastic(100.0, 2.0, hardening=25.0, kinematic=share)
        law = bound(law, torch.float64, torch.device("cpu"))
        *_, memory = cycled(law, 0.05, 60, 3)
        lost[name] = memory[11::12, 1].diff()
        plastic[name] = memory[:, 0], memory[-1, 2]
    assert lost["isotropic"][-1] < 1e-9 * lost["isotropic"][0]
    assert plastic["isotropic"][1].item() == pytest.approx((100 * 0.05 - 2.0) / 25.0, rel=1e-6)
    area = torch.full_like(lost["kinematic"], 4 * 2.0 * 0.03 * 100 / 125)
    assert_close(lost["kinematic"], area, rtol=1e-12, atol=0)
    peaks = plastic["kinematic"][0][12 + 2 :: 12]
    assert_close(peaks, peaks[:1].expand_as(peaks), rtol=1e-12, atol=0)


@pytest.mark.parametrize("shape", [dict(n=1.0), dict(n=2.0), dict(n=3.5, beta=0.7, gamma=0.2)])
def test_bouc_wen_against_the_differential_equation(shape):
    """A loop by q = 0.08 sin: scipy's z (LSODA, 1e-11), with errors of second order in the step;
    and in one step to an equilibrium within 0.01, as the docstring says.
    """
    law = tb.BoucWen(100.0, 2.0, ratio=0.1, **shape)
    n, beta, gamma = float(law.n), float(law.beta), float(law.gamma)

    def rate(t, z):
        v = 0.08 * math.cos(t)
        power = np.abs(z) ** n
        return 50.0 * (v - beta * abs(v) * power * np.sign(z) - gamma * v * power)

    exact = solve_ivp(rate, (0, 2 * math.pi), [0.0], rtol=1e-11, atol=1e-12, method="LSODA",
                      t_eval=np.linspace(0, 2 * math.pi, 9)).y[0, 1:]  # fmt: skip
    law = bound(law, torch.float64, torch.device("cpu"))
    errors = []
    for steps in (64, 128):
        *_, memory = cycled(law, 0.08, 1, steps)
        errors.append(np.abs(memory[steps // 2 - 1 :: steps // 2, 0].numpy() - exact).max())
    assert errors[1] < 3e-4 and errors[0] / errors[1] > 3.5
    zero, peak = torch.zeros((), dtype=torch.float64), torch.tensor(0.08, dtype=torch.float64)
    rest = law.response(Travel(zero, peak, torch.zeros(2).double(), NOW, None))
    assert abs(rest.memory[0].item() - exact[1]) < 0.01


@refusals(
    (lambda: tb.ElastoPlastic(0.0, 1.0), "positive"),
    (lambda: tb.ElastoPlastic(1.0, 1.0, hardening=-1.0), "hardening"),
    (lambda: tb.ElastoPlastic(1.0, 1.0, kinematic=1.5), "a number from 0 to 1 is wanted"),
    (lambda: tb.BoucWen(1.0, 1.0, n=0.5), "n = 0.5 was given; n from 1 on"),
    (lambda: tb.BoucWen(1.0, 1.0, gamma=0.6), "which would give energy"),
    (lambda: tb.BoucWen(1.0, 1.0, ratio=2.0), "a number from 0 to 1 is wanted"),
    (lambda: tb.Hinge(None, "hub", hysteresis=2.0), "an ElastoPlastic or a BoucWen"),
    (lambda: tb.Hinge(None, "hub", angle=0.1, hysteresis=tb.BoucWen(1.0, 1.0)), "prescribed"),
)
def test_what_does_not_fit_is_refused(make):
    make()
