"""What scattered stiffness and load do to the deflection of strips, each answer with its interval.

EI and P are lognormal and correlated, the load small: w = k P/EI is lognormal, so that mean,
quantiles and probabilities are known but for k, which one equilibrium tells. Run as a script, it
draws histogram, convergence, and the bands of histories under a sudden load:
out/uncertainty_histogram.png, uncertainty_convergence.png and uncertainty_bands.png.
"""

import math
from pathlib import Path
from typing import Any

import torch

import torchbeam as tb

LAWS = {"EI": tb.laws.LogNormal(1.0, 0.15), "P": tb.laws.LogNormal(1e-3, 2e-4)}
RHO = 0.3  # of the normal scores: stiffer strips carry more


def scene(EI: torch.Tensor, P: torch.Tensor, *effects: tb.Damping) -> tb.Scene:
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=EI, mass=0.2)
    force = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    return tb.Scene(tb.Beam.straight(1.0, 4, section), [force, *effects], plane="xz")


def deflection(EI: torch.Tensor, P: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tip deflection (samples,) m and status."""
    state = tb.equilibrium(scene(EI, P), throw=False, engine="eager")
    return state.tip.position[:, 2], state.status


T = torch.linspace(0, 1.0, 51, dtype=torch.float64)


def history(EI: torch.Tensor, P: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Tip deflection (samples, time) m after the load is put on suddenly, and status."""
    solution = tb.simulate(scene(EI, P, tb.Damping(0.02)), T, step=0.02, throw=False)
    return solution.tip.position[..., 2].mT, solution.status


def scaled(theta: torch.Tensor) -> torch.Tensor:
    """w = k P/EI, for as many samples as one likes."""
    return K * theta[:, 1] / theta[:, 0]


K = (
    deflection(torch.ones(1, dtype=torch.float64), torch.full((1,), 1e-3, dtype=torch.float64))[
        0
    ].item()
    / 1e-3
)
mu = math.log(K) + LAWS["P"].mu - LAWS["EI"].mu
sigma = math.sqrt(
    LAWS["P"].sigma ** 2 + LAWS["EI"].sigma ** 2 - 2 * RHO * LAWS["P"].sigma * LAWS["EI"].sigma
)
exact = {
    "mean": math.exp(mu + sigma**2 / 2),
    "95 % quantile": math.exp(mu + 1.6448536 * sigma),
    "P(w > 0.5 mm)": 0.5 * math.erfc((math.log(5e-4) - mu) / sigma / 2**0.5),
}

samples = tb.monte_carlo(
    deflection, LAWS, 1024, correlation={("EI", "P"): RHO}, replicates=16, by_name=True
)
found = {
    "mean": samples.mean_interval(),
    "95 % quantile": samples.quantile(0.95, interval=0.95),
    "P(w > 0.5 mm)": samples.exceedance(5e-4),
}
print(samples)
for name, estimate in found.items():
    print(
        f"{name:14} {estimate.estimate:.4e}  {estimate.low:.4e} to {estimate.high:.4e}  exact "
        f"{exact[name]:.4e}"
    )
rough = tb.monte_carlo(
    deflection, LAWS, 4096, correlation={("EI", "P"): RHO}, by_name=True, until=0.005, chunk=512
)
print(f"{len(rough)} strips for half a per cent of the mean")

CHECK = (found["mean"].estimate / exact["mean"] - 1).item()
EXPECTED, TOLERANCE = 0.0, 1e-3  # three times the standard error of 1024 points


def draw(folder: Path = Path("out")) -> None:
    options: dict[str, Any] = dict(correlation={("EI", "P"): RHO}, replicates=16, by_name=True)
    print(
        "wrote",
        tb.plot.save(
            tb.plot.histogram(samples, name="tip deflection / m"),
            folder / "uncertainty_histogram.png",
        ),
    )
    runs = {
        f"{design}": tb.monte_carlo(
            scaled,
            LAWS,
            2**18,
            design=design,
            correlation=options["correlation"],
            replicates=16,
            chunk=2**14,
        )
        for design in ("plain", "sobol")
    }
    print(
        "wrote",
        tb.plot.save(
            tb.plot.convergence(runs, exact["mean"]), folder / "uncertainty_convergence.png"
        ),
    )
    motion = tb.monte_carlo(history, LAWS, 512, **options)
    print(
        "wrote",
        tb.plot.save(
            tb.plot.bands(T, motion, name="tip deflection / m"), folder / "uncertainty_bands.png"
        ),
    )


if __name__ == "__main__":
    draw()
