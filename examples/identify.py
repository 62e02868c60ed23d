"""Stiffness and mass of a cantilever found from its motion, by gradients through the simulation.

The data are not ours: the tip of the common dynamic case (EI = 1 N m^2, 0.2 kg/m, a dead transverse tip load of 1 N applied
suddenly), on which two independent codes agree, every 10 ms over the first 0.4 s: half a period (0.3 s leads from this start
to a false minimum). From a start that is 40 % too soft and 75 % too heavy, `tb.identify` searches the logarithms of EI and m;
the Jacobian comes from forward mode, the directions of the two parameters being the two samples of one batch.
What is left, 0.7 % of m, is the error of eight elements at 10 ms. Run as a script, it also draws out/identify.png.
"""

import json
import math
from pathlib import Path

import torch

import torchbeam as tb

torch.set_default_dtype(torch.float64)
CASE = json.loads((Path(__file__).parents[1] / "torchbeam/data/dynamic_step_load.json").read_text())
WINDOW, N = 41, 8  # samples, elements
T = torch.tensor(CASE["t"][:WINDOW])
TIP = torch.tensor(CASE["tip"][:WINDOW])
TRUE, START = (1.0, 0.2), (0.6, 0.35)


def tip(theta: torch.Tensor) -> torch.Tensor:
    """Tip (batch, time, 3) for EI, m (batch, 2); what else the section has is given with the data."""
    EI, m = theta.unbind(-1)
    section = tb.Section.from_stiffness(EA=4e4, GA=1.4835e4, GJ=0.769, EI=EI, mass=m, inertia=5e-6)
    scene = tb.Scene(tb.Beam.straight(1.0, N, section), [tb.TipLoad(force=(0, 1.0, 0))])
    return tb.simulate(scene, T, step=0.01).tip.position.movedim(0, 1)


fit = tb.identify(tip, TIP, START, names=("EI", "m"), log=True, tolerance=1e-3)
CHECK = max(abs(math.log(a / b)) for a, b in zip(fit.theta.tolist(), TRUE, strict=True))  # larger relative error of the two
EXPECTED, TOLERANCE = 0.0, 0.01

print("     EI       m")
for EI, m in fit.history[:, 0].tolist():
    print(f"{EI:7.4f} {m:7.4f}")
print(f"{fit}: within {100 * CHECK:.2f} % of 1 and 0.2")


def draw(path: Path = Path("out/identify.png")) -> None:
    axis = tb.plot.axes((6, 3.6))
    with torch.no_grad():
        start = tip(torch.tensor([START]))[0]
    axis.plot(T, TIP[:, 1], "o", ms=4, color="0.6", label="data (other codes)")
    EI, m = fit.theta.tolist()
    axis.plot(T, start[:, 1], "C1--", label="start: EI = 0.60, m = 0.35")
    axis.plot(T, fit.y[:, 1], "C0", label=f"found: EI = {EI:.3f}, m = {m:.3f}")
    axis.set(xlabel="time / s", ylabel="tip deflection / m", xlim=(0, T[-1]), ylim=(0, None))
    axis.legend(frameon=False)
    print("wrote", tb.plot.save(axis, path, dpi=160))


if __name__ == "__main__":
    draw()
