"""A helical spring: a steel wire that is a helix at rest, pulled along the helix' axis far beyond
small displacements.

`tb.Beam.curve` makes the helix of its constant curvature and twist rate, nodes exactly on it. Under
a small force along the axis the stress is the same in every section, and energy gives the
compliance (Love 1927, art. 271, and shear and extension):

    extension / force = R^2 l (cos^2 a / GJ + sin^2 a / EI) + l (cos^2 a / kGA + sin^2 a / EA)

with R the radius, l the length of the wire and a the angle of its pitch.

The force acts through the axis, on an arm that the end of the wire holds: a force and a moment on
the last node, and the extension is that of the arm's end. Run as a script, it also draws
out/spring.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

RADIUS, WIRE, TURNS, PITCH = 0.02, 0.0015, 5, 0.010  # m: of the coil, of the wire; m a turn
EACH = 24  # elements a turn
FORCES = torch.tensor([0.0, 20, 40, 60, 80], dtype=torch.float64)  # N

angle = math.atan2(PITCH, 2 * math.pi * RADIUS)
length = TURNS * math.hypot(PITCH, 2 * math.pi * RADIUS)
bend, twist = math.cos(angle) ** 2 / RADIUS, math.sin(angle) * math.cos(angle) / RADIUS
section = tb.Section.circle(WIRE, E=206e9, nu=0.3, rho=7850.0)
# at its root a helix about z runs at the angle of its pitch above the horizontal, and turns about
# its binormal
start, binormal = (math.cos(angle), 0.0, math.sin(angle)), (-math.sin(angle), 0.0, math.cos(angle))
spring = tb.Beam.curve(
    length, TURNS * EACH, section, (twist, 0.0, bend), direction=start, up=binormal
)
# from the last node to the axis
ARM = torch.tensor([0.0, RADIUS, 0.0], dtype=torch.float64) - spring.nodes[-1] * torch.tensor(
    [1.0, 1, 0], dtype=torch.float64
)


def pulled(force: torch.Tensor) -> tb.State:
    """Equilibria under forces (batch,) along z through the axis. The moment is that of the arm at
    rest.
    """
    force = force[:, None] * torch.tensor([0.0, 0, 1], dtype=torch.float64)
    moment = torch.linalg.cross(ARM.expand_as(force), force)
    return tb.equilibrium(tb.Scene(spring, [tb.TipLoad(force=force, moment=moment)]))


def extension(state: tb.State) -> torch.Tensor:
    """Of the arm's end along z (batch,) m."""
    rest = tb.rest(tb.Scene(spring))
    tip, turn = tb.sensors.TipPosition(reference=rest)(state), tb.sensors.NodeRotation(-1)(state)
    arm = turn @ (tb.sensors.NodeRotation(-1)(rest).mT @ ARM)
    return (tip + arm - ARM)[..., 2]


small = torch.tensor([1e-3], dtype=torch.float64)
found = (extension(pulled(small)) / small).item()
EA, kGA, GJ, EI = (1 / section.compliance.diagonal()[[0, 2, 3, 4]]).tolist()
c2, s2 = math.cos(angle) ** 2, math.sin(angle) ** 2
exact = length * (RADIUS**2 * (c2 / GJ + s2 / EI) + c2 / kGA + s2 / EA)
CHECK = found / exact - 1
# of 24 elements a turn; 12 and 48: four times and a quarter of it
EXPECTED, TOLERANCE = -0.0057, 3e-4

states = pulled(FORCES)
stretch = extension(states)
print(f"compliance {1e3 * found:.4f} mm/N; theory {1e3 * exact:.4f} mm/N: {100 * CHECK:+.2f} %")
for f, s in zip(FORCES.tolist(), stretch.tolist(), strict=True):
    print(f"{f:5.0f} N  {1e3 * s:7.2f} mm  ({1e3 * exact * f:7.2f} mm, linear)")


def draw(path: Path = Path("out/spring.png")) -> None:
    left, right = tb.plot.grid(1, 2, (11, 4.6), three=[0])
    tb.plot.shape(states[::2], left, nodes=False)
    right.plot(1e3 * stretch, FORCES, "o-", label="beam")
    right.plot(1e3 * exact * FORCES, FORCES, "k--", lw=1, label="small displacements")
    right.set(xlabel="extension / mm", ylabel="force / N")
    right.legend(frameon=False)
    print("wrote", tb.plot.save(right, path))


if __name__ == "__main__":
    draw()
