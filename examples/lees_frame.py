"""Lee's frame: two beams at a right angle, pinned at both feet, that snap through under a load
beside the corner.

`tb.path` follows the balance over both limit points. The check is the first limit load, P L^2/EI,
against that of two elasticas (no extension, no shear), solved by shooting with scipy; Lee, Manuel
and Rossow (1968, J. Eng. Mech. Div. ASCE 94, 521) give 18.552. Run as a script, it also draws
the path and shapes on it.
"""

import argparse
import math
from pathlib import Path

import torch
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve, minimize_scalar

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/lees_frame.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

# elements of order 2 in each leg; the load is at the end of the first one of the beam, a fifth of
# its length
N = 5

section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=1.0, EI=1.0, mass=1.0)
column = tb.Beam.straight(1.0, N, section, direction=(0, 1, 0), up=(0, 0, 1), order=2)
beam = tb.Beam.straight(1.0, N, section, root=(0, 1, 0), order=2)
scene = tb.Scene(
    {"column": column, "beam": beam},
    [tb.PointLoad(("beam", 2), force=tb.Input("P", 3))],
    joints=[tb.Weld(("column", -1), ("beam", 0))],
    supports=[tb.Support(("column", 0), rotation=""), tb.Support(("beam", -1), rotation="")],
    plane="xy",
)
loads = {"P": torch.tensor([0.0, -1.0, 0.0])}
LOAD = scene.beam.row(("beam", 2))


def sunk(state: tb.State) -> torch.Tensor:
    """By how much the loaded point has, m."""
    return 1 - state.position[..., LOAD, 1]


def elastica() -> tuple[float, float]:
    """(how far the loaded point has sunk, P L^2/EI) at the first limit of beams that only bend, by
    loads that bring it down by so much.
    """

    def along(end: list[float], force: tuple[float, float], length: float) -> list[float]:
        def rates(_s: float, y: list[float]) -> list[float]:
            return [
                math.cos(y[2]),
                math.sin(y[2]),
                y[3],
                force[0] * math.sin(y[2]) - force[1] * math.cos(y[2]),
            ]

        return (
            solve_ivp(rates, (0, length), end, rtol=1e-10, atol=1e-10, method="DOP853")
            .y[:, -1]
            .tolist()
        )

    def misses(z: list[float], down: float) -> list[float]:
        across, up, load, turn = z
        corner = along([0, 0, math.pi / 2 + turn, 0], (across, up), 1.0)
        corner[2] -= math.pi / 2
        loaded = along(corner, (across, up), 0.2)
        foot = along(loaded, (across, up + load), 0.8)
        return [foot[0] - 1, foot[1] - 1, foot[3], loaded[1] - 1 + down]

    guess = [-1.0, -1.5, 1.5, 0.02]
    for k in range(1, 21):
        guess = fsolve(misses, guess, args=(0.02 * k,))
    limit = minimize_scalar(
        lambda down: -fsolve(misses, guess, args=(down,))[2], bounds=(0.38, 0.43), method="bounded"
    )
    return limit.x, -limit.fun


DOWN, EXPECTED = elastica()
path = tb.path(scene, 24.0, step=0.5, control=sunk, target=torch.tensor(DOWN), inputs=loads)
# 0.03 are the elements'; the load hardly changes with the place there
CHECK, TOLERANCE = path.factor[-1].item(), 0.04

print(
    f"limit load {CHECK:.3f} EI/L^2 where the point has sunk by {DOWN:.3f} L; of two elasticas "
    f"{EXPECTED:.3f}"
)


def draw(file: Path = options.picture) -> None:
    path = tb.path(scene, 24.0, step=0.15, inputs=loads)
    axis, shapes = tb.plot.grid(1, 2)
    axis.plot(sunk(path.state), path.factor)
    axis.axhline(EXPECTED, color="0.6", lw=0.8)
    axis.set(xlabel="the loaded point has sunk by / L", ylabel="P L^2 / EI")
    for k in range(0, len(path.factor), 6):
        tb.plot.shape(path.state[k], shapes, plane="xy")
    print("wrote", tb.plot.save(axis, file))


if __name__ == "__main__":
    draw()
