"""Searches that once crept take few evaluations: a decay of many periods, a bound, noise by channel
beside a line.
"""

import math

import pytest
import torch

import torchbeam as tb

PERIOD = 2 * math.pi / (3.516 * math.sqrt(1.0 / (0.2 * 0.5**4)))  # s, the first bending mode
T = torch.linspace(0, 8 * PERIOD, 97)
TIP = tb.sensors.TipPosition()["z"]


def decay(theta):
    """A cantilever that is let go, for eight periods."""
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=theta["EI"], mass=0.2,
                                        inertia=1e-6)  # fmt: skip
    beam = tb.Beam.straight(0.5, 2, section)
    pulled = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 0.2))], plane="xz")
    start = tb.equilibrium(pulled, throw=False, engine="compiled")
    free = tb.Scene(beam, [tb.Damping(theta["tau"])], plane="xz")
    return tb.simulate(free, T, initial=start, step=PERIOD / 12, engine="compiled")


@pytest.fixture(scope="module")
def heights():
    true = {"EI": torch.ones(1), "tau": torch.full((1,), 1e-3)}
    noise = torch.randn(97, 1, generator=torch.Generator().manual_seed(0))
    return tb.observe(decay(true), TIP, T)[:, 0] + 1e-4 * noise


LINE = {"offset": True, "drift": True}
CASES = {
    "8 periods": ({}, {}, {}),
    "a bound": ({}, {"tau": tb.Parameter(2e-3, bounds=(1.5e-3, 1e-2))}, {}),
    "by channel, beside a line": ({"sigma": None, **LINE}, {}, {"noise": "channel"}),
    "that remembers, beside a line": ({"sigma": None, "noise": "ar1", **LINE}, {},
                                      {"noise": "channel"}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_evaluations(case, heights):
    """At most 20 batches (of 9 to 14 in fact), without forward mode, from 5 % off in EI and twice
    the damping."""
    of_data, of_start, options = CASES[case]
    data = tb.Measurement(heights, **{"sigma": 1e-4, "times": T, "sensor": TIP, **of_data})
    calls = []

    def counted(theta):
        calls.append(len(theta["EI"]))
        return decay(theta)

    fit = tb.identify(counted, data, {"EI": 1.05, "tau": 2e-3, **of_start}, **options)
    assert fit.status == 0
    assert fit.derivatives == "difference"
    assert len(calls) <= 20, calls
    assert bool(fit.held.any()) is (case == "a bound")
