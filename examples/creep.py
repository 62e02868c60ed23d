"""A soft arm that creeps: rubber whose damping hardly depends on the frequency, as a Prony series.

The arm is let go level, and hangs on in its instantaneous shape. Then it sags on under its weight,
over minutes, towards its long-time equilibrium. The material is a fractional Zener solid of order a
with the share g and the time tau (Bagley and Torvik 1983). Under a constant small load it creeps as

    u(t)/u(0) = 1 + g/(1 - g) (1 - E_a(-(1 - g) (t/tau)^a))

with Mittag-Leffler's function E_a, an integral over decays of all rates (Mainardi 2010, chapter 3).
`tb.Viscoelastic.fractional` fits a few arms to it over a band of frequencies. The check is their
creep under a thousandth of the weight against this closed form. Run as a script, it also draws
out/creep.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

ORDER, SHARE, TIME = 0.35, 0.6, 1.0  # of a soft silicone's kind; s
BAND = 1e-2, 1e2  # rad/s
STEP, END = 0.02, 60.0  # s
SETTLED = 10.0  # s, after which its vibration has died

section = tb.Section.circle(0.008, E=2e6, nu=0.48, rho=1100.0)
arm = tb.Beam.straight(0.2, 8, section)
rubber = tb.Viscoelastic.fractional(ORDER, SHARE, TIME, BAND)
t = torch.arange(round(END / STEP) + 1, dtype=torch.float64) * STEP
shares = torch.tensor([1e-3, 1.0], dtype=torch.float64)  # of the weight
weight = tb.Gravity(shares[:, None] * torch.tensor([0.0, 0, -9.81], dtype=torch.float64))


def mittag_leffler(order: float, x: torch.Tensor) -> torch.Tensor:
    """E_a(-x^a) of x (...) >= 0 for 0 < a < 1."""
    log_r = torch.linspace(-60, 40, 4001, dtype=torch.float64)
    r, c = log_r.exp() ** order, math.cos(order * math.pi)
    weights = math.sin(order * math.pi) / math.pi * r / (r**2 + 2 * c * r + 1)
    return torch.trapezoid(weights * torch.exp(-x[..., None] * log_r.exp()), log_r)


begun = tb.equilibrium(tb.Scene(arm, [weight], plane="xz"))  # without memory: instantaneous
scene = tb.Scene(arm, [weight, rubber], plane="xz")
creep = tb.simulate(scene, t, initial=begun, step=STEP)
rest = tb.equilibrium(scene)  # with it: long-time
drop = -creep.tip.position[..., 2]  # (time, batch) m

ratio = drop[:, 0] / drop[0, 0]
slow = (1 - SHARE) ** (1 / ORDER) / TIME  # 1/s
exact = 1 + SHARE / (1 - SHARE) * (1 - mittag_leffler(ORDER, slow * t))
seen = t >= SETTLED
CHECK = ((ratio - exact).abs() / exact)[seen].max().item()
EXPECTED, TOLERANCE = 6.5e-4, 1e-4  # the series is off by 7e-4 of the stiffness

arms = rubber.shares.shape[-1]
print(f"{arms} arms are off by {100 * rubber.error:.2f} % of the stiffness over the band")
print(f"creep from {SETTLED:g} s on is off by {100 * CHECK:.3f} % of Mittag-Leffler's")
for now in (0.0, 1.0, 10.0, END):
    k = round(now / STEP)
    print(f"{now:5.0f} s: tip {1e3 * drop[k, 1]:6.2f} mm down, small load x {ratio[k]:.3f}")
print(f"at last: tip {-1e3 * rest.tip.position[1, 2]:6.2f} mm down")


def draw(path: Path = Path("out/creep.png")) -> None:
    left, right = tb.plot.grid(1, 2, (11, 4.2))
    for i, now in enumerate((0.0, 1.0, 10.0, END)):
        state, label = creep.state[round(now / STEP), 1], f"{now:g} s"
        tb.plot.shape(state, left, plane="xz", nodes=False, color=f"C{i}", label=label)
    tb.plot.shape(rest[1], left, plane="xz", nodes=False, color="0.3", ls="--", label="at last")
    left.legend(frameon=False)
    right.semilogx(t[1:], ratio[1:], label=f"beam, {arms} arms")
    right.semilogx(t[1:], exact[1:], "k--", lw=1, label="fractional solid")
    right.set(xlabel="t / s", ylabel="drop of the tip / instantaneous one")
    right.legend(frameon=False)
    print("wrote", tb.plot.save(right, path))


if __name__ == "__main__":
    draw()
