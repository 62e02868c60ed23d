"""A carbon box that twists as it bends: the ply angle of the strongest coupling, by gradient.

The fibres of the upper and the lower wall run at one angle to the beam, seen from above, and those
of the side walls along it. Such a box twists when a force bends it, as blades and wings do that
unload themselves in a gust. `tb.CrossSection.thin_walled` gives its compliance S with the
derivative by the angle, and Newton's method in the one angle finds where the coupling

    g = S_45 / sqrt(S_44 S_55)

of torsion and bending about y is largest; the range of a batch of angles shows it. A beam of that
section under a force F at its end then twists there by -S_45 F L^2/2: that closes the loop, and is
the check. Run as a script, it also draws out/composite_box.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

WIDTH, HEIGHT, WALL, LENGTH = 0.100, 0.040, 0.002, 2.0  # m
FORCE = 20.0  # N
CARBON = tb.Material(
    E1=142e9, E2=9.8e9, E3=9.8e9, G12=6.0e9, G13=6.0e9, G23=4.8e9, nu12=0.30, nu13=0.30,
    nu23=0.34, rho=1600.0,
)  # fmt: skip
CORNERS = torch.tensor([[-1.0, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], dtype=torch.float64)
LINE = CORNERS * torch.tensor([WIDTH - WALL, HEIGHT - WALL], dtype=torch.float64) / 2


def box(angle: torch.Tensor) -> tb.CrossSection:
    """Walls below, right, above and left; the line runs the other way above, and so does the
    angle.
    """
    along = torch.zeros_like(angle)
    angles = angle, along, -angle, along
    return tb.CrossSection.thin_walled(
        [(LINE[k : k + 2], [(WALL, angles[k], CARBON)]) for k in range(4)]
    )


def coupling(angle: torch.Tensor) -> torch.Tensor:
    S = box(angle).compliance
    return S[..., 3, 4] / (S[..., 3, 3] * S[..., 4, 4]).sqrt()


best = torch.tensor(math.radians(15.0), dtype=torch.float64)
for _ in range(5):
    best.requires_grad_()
    (slope,) = torch.autograd.grad(coupling(best), best, create_graph=True)
    (bend,) = torch.autograd.grad(slope, best)
    best = (best - slope / bend).detach()
angles = torch.deg2rad(torch.arange(0.0, 61.0, 5.0, dtype=torch.float64))
couplings = coupling(angles)

cross = box(best)
section = tb.Section.from_cross_section(cross)
beam = tb.Beam.straight(LENGTH, 8, section)
tip = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 0, FORCE))], small=True)).tip
twist = torch.atan2(tip.rotation[2, 1], tip.rotation[2, 2])
# the force bends by M2 = -F (L - x)
exact = -section.compliance[3, 4] * FORCE * LENGTH**2 / 2
CHECK = math.degrees(best.item())
EXPECTED, TOLERANCE = 19.59, 0.01

print(f"largest coupling {coupling(best).item():.3f} at {CHECK:.2f} degrees")
print(
    f"tip under {FORCE:.0f} N: {1e3 * tip.position[2].item():.2f} mm up, twist "
    f"{math.degrees(twist):.3f} degrees, by the section alone {math.degrees(exact):.3f}"
)


def draw(path: Path = Path("out/composite_box.png")) -> None:
    left, right = tb.plot.grid(1, 2, (11, 4.0))
    left.plot(torch.rad2deg(angles), couplings.detach(), "o-", label="coupling g")
    left.plot(CHECK, coupling(best).item(), "r*", ms=14, label=f"by gradient: {CHECK:.1f}°")
    left.set(xlabel="ply angle / degrees", ylabel="bend-twist coupling")
    left.legend(frameon=False)
    tb.plot.cross_section(cross, right, show="11", M=(0, 100.0, 0), axes="material")
    print("wrote", tb.plot.save(right, path))


if __name__ == "__main__":
    draw()
