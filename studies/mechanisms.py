"""Two mechanisms that other programs are compared on, with their published trajectories: a flexible
four-bar linkage, a closed loop of hinges in a plane, and a hand of three jointed fingers, a tree in
space.
"""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend.commands import write as write_file

from .common_case import difference as error
from .harness import data

FILE = "mechanism_references"
NAMES = ("four-bar", "hand")
SPACES = {"four-bar": "plane", "hand": "3D"}
INTERVALS, DURATION = 100, 1.0  # instants at which places are compared; s
FINE = {"four-bar": (16, 10_000), "hand": (8, 4_000)}  # elements a beam, steps, of the references
ABOUT = (
    "Places (time, point, 3) m of the mechanisms' ends, by beams of order 2, extrapolated in steps "
    "and compared with half as many elements. SI units. Sections are round in stiffness, GJ = EI. "
    "`python -m studies.mechanisms FILE` writes this file."
)
NUMBERS: dict[str, Any] = {
    "EA": 4e4, "GA": 1.5e4, "EI": 0.2, "mass": 0.2, "inertia": 5e-6,  # GJ = EI
    "damping": 5e-3,  # s, of all strain rates of the linkage
    "gravity": 9.81,  # along -y of the linkage, along -z of the hand
    "linkage": [[0.0, 0.0], [-0.3, -0.4], [0.25, -0.2], [0.6, 0.0]],  # m: pins, the ends on ground
    "palm": {"mass": 0.2, "inertia": 2e-3, "radius": 0.04, "torque": 0.3},  # hinged about y
    "fingers": {"count": 3, "spread": 0.5, "phalanx": 0.2},  # rad from -z, m
    "knuckle": {"stiffness": 0.5, "damping": 2e-3},
}  # fmt: skip


class Reference(NamedTuple):
    """Places (time, point, 3) m, and how far two meshes are apart in them, relative."""

    places: Tensor
    agreement: float


def load() -> dict[str, Reference]:
    known = data(FILE)["references"]
    return {
        name: Reference(torch.tensor(one["places"], dtype=torch.float64), one["agreement"])
        for name, one in known.items()
    }


def instants(intervals: int = INTERVALS) -> Tensor:
    return torch.linspace(0, DURATION, intervals + 1, dtype=torch.float64)


def scene(name: str, elements: int, order: int) -> tb.Scene:
    """One of `NAMES`; elements of each beam."""
    return {"four-bar": linkage, "hand": hand}[name](elements, order)


def linkage(elements: int, order: int) -> tb.Scene:
    """It is let go at rest: three beams between four pins, of which the first and the last are on
    the ground.
    """
    pins = [(*pin, 0.0) for pin in NUMBERS["linkage"]]
    bars = [_beam(a, b, (0, 0, 1), elements, order) for a, b in pairwise(pins)]
    joined = [(None, ("0", 0)), (("0", -1), ("1", 0)), (("1", -1), ("2", 0)), (None, ("2", -1))]
    joints = [tb.Hinge(*pair, axis=(0, 0, 1)) for pair in joined]
    acts = [tb.Gravity((0, -NUMBERS["gravity"], 0)), tb.Damping(NUMBERS["damping"])]
    return tb.Scene({f"{k}": bar for k, bar in enumerate(bars)}, acts, joints=joints, plane="xy")


def hand(elements: int, order: int) -> tb.Scene:
    """It is let go at rest, and a constant torque turns its palm about y; its beams are undamped,
    for not every program damps strain rates in space.
    """
    palm, fingers = NUMBERS["palm"], NUMBERS["fingers"]
    parts: dict[str, Any] = {"palm": tb.Body(mass=palm["mass"], inertia=palm["inertia"])}
    joints = []
    for k in range(fingers["count"]):
        outward, along, axis = finger(k)
        places = [palm["radius"] * outward + s * fingers["phalanx"] * along for s in range(3)]
        for part, root, end in zip("ab", places[:2], places[1:], strict=True):
            parts[f"{part}{k}"] = _beam(root, end, axis, elements, order)
        joints += [
            tb.Weld("palm", (f"a{k}", 0)),
            tb.Hinge((f"a{k}", -1), (f"b{k}", 0), axis, **NUMBERS["knuckle"]),
        ]
    acts = [
        tb.Gravity((0, 0, -NUMBERS["gravity"])),
        tb.PointLoad("palm", moment=(0, palm["torque"], 0)),
    ]
    return tb.Scene(parts, acts, joints=joints, supports=[tb.Support("palm", rotation="xz")])


def finger(k: int) -> tuple[Tensor, Tensor, Tensor]:
    """Of a finger: outward from the palm's axis, along it, and the axis of its knuckle (3,)."""
    fingers = NUMBERS["fingers"]
    turn, spread = 2 * math.pi * k / fingers["count"], fingers["spread"]
    up, number = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), torch.float64
    outward = torch.tensor([math.cos(turn), math.sin(turn), 0.0], dtype=number)
    along = math.sin(spread) * outward - math.cos(spread) * up
    return outward, along, torch.linalg.cross(up, outward)


def _beam(root: Any, end: Any, up: Any, elements: int, order: int) -> tb.Beam:
    root, end = (torch.as_tensor(x, dtype=torch.float64) for x in (root, end))
    stiffness = {name: NUMBERS[name] for name in ("EA", "GA", "EI", "mass", "inertia")}
    values = {name: root.new_tensor(value) for name, value in stiffness.items()}
    section = tb.Section.from_stiffness(**values, GJ=values["EI"])
    along = end - root
    return tb.Beam.straight(
        torch.linalg.vector_norm(along), elements, section, along, up, root, order=order
    )


def places(name: str, solution: tb.Solution) -> Tensor:
    """(time, point, 3) m of the two moving pins, or of the fingers' tips."""
    if name == "four-bar":
        return torch.stack([solution[part].nodes[..., -1, :] for part in "01"], -2)
    return torch.stack(
        [solution[f"b{k}"].nodes[..., -1, :] for k in range(NUMBERS["fingers"]["count"])], -2
    )


def motion(
    name: str, elements: int, order: int, steps: int, intervals: int = INTERVALS, **options: Any
) -> tb.Solution:
    with torch.no_grad():
        t = instants(intervals)
        return tb.simulate(scene(name, elements, order), t, step=DURATION / steps, **options)


def _fine(name: str, elements: int, steps: int) -> Tensor:
    """Extrapolated in steps, whose error is of second order."""
    coarse, fine = (
        places(name, motion(name, elements, 2, n, throw=True)) for n in (steps // 2, steps)
    )
    return fine + (fine - coarse) / 3


def write(path: Path) -> None:
    """The file of references, made anew: some minutes."""
    references = {}
    for name, (elements, steps) in FINE.items():
        fine = _fine(name, elements, steps)
        agreement = error(_fine(name, elements // 2, steps // 2), fine)
        rounded = [[[round(x, 9) for x in point] for point in row] for row in fine.tolist()]
        references[name] = {"agreement": agreement, "places": rounded}
        print(f"{name}: agree to {agreement:.1e}", flush=True)
    content = {"about": ABOUT, "duration": DURATION, **NUMBERS, "references": references}
    write_file(path, json.dumps(content, separators=(",", ":")).replace("]],", "]],\n") + "\n")


if __name__ == "__main__":
    import sys

    write(Path(sys.argv[1]))
