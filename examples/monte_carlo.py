"""How far 4,096 strips bend whose stiffness and load scatter: batches of static equilibria, tail
included.

EI is lognormal with a coefficient of variation of 20 %, the dead transverse tip load P normal about
P L^2/EI = 2 with 15 %, both from one scrambled Sobol sequence (`tb.monte_carlo`). For an
inextensible strip the deflection is a function of P L^2/EI alone, so the quantiles are known from
the elastica: interpolated in the tabulated closed form and evaluated at the same samples. Run as a
script, it also draws the histogram to out/monte_carlo.png.
"""

import json
import math
from pathlib import Path

import numpy as np
import torch
from torch.distributions import LogNormal, Normal

import torchbeam as tb

SAMPLES, N = 4096, 16
LEVELS = torch.tensor([0.01, 0.1, 0.5, 0.9, 0.99], dtype=torch.float64)
TABLE = json.loads(
    (Path(__file__).parents[1] / "studies/data/elastica_dead_tip_load.json").read_text()
)["values"]


SIGMA = math.sqrt(math.log(1 + 0.2**2))
LAWS = {
    "EI": LogNormal(
        torch.tensor(-(SIGMA**2) / 2, dtype=torch.float64), torch.tensor(SIGMA, dtype=torch.float64)
    ),
    "P": Normal(torch.tensor(2.0, dtype=torch.float64), torch.tensor(0.3, dtype=torch.float64)),
}


def deflection(theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tip deflection over length (samples,) and status of inextensible, unshearable strips with EI,
    P (samples, 2).
    """
    EI, P = theta.unbind(-1)
    section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=math.inf, EI=EI, mass=1.0)
    load = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    state = tb.equilibrium(tb.Scene(tb.Beam.straight(1.0, N, section), [load]), throw=False)
    return state.tip.position[:, 2], state.status


def elastica(alpha: torch.Tensor) -> torch.Tensor:
    """w/L by cubic Hermite interpolation of the table's values and slopes (good to 2e-5); w is odd
    in alpha.
    """
    rows = [(0.0, 0.0, 1 / 3)] + [(v["alpha"], v["w_over_L"], v["dw_dalpha"]) for v in TABLE]
    a, w, slope = np.array(rows).T
    x = alpha.abs().numpy()
    i = np.clip(np.searchsorted(a, x) - 1, 0, len(a) - 2)
    h = a[i + 1] - a[i]
    s = (x - a[i]) / h
    rise = w[i] + (w[i + 1] - w[i]) * s * s * (3 - 2 * s)
    return alpha.sign() * torch.as_tensor(
        rise + h * s * (1 - s) * (slope[i] * (1 - s) - slope[i + 1] * s), dtype=torch.float64
    )


def elastica_of(theta: torch.Tensor) -> torch.Tensor:
    return elastica(theta[:, 1] / theta[:, 0])


strips = tb.monte_carlo(deflection, LAWS, SAMPLES, chunk=1024)
found, wanted = strips.quantile(LEVELS), elastica_of(strips.theta).quantile(LEVELS)
CHECK = (found - wanted).abs().max().item()  # largest error of a quantile, of the length
EXPECTED, TOLERANCE = 0.0, 4e-4  # measured 2.9e-4: sixteen one-point elements

print(strips)
print("quantile      w/L  elastica")
for level, a, b in zip(LEVELS.tolist(), found.tolist(), wanted.tolist(), strict=True):
    print(f"{100 * level:6.0f} %  {a:.5f}   {b:.5f}")
print(f"{SAMPLES} strips, N = {N}: largest error of a quantile {CHECK:.1e} of the length")


def draw(path: Path = Path("out/monte_carlo.png")) -> None:
    axis = tb.plot.axes((6, 3.6))
    axis.hist(
        strips.good, bins=60, density=True, color="C0", alpha=0.75, label=f"{SAMPLES:,} strips"
    )
    many = tb.monte_carlo(elastica_of, LAWS, 2**18, seed=1, chunk=2**16)
    density = np.histogram(many.y, bins=160, density=True)
    axis.plot((density[1][1:] + density[1][:-1]) / 2, density[0], "k", lw=1, label="elastica")
    top = axis.get_ylim()[1]
    for level, q in zip(LEVELS.tolist(), found.tolist(), strict=True):
        axis.axvline(q, color="C1", lw=1, ls="--")
        axis.text(
            q, 1.01 * top, f"{100 * level:g} %", color="C1", ha="center", va="bottom", fontsize=8
        )
    axis.set(xlabel="tip deflection / length", ylabel="probability density", ylim=(0, top))
    axis.legend(frameon=False, loc="upper left")
    print("wrote", tb.plot.save(axis, path, dpi=160))


if __name__ == "__main__":
    draw()
