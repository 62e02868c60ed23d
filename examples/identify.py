"""Stiffness and mass of a cantilever found from its motion, and what that motion does not tell.

The data are not ours: the tip of the common dynamic case (EI = 1 N m^2, 0.2 kg/m, a dead transverse
tip load of 1 N applied suddenly), on which two independent codes agree, every 10 ms over the first
0.8 s: one period. From a start that is half as stiff and half again as heavy, `tb.identify`
searches the logarithms of EI and m, by differences on the compiled engine. Then it is asked for the
rotary inertia and the shear stiffness too. These have less say in this motion than the error of the
mesh, and are named as not told. Run as a script, it also draws out/identify.png.
"""

import json
import math
from pathlib import Path

import torch

import torchbeam as tb

CASE = json.loads((Path(__file__).parents[1] / "studies/data/dynamic_step_load.json").read_text())
WINDOW, N = 81, 16  # samples, elements
T = torch.tensor(CASE["t"][:WINDOW])
TIP = torch.tensor(CASE["tip"][:WINDOW])
TRUE, START = {"EI": 1.0, "m": 0.2}, {"EI": 0.5, "m": 0.3}


def tip(theta: dict[str, torch.Tensor]) -> torch.Tensor:
    """Tip (batch, time, 3) for EI, m (batch,); what else the section has is given with the data."""
    section = tb.Section.from_stiffness(
        EA=4e4,
        GA=theta.get("GA", 1.4835e4),
        GJ=0.769,
        EI=theta["EI"],
        mass=theta["m"],
        inertia=theta.get("inertia", 5e-6),
    )
    scene = tb.Scene(
        tb.Beam.straight(1.0, N, section).linked(), [tb.TipLoad(force=(0, 1.0, 0))], plane="xy"
    )
    return tb.simulate(scene, T, step=0.0025).tip.position.movedim(0, 1)


fit = tb.identify(tip, TIP, START, log=True)
# larger relative error of the two
CHECK = max(abs(math.log(fit[name] / true)) for name, true in TRUE.items())
EXPECTED, TOLERANCE = 0.0, 0.001

print("     EI       m")
for EI, m in fit.history[:, 0].tolist():
    print(f"{EI:7.4f} {m:7.4f}")
print(f"{fit}: within {100 * CHECK:.2f} % of 1 and 0.2\n")

more = tb.identify(tip, TIP, {"EI": fit["EI"], "m": fit["m"], "inertia": 1e-5, "GA": 1e4}, log=True)
print(more.summary())


def draw(path: Path = Path("out/identify.png")) -> None:
    axis = tb.plot.axes((6, 3.6))
    with torch.no_grad():
        start = tip({name: torch.tensor([value]) for name, value in START.items()})[0]
    axis.plot(T, TIP[:, 1], "o", ms=4, color="0.6", label="data (other codes)")
    axis.plot(T, start[:, 1], "C1--", label="start: EI = {EI:.2f}, m = {m:.2f}".format(**START))
    axis.plot(T, fit.y[:, 1], "C0", label=f"found: EI = {fit['EI']:.3f}, m = {fit['m']:.3f}")
    axis.set(xlabel="time / s", ylabel="tip deflection / m", xlim=(0, T[-1]), ylim=(0, None))
    axis.legend(frameon=False)
    print("wrote", tb.plot.save(axis, path, dpi=160))


if __name__ == "__main__":
    draw()
