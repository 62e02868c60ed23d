"""A wind blade's section of four lay-ups and two webs: its stiffness and its stresses.

The section is that of Chen, Yu and Capellaro (2010), "A critical assessment of computer tools for
calculating composite wind turbine blade properties", Wind Energy 13, computed there by VABS. Its
skins end in a sharp trailing edge. Lay-ups of 10 to 61 mm follow each other along the outline, and
their cores of balsa are 10^4 times softer than their faces. So it decides what touches what:
`join="depth"` lets each ply keep its depth. Where a lay-up is thicker than the next, its inner face
ends free there, as in the mesh of VABS. If each ply went over into the one of its number instead,
the cores would be one layer from edge to edge: the shear stiffness along the chord would be 68 %
too large. The check is the largest error of the diagonal, about the shear centre.
Run as a script, it also draws out/blade_section.png.
"""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

import torchbeam as tb

DATA = json.loads((Path(__file__).parents[1] / "studies/data/mh104_blade.json").read_text())
CHORD, ORIGIN = DATA["chord"], DATA["origin"]
NAMES = "E1", "E2", "E3", "G12", "G13", "G23", "nu12", "nu13", "nu23", "rho"
MATERIALS = {
    key: tb.Material(**dict(zip(NAMES, map(float, values), strict=True)))
    for key, values in DATA["materials"].items()
}
# the angle goes from x to the direction of a line, which is to the trailing edge below: VABS counts
# it the other way about
LAYUPS = {
    name: [(t * n, -math.radians(angle), MATERIALS[key]) for t, angle, key, n in layup]
    for name, layup in DATA["layups"].items()
}
WEB = sum(t for t, *_ in LAYUPS["web"]) / CHORD
STEP = 0.04  # between stations, of the root of the chord's share: fine at the leading edge


def shares(low: float, high: float) -> list[float]:
    """Of the chord, from `low` to before `high`; none between where a web covers the face."""
    web = any(x - 1.5 * WEB <= low and high <= x for x in DATA["webs"])
    n = 1 if web else math.ceil((high**0.5 - low**0.5) / STEP)
    return [(low**0.5 + (high**0.5 - low**0.5) * k / n) ** 2 for k in range(n)]


def side(name: str) -> list[torch.Tensor]:
    """Lines (n, 2) m of a side's parts, from the leading edge on."""
    outline = np.array(DATA["airfoil"])
    front = outline[:, 0].argmin()
    outline = outline[front::-1] if name == "upper" else outline[front:]
    feet = [x for web in DATA["webs"] for x in (web - 1.4 * WEB, web, web + 0.4 * WEB)]
    parts = []
    for a, b in pairwise([0.0, *DATA["divisions"][name], 1.0]):
        ends = [a, *(x for x in feet if a < x < b), b]
        x = np.array([share for ab in pairwise(ends) for share in shares(*ab)] + [b])
        z = np.interp(x, *outline.T)
        parts.append(torch.from_numpy(CHORD * np.stack((x - ORIGIN, z), -1)))
    return parts


def walls() -> list:
    """Round the section: nose, below to the trailing edge, back above; then the webs."""
    above, below = side("upper"), side("lower")
    skins = [
        (torch.cat((above[0].flip(0), below[0][1:])), LAYUPS["nose"]),
        (below[1], LAYUPS["front"]),
        (below[2], LAYUPS["spar"]),
        (torch.cat((below[3], above[3].flip(0)[1:])), LAYUPS["rear"]),
        (above[2].flip(0), LAYUPS["spar"]),
        (above[1].flip(0), LAYUPS["front"]),
    ]
    webs = []
    for web in DATA["webs"]:
        y = CHORD * (web - ORIGIN)
        ends = [line[(line[:, 0] - y).abs().argmin()] for line in (below[2], above[2])]
        webs.append((torch.stack(ends), LAYUPS["web"]))
    return skins + webs


def about_shear_centre(S: torch.Tensor) -> torch.Tensor:
    """A stiffness (6, 6) about there, of a compliance about the origin."""
    y, z = -S[3, 2] / S[3, 3], S[3, 1] / S[3, 3]
    return torch.linalg.inv(tb.Section(S, cross.mass).shifted(y, z).compliance)


cross = tb.CrossSection.thin_walled(walls(), line="first", join="depth")
K = about_shear_centre(cross.compliance)
PUBLISHED = torch.tensor(DATA["stiffness_chen"], dtype=torch.float64)
ANOTHER = torch.linalg.inv(torch.tensor(DATA["stiffness_prevabs"], dtype=torch.float64))
ANOTHER = about_shear_centre((ANOTHER + ANOTHER.T) / 2)
errors = K.diagonal() / PUBLISHED.diagonal() - 1
CHECK = errors.abs().max().item()
EXPECTED, TOLERANCE = 0.030, 0.002

ROWS = (
    ("EA", 0, 0), ("GA along the chord", 1, 1), ("GA across", 2, 2), ("GJ", 3, 3),
    ("EI flapwise", 4, 4), ("EI edgewise", 5, 5), ("extension-torsion", 0, 3),
)  # fmt: skip
print(f"{'':20} {'here':>10} {'published':>10} {'preVABS':>10}")
for label, i, j in ROWS:
    numbers = (x[i, j].item() for x in (K, PUBLISHED, ANOTHER))
    print(f"{label:20}", *(f"{x:10.3e}" for x in numbers))
print(f"mass {cross.mass[0, 0].item():.1f} kg/m, published {DATA['mass_chen']:.1f}")


def draw(path: Path = Path("out/blade_section.png")) -> None:
    """Elements, the stress along the fibres under a flapwise moment, the shear under torsion."""
    top, middle, bottom = tb.plot.grid(3, 1, (13, 9))
    tb.plot.cross_section(cross, top)
    tb.plot.cross_section(cross, middle, show="11", M=(0, -1e5, 0), axes="material")
    middle.set_title("stress along the fibres, flapwise moment of 100 kN m")
    tb.plot.cross_section(cross, bottom, show="12", M=(1e5, 0, 0), axes="material")
    bottom.set_title("shear stress in the plies, torsion of 100 kN m")
    print("wrote", tb.plot.save(top, path))


if __name__ == "__main__":
    draw()
