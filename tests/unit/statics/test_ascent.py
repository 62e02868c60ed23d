"""Load steps where what resists rises with the load, and where it has to act in full."""

import math

import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from torch.testing import assert_close

import torchbeam as tb

P = 2.0  # N, EI = L = 1


def tip_of(turning: float, sliding: float) -> tuple[float, float]:
    """Tip (x, z) of the elastica theta'' = -P cos(theta), theta'(1) = 0, behind an elastic clamp:
    theta'(0) = turning theta(0), z(0) = P/sliding; by shooting with SciPy, to 1e-10.
    """

    def ends(theta: float) -> torch.Tensor:
        def rates(s, y):
            cosine, sine = math.cos(y[0]), math.sin(y[0])
            return [y[1], -P * cosine, cosine, sine]

        start = [theta, turning * theta, 0.0, P / sliding]
        return solve_ivp(rates, (0, 1), start, rtol=1e-10, atol=1e-12).y[:, -1]

    theta = brentq(lambda theta: ends(theta)[1], 1e-3, 1.55, xtol=1e-12)
    return tuple(ends(theta)[2:])


@pytest.mark.parametrize("engine", ("eager", "compiled"))
def test_a_clamp_that_is_softer_than_the_load(engine):
    """Clamps of 0.3, 1 and 20 N m/rad under 2 N m: of the softer two no share of clamp and load
    together is in balance near the shape at no load. Tips of 8 quadratic elements to
    6e-6 (of 16, by fourth order, to 5e-7), and each sample as alone.
    """
    section = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1.0, EI=1.0, mass=1.0)
    beam = tb.Beam.straight(1.0, 8, section, order=2)
    turning, sliding = torch.tensor([0.3, 1.0, 20.0], requires_grad=True), 50.0

    def tip(turning):
        slides, turns = torch.full_like(turning, sliding), turning
        clamp = tb.RootSpring(torch.stack((*3 * [slides], *3 * [turns]), -1))
        scene = tb.Scene(beam, [tb.TipLoad(force=(0.0, 0.0, P)), clamp], plane="xz")
        return tb.equilibrium(scene, engine=engine).tip.position[..., [0, 2]]

    tips = tip(turning)
    want = torch.tensor([tip_of(k, sliding) for k in turning.tolist()])
    assert_close(tips, want, rtol=0, atol=6e-6)
    assert_close(tip(turning[1]), tips[1], rtol=0, atol=1e-9)
    (slope,) = torch.autograd.grad(tips[0, 1], turning)
    by = (tip_of(0.301, sliding)[1] - tip_of(0.299, sliding)[1]) / 0.002
    assert_close(slope, torch.tensor([by, 0.0, 0.0]), rtol=1e-4, atol=0)


@pytest.mark.parametrize("engine", ("eager", "compiled"))
def test_a_taut_cable_in_its_plane(engine):
    """EI = 1e-7 N m^2 under 0.981 N/m, whose ends stand 0.01, 0.1, 1 and 5 % of its length further
    apart: as stiff as a beam it would fall by 1e5 lengths. Pull H and dH/d(span) of the elastic
    catenary, span = H/EA + 2 H/q asinh(q/(2 H)) (Irvine 1981, Cable Structures, 2.3), to 2e-7 by
    quadratic elements; each sample as alone.
    """
    q, EA = 0.981, 1e4
    section = tb.Section.from_stiffness(EA=EA, GA=EA, GJ=1e-7, EI=1e-7, mass=0.1)
    beam, pin = tb.Beam.straight(1.0, 16, section, order=2), tb.Support(0, rotation="xz")

    def pull(stretch):
        away = torch.stack((stretch, 0 * stretch, 0 * stretch), -1)
        supports = (pin, tb.Support(-1, rotation="xz", displacement=away))
        scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81))], supports=supports, plane="xz")
        return tb.equilibrium(scene, engine=engine).reaction_of(1).force[..., 0]

    def catenary(stretch):
        def gap(H):
            return H / EA + 2 * H / q * math.asinh(q / (2 * H)) - 1 - stretch

        return brentq(gap, 1e-2, 1e5, xtol=1e-12)

    stretch = torch.tensor([1e-4, 1e-3, 1e-2, 5e-2], requires_grad=True)
    H = pull(stretch)
    assert_close(H, torch.tensor([*map(catenary, stretch.tolist())]), rtol=2e-7, atol=0)
    assert_close(pull(stretch[1]), H[1], rtol=1e-9, atol=0)
    (slope,) = torch.autograd.grad(H.sum(), stretch)
    by = [(catenary(e + 1e-6) - catenary(e - 1e-6)) / 2e-6 for e in stretch.tolist()]
    assert_close(slope, torch.tensor(by), rtol=1e-6, atol=0)


def test_a_soft_cantilever_that_its_tip_load_pulls_tight():
    """EI = 1e-8 N m^2 under q = 0.981 N/m, P = 10 N along it at the tip. Of a flexible line
    x = P/q asinh(q L/P) + P L/EA and z = -(sqrt(P^2 + (q L)^2) - P)/q - q L^2/(2 EA); the clamp
    bends it over sqrt(EI/P) = 3e-5 m, which moves the tip by at most a tenth of that: 3e-6 m,
    of which 3e-7 m are seen.
    """
    q, P, EA = 0.981, 10.0, 1e4
    section = tb.Section.from_stiffness(EA=EA, GA=EA, GJ=1e-8, EI=1e-8, mass=0.1)
    loads = [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=(P, 0, 0))]
    scene = tb.Scene(tb.Beam.straight(1.0, 16, section, order=2), loads, plane="xz")
    x, _, z = tb.equilibrium(scene).tip.position.tolist()
    assert x == pytest.approx(P / q * math.asinh(q / P) + P / EA, rel=0, abs=1e-6)
    assert z == pytest.approx((P - math.hypot(P, q)) / q - q / (2 * EA), rel=0, abs=1e-6)
