"""How likely a strip bends too far, when that is one chance in a million: subset simulation, FORM
and importance sampling.

EI and P are lognormal and the load small, so that w = k P/EI is lognormal and the probability
known; k comes from one equilibrium. A thousand plain samples would see none, and say "less than 0.4
%".
"""

import math

import torch

import torchbeam as tb

LAWS = {"EI": tb.laws.LogNormal(1.0, 0.1), "P": tb.laws.LogNormal(1e-3, 2e-4)}


def deflection(EI: torch.Tensor, P: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tip deflection (samples,) m and status."""
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=EI, mass=0.2)
    force = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    state = tb.equilibrium(
        tb.Scene(tb.Beam.straight(1.0, 4, section), [force], plane="xz"),
        throw=False,
        engine="eager",
    )
    return state.tip.position[:, 2], state.status


K = (
    deflection(torch.ones(1, dtype=torch.float64), torch.full((1,), 1e-3, dtype=torch.float64))[
        0
    ].item()
    / 1e-3
)
BETA = 4.753424  # of 1e-6
sigma = math.hypot(LAWS["P"].sigma, LAWS["EI"].sigma)
LIMIT = math.exp(math.log(K) + LAWS["P"].mu - LAWS["EI"].mu + BETA * sigma)

plain = tb.monte_carlo(deflection, LAWS, 1024, design="plain", chunk=1024, by_name=True).exceedance(
    LIMIT
)
important = tb.rare_event(deflection, LAWS, LIMIT, 1024, method="importance", by_name=True)
subset = tb.rare_event(deflection, LAWS, LIMIT, 2000, by_name=True)
print(f"limit {1e3 * LIMIT:.3f} mm, exactly 1e-6")
print("plain samples:", plain)
print(important)
assert important.points is not None  # of this method
print("likeliest:", dict(zip(LAWS, important.points[0].tolist(), strict=True)))
print(subset)

CHECK = important.probability / 1e-6
EXPECTED, TOLERANCE = 1.0, 0.15  # three standard errors of 1024 points
