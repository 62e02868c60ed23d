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
