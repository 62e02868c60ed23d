"""The batched model `theta (N, p) -> y (N, T)` with another library's least squares:
`scipy.optimize.least_squares`.

Whatever `tb.identify` takes, others take too. scipy asks for residuals of one theta and for their
Jacobian: the first is a batch of one, the second a batch of 2 p for central differences, in one
call of the compiled engine. EI and mass per length of a strip are found from its tip's motion after
a sudden load, with noise of 0.2 mm, by both, to the same minimum; scipy's Jacobian there gives the
same covariance. `pip install torchbeam[control]` has scipy.
"""

import numpy as np
import torch
from scipy.optimize import least_squares

import torchbeam as tb

T = torch.linspace(0, 0.8, 81)
TRUE, SIGMA = torch.tensor([1.0, 0.2]), 2e-4  # N m^2 and kg/m; m


def tip(theta: torch.Tensor) -> torch.Tensor:
    """Deflection of the tip (N, T) for EI and mass per length (N, 2)."""
    section = tb.Section.from_stiffness(
        EA=4e4, GA=1.5e4, GJ=0.8, EI=theta[:, 0], mass=theta[:, 1], inertia=5e-6
    )
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, section).linked(), [tb.TipLoad(force=(0, 0, 1.0))], plane="xz"
    )
    return tb.simulate(scene, T, step=0.005).tip.position[..., 2].mT


DATA = tip(TRUE[None])[0] + SIGMA * torch.randn(81, generator=torch.Generator().manual_seed(0))


def residuals(x: np.ndarray) -> np.ndarray:
    """(T,) over sigma, of log theta (p,)."""
    return ((tip(torch.tensor(x).exp()[None])[0] - DATA) / SIGMA).numpy()


def jacobian(x: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """(T, p) by central differences, all in one batch."""
    shifts = step * torch.eye(len(x))
    y = tip((torch.tensor(x) + torch.cat((shifts, -shifts))).exp()) / SIGMA
    return ((y[: len(x)] - y[len(x) :]) / (2 * step)).mT.numpy()


START = torch.tensor([0.6, 0.3])
found = least_squares(
    residuals, START.log().numpy(), jac=jacobian, method="lm", xtol=1e-10, ftol=1e-10
)
theta = torch.tensor(found.x).exp()
deviation = torch.tensor(np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))) * theta
fit = tb.identify(tip, DATA, START, sigma=SIGMA, log=True, names=("EI", "mass"))
CHECK = max(
    (theta / fit.theta - 1).abs().max().item() / 1e-5,
    (deviation / fit.deviation - 1).abs().max().item() / 1e-2,
)
EXPECTED, TOLERANCE = 0.0, 1.0  # parameters to 1e-5, deviations to 1e-2

print(
    f"scipy: EI = {theta[0]:.5f} +- {deviation[0]:.5f}, "
    f"mass = {theta[1]:.5f} +- {deviation[1]:.5f} in {found.nfev} evaluations"
)
print(fit)
