"""How many elements, which step? The answer for a swung cantilever, by `tb.converge`.

A strip whose height tapers to a half is swung by a moment at its tip that comes and goes. The path
of the tip is wanted to 1 %; the settings that were found are checked against elements of order 2
with four times the nodes, and a sixth of the step of fourth order. Run as a script, it also draws
out/converge.png: error against time of all that was tried.
"""

from pathlib import Path

import torch

import torchbeam as tb

WANTED = 1e-2


def section(s: torch.Tensor) -> tb.Section:
    """A height that falls from 4 to 2 mm over 0.5 m."""
    height = 0.004 * (1 - s)
    return tb.Section.rectangle(0.02, height, E=2.0e9, nu=0.35, rho=1150.0)


def moment(t: torch.Tensor) -> torch.Tensor:
    return torch.stack((0 * t, -0.25 * torch.sin(6 * t) ** 2, 0 * t), -1)


scene = tb.Scene(
    tb.Beam.straight(0.5, 8, section), [tb.TipLoad(moment=moment), tb.Damping(2e-4)], plane="xz"
)
t = torch.linspace(0, 1.0, 41)
best = tb.converge(scene, t, tb.sensors.TipPosition(), WANTED)

assert best.settings.step is not None  # of a motion
fine = tb.remesh(scene, 2 * best.settings.intervals, order=2)
limit = tb.simulate(fine, t, method="midpoint4", step=best.settings.step / 6).tip.position
moved = (limit - limit[0]).norm()
CHECK = ((best.solution.tip.position - limit).norm() / moved / WANTED).item()
EXPECTED, TOLERANCE = 0.5, 0.5  # of the wanted error: none to all of it

print(best)
print(best.code)
print(f"true error {CHECK * WANTED:.1e}, estimated {best.error:.1e}, wanted {WANTED:g}")

if __name__ == "__main__":
    print(tb.plot.save(tb.plot.tried(best), Path("out") / "converge.png"))
