"""The posterior of a stiffness and a clamp by Hamiltonian Monte Carlo (NUTS, pyro), beside
Laplace's and the profile's.

A strip of 0.5 m hangs from a clamp that gives way, and a ruler reads the tip under six weights to 1
mm. EI and the clamp's compliance c are nearly one number in such data (see `identify_wing.py`), so
that the posterior is a long ridge, which bends as c comes near zero. NUTS follows gradients of the
log density, each the adjoint of one batch of six equilibria. It walks in the coordinates of the
fit, divided by the Laplace approximation, so that the ridge is about round and few gradients make a
sample.

Laplace's intervals (logarithms of both) are a sixth wider than the posterior's, by an integral over
a grid; 200 samples know these widths to a tenth or so. The ridge, of which intervals of one
parameter tell nothing, bends away from Laplace's ellipse. Any sampler that takes a log density and
its gradient can stand in for pyro's. `pip install torchbeam[bayes]` has pyro. Run as a script, it
also draws the samples and Laplace's ellipse into out/identify_nuts.png.
"""

from pathlib import Path

import torch
from pyro import set_rng_seed
from pyro.infer import MCMC, NUTS
from torch.distributions import LogNormal

import torchbeam as tb

WEIGHTS = torch.tensor([0.5, 1.0, 2.0, 4.0, 6.0, 8.0], dtype=torch.float64)  # N
TRUE, SIGMA = {"EI": 1.0, "c": 0.05}, 1e-3  # N m^2, rad/(N m); m
PRIOR = {
    "EI": LogNormal(torch.tensor(0.0, dtype=torch.float64), torch.tensor(0.5, dtype=torch.float64)),
    "c": LogNormal(torch.tensor(-3.0, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)),
}
LEVEL, SAMPLES, WARMUP = 0.95, 200, 50


def sag(theta: dict[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
    """Heights (N, weights) of the tip for EI and c (N,), and status (N,)."""
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=1.0, EI=theta["EI"][:, None], mass=0.1)
    turning = 1 / theta["c"][:, None]
    effects = [
        tb.TipLoad(force=-WEIGHTS[:, None] * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)),
        tb.RootSpring((0.0, turning[..., None])),
    ]
    beam, foot = tb.Beam.straight(0.5, 6, section).linked(), tb.Support(0, rotation="xz")
    state = tb.equilibrium(tb.Scene(beam, effects, supports=foot, plane="xz"), throw=False)
    return state.tip.position[..., 2], state.status.amax(-1)


exact = sag({name: torch.tensor([value], dtype=torch.float64) for name, value in TRUE.items()})[0][
    0
]
DATA = exact + SIGMA * torch.randn(
    6, generator=torch.Generator().manual_seed(3), dtype=torch.float64
)
fit = tb.identify(
    sag,
    tb.Measurement(DATA, SIGMA),
    {name: tb.Parameter(2 * TRUE[name], "log", prior=PRIOR[name]) for name in TRUE},
)
ROOT = torch.linalg.cholesky(fit.x_covariance)


def parameters(z: torch.Tensor) -> torch.Tensor:
    """log theta (..., 2)."""
    return fit.x + z @ ROOT.mT


def energy(walker: dict[str, torch.Tensor]) -> torch.Tensor:
    """Minus the log density of z (2,): of the data, of the priors, and of theta by its
    logarithm.
    """
    x = parameters(walker["z"])
    theta = dict(zip(TRUE, x.exp(), strict=True))
    height, status = sag({name: value[None] for name, value in theta.items()})
    if status.any():
        return torch.tensor(torch.inf, dtype=torch.float64)
    prior = sum(PRIOR[name].log_prob(value) for name, value in theta.items()) + x.sum()
    return ((height[0] - DATA) / SIGMA).square().sum() / 2 - prior


set_rng_seed(0)
chain = MCMC(
    NUTS(potential_fn=energy, max_tree_depth=4),
    num_samples=SAMPLES,
    warmup_steps=WARMUP,
    disable_progbar=True,
    initial_params={"z": torch.zeros(2, dtype=torch.float64)},
)
chain.run()
DRAWN = dict(zip(TRUE, parameters(chain.get_samples()["z"]).exp().mT, strict=True))
tails = torch.tensor([(1 - LEVEL) / 2, (1 + LEVEL) / 2], dtype=torch.float64)
INTERVALS = {
    "NUTS": torch.stack([DRAWN[name].quantile(tails) for name in TRUE]),
    "Laplace": fit.interval(LEVEL),
    "profile": fit.interval(LEVEL, method="profile"),
}
WIDTH = {method: (found[:, 1] / found[:, 0]).log() for method, found in INTERVALS.items()}
CHECK = (WIDTH["Laplace"][0] / WIDTH["NUTS"][0] - 1).abs().item()
# of the width of EI's interval: 200 samples know a 95 % interval's to 10 %
EXPECTED, TOLERANCE = 0.0, 0.35

print(fit.summary())
for method, interval in INTERVALS.items():
    print(
        f"{method:8s} 95 %: "
        + ", ".join(
            f"{name} {low:.4f} to {high:.4f}"
            for name, (low, high) in zip(TRUE, interval.tolist(), strict=True)
        )
    )


def draw(path: Path = Path("out/identify_nuts.png")) -> None:
    axis = tb.plot.axes((5, 4))
    axis.plot(DRAWN["EI"], DRAWN["c"], ".", ms=4, color="0.5", label="NUTS")
    turn = torch.linspace(0, 2 * torch.pi, 100, dtype=torch.float64)
    # 95 % of two normal numbers
    ellipse = parameters(2.448 * torch.stack((turn.cos(), turn.sin()), -1)).exp()
    axis.plot(*ellipse.mT, "C0", lw=1, label="Laplace, 95 %")
    axis.plot(TRUE["EI"], TRUE["c"], "r+", ms=10, label="true")
    axis.set(xlabel="EI / N m$^2$", ylabel="c / (rad/(N m))")
    axis.legend(frameon=False)
    print("wrote", tb.plot.save(axis, path, dpi=160))


if __name__ == "__main__":
    draw()
