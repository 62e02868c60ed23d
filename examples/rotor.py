"""A rotor: three blades on a hub that turns against a flexible shaft, and its Campbell diagram.

Of motions in the plane of rotation, lag, one is collective: the blades bend as one against the
hub, which turns on its shaft. Two are differential: the blades' moments on the hub cancel, it
stands still, and each blade moves as if it were clamped; so do all three flap out of the plane.
`tb.modes` about the steady equilibrium in the turning frame, all speeds as one batch. The check is
against published frequencies of a clamped blade (Wright, Smith, Thresher and Wang 1982, J. Appl.
Mech. 49, 197), at rest the collective ones against the zero of a determinant, and how purely
collective or differential each lag mode is. Southwell's coefficients s, of w^2 = w0^2 + s W^2, are
printed: 1 smaller for lag than for flap. Run as a script, it also draws the diagram
(dots: published) and two modes.
"""

import argparse
import json
import math
from pathlib import Path

import torch
from scipy.optimize import brentq

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/rotor.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

TABLE = json.loads(
    (Path(__file__).parents[1] / "studies/data/rotating_cantilever_frequencies.json").read_text()
)["values"]
N, SHAFT, HUB = 5, 10.0, 0.05  # elements of order 2 a blade; EI/L, m L^3
SPEED = torch.tensor(
    [float(row["eta"]) for row in TABLE], dtype=torch.float64
)  # in (EI/(m L^4))^1/2, as frequencies
LAG, FLAP = (
    torch.tensor([row[name][:2] for row in TABLE], dtype=torch.float64) for name in ("lag", "flap")
)
BLADES = [(f"blade {k}", math.radians(120 * k)) for k in range(3)]


def rotor(speed: torch.Tensor) -> tb.Scene:
    """Seen from axes that turn with the speeds (...)."""
    section = tb.Section.from_stiffness(EA=1e6, GA=math.inf, GJ=math.inf, EI=1.0, mass=1.0)
    blades = {
        name: tb.Beam.straight(1.0, N, section, direction=(math.cos(a), math.sin(a), 0), order=2)
        for name, a in BLADES
    }
    shaft = tb.Hinge(None, "hub", axis=(0, 0, 1), stiffness=SHAFT)
    return tb.Scene(
        blades | {"hub": tb.Body(mass=0.1, inertia=HUB)},
        joints=[shaft, *(tb.Weld("hub", (name, 0)) for name in blades)],
        frame=tb.Frame(angular_velocity=torch.stack((0 * speed, 0 * speed, speed), -1)),
    )


def collective(near: float) -> float:
    """Frequency at rest: blades w = a (cos bx - cosh bx) + c sin bx + d sinh bx with free tips and
    the hub's balance (k - J b^4) w'(0) = 3 w''(0), between near and near + 1.
    """

    def determinant(b: float) -> float:
        hub = (SHAFT - HUB * b**4) * b
        cos, sin, cosh, sinh = math.cos(b), math.sin(b), math.cosh(b), math.sinh(b)
        rows = [[-cos - cosh, -sin, sinh], [sin - sinh, -cos, cosh], [6 * b**2, hub, hub]]
        return torch.linalg.det(torch.tensor(rows, dtype=torch.float64)).item()

    return brentq(determinant, near**0.5, (near + 1) ** 0.5) ** 2


scene = rotor(SPEED)
steady = tb.equilibrium(scene, engine="eager")
modes = tb.modes(scene, steady, count=12)
NAMES = ["lag, collective", *["lag, differential"] * 2, *["flap"] * 3] * 2
NAMES = [f"{name} {1 + k // 6}" for k, name in enumerate(NAMES)]

tips = torch.stack(
    [
        modes.shape[..., scene.beam.row((name, -1)), :2]
        @ torch.tensor([-math.sin(a), math.cos(a)], dtype=modes.shape.dtype)
        for name, a in BLADES
    ],
    -1,
)
share = tips.sum(-1).abs() ** 2 / (3 * (tips.abs() ** 2).sum(-1)).clamp(min=1e-30)
pure = max(
    max((1 - share[:, k]).max().item(), share[:, k + 1 : k + 3].max().item()) for k in (0, 6)
)
closed = torch.tensor([collective(2.0), collective(14.5)], dtype=torch.float64)
known = torch.stack([LAG, LAG, FLAP, FLAP, FLAP], -1)
errors = (
    modes.frequency[:, [1, 2, 3, 4, 5]] / known[:, 0] - 1,
    modes.frequency[:, [7, 8, 9, 10, 11]] / known[:, 1] - 1,
    modes.frequency[0, [0, 6]] / closed - 1,
)
off = [error.abs().max().item() for error in errors]
CHECK = max(*off, pure)
# the second bending on 5 elements; where blades stretch by W^2/3 1e-6, that is less
EXPECTED, TOLERANCE = 0.0, 1.2e-3

print("speed ", *(f"{name:>20}" for name in dict.fromkeys(NAMES)))
for speed, row in zip(SPEED.tolist(), modes.frequency.tolist(), strict=True):
    print(f"{speed:5.1f} ", *(f"{row[NAMES.index(name)]:20.3f}" for name in dict.fromkeys(NAMES)))
southwell = (modes.frequency[1] ** 2 - modes.frequency[0] ** 2) / SPEED[1] ** 2
print("     s", *(f"{southwell[NAMES.index(name)]:20.3f}" for name in dict.fromkeys(NAMES)))
print("first of a clamped blade within {:.1e}, second {:.1e}, collective {:.1e}".format(*off))


def draw(path: Path = options.picture) -> None:
    diagram, shapes = tb.plot.grid(1, 2, (11, 4.5))
    speeds = torch.linspace(0, 10, 21, dtype=torch.float64)
    first = tb.modes(rotor(speeds), count=7).frequency[:, [0, 1, 3, 6]]
    tb.plot.campbell(
        speeds, first, diagram, orders=(1, 2, 3), names=[NAMES[k] for k in (0, 1, 3, 6)]
    )
    diagram.plot(SPEED, known[:, 0, [0, 2]], "k.", ms=5)
    diagram.set(xlabel="speed / (EI/(m L^4))^1/2", ylabel="frequency / (EI/(m L^4))^1/2")
    turning = rotor(SPEED[3])
    state = tb.equilibrium(turning, engine="eager")
    tb.plot.mode_shapes(state, tb.modes(turning, state, count=2), shapes, plane="xy")
    shapes.legend(shapes.lines[-2:], NAMES[:2], frameon=False, fontsize=8)
    print("wrote", tb.plot.save(diagram, path))


if __name__ == "__main__":
    draw()
