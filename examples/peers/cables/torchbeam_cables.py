"""The cases of Newton's own checks of its cables by torchbeam: the same measures, rows as those of
`newton_cables.py`, which this reads to set both side by side:

    python newton_cables.py > newton.jsonl
    python torchbeam_cables.py newton.jsonl --out docs/results/cables
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend.commands import measured_on, sentence, table, versions, write_results

TARGETS = (30.0, 60.0, 90.0)  # degrees
# Of 14 links of 0.1 m the first and the last are held: a beam of 1.3 m between their middles
HELD, ELEMENTS = 1.3, 13
BEND, TWIST = (40.0, 100.0), (200.0, 12.0)  # EI, GJ N m^2: the joints' stiffness times 0.1 m
# Of 64 links of 75 mm the first and the last are held: 62 are free
LINK, LINKS, TURNS = 0.075, 62, 9.0
ROPE = {"EI": 3.0, "GJ": 3.75, "EA": 7.5e3, "GA": 7.5e3}  # N m^2, N
RADIUS, DENSITY = 0.014, 1000.0
SETTLE, RAMP, HOLD = 1.5, 5.0, 4.0  # s


def row(case: str, measure: str, value: float, cpu: float) -> dict:
    peer = f"torchbeam {versions('torchbeam')['torchbeam']}"
    return {"peer": peer, "case": case, "measure": measure, "value": float(value), "cpu_s": cpu}


def section(EI: float, GJ: float, EA: float, GA: float, radius: float) -> tb.Section:
    mass = DENSITY * math.pi * radius**2
    return tb.Section.from_stiffness(
        EA=EA, GA=GA, GJ=GJ, EI=EI, mass=mass, inertia=mass * radius**2 / 4
    )


def held(kind: str, exact: bool = False) -> Iterator[dict]:
    """Of a beam between a held root and a held end, which is turned and moved, at rest: three
    ends are a batch. The end turns about the beam, or lies where nodes of a constant curvature do:
    on the polygon of links of equal length, as theirs, or (exact) on the arc of a beam, of which
    elements of order 2 are made.
    """
    angle = torch.tensor(TARGETS, dtype=torch.float64).deg2rad()[:, None]
    EI, GJ = BEND if kind == "bend" else TWIST
    order = 2 if exact else 1
    strip = section(EI, GJ, 1e5, 1e5, 0.01)
    beam = tb.Beam.straight(HELD, ELEMENTS // order, strip, order=order)
    share = torch.linspace(0, 1, beam.node_count, dtype=torch.float64)

    def arc(angle: Tensor) -> Tensor:
        """(3, n, 3) m"""
        a, r = share * angle, HELD / angle
        if not exact:  # with links for chords
            r = r * (angle / 2 / ELEMENTS) / (angle / 2 / ELEMENTS).sin()
        return torch.stack((r * a.sin(), 0 * a, r * (a.cos() - 1)), -1)

    start, state = time.process_time(), None
    for part in torch.linspace(0.25, 1, 4, dtype=torch.float64):
        a = part * angle
        turn = torch.cat((a, 0 * a, 0 * a) if kind == "twist" else (0 * a, a, 0 * a), -1)
        place = (arc(a) - beam.nodes)[:, -1] if kind == "bend" else None
        ends = [tb.Support(0), tb.Support(-1, displacement=place, turn=turn)]
        state = tb.equilibrium(tb.Scene(beam, supports=ends), initial=state)
    cpu = time.process_time() - start
    turned = quat.logarithm(state.rotation)[..., 1 if kind == "bend" else 0]
    off, away = (turned - share * angle).rad2deg(), state.position - arc(angle)
    for k, degrees in enumerate(TARGETS):
        name = f"{kind} by {degrees:.0f} degrees"
        shape = away[k].square().sum(-1).mean().sqrt() / HELD
        if exact:
            yield row(name, "shape off a beam's arc, L RMS", shape, cpu)
            continue
        yield row(name, "end, degrees", off[k, -1].abs(), cpu)
        yield row(name, "rotation, degrees RMS", off[k].square().mean().sqrt(), cpu)
        if kind == "bend":
            yield row(name, "shape, L RMS", shape, cpu)
        else:
            yield row(name, "across, L", state.position[k, :, 1:].norm(dim=-1).max() / HELD, cpu)


def link() -> Iterator[dict]:
    """Of a cable between two fixed places whose end turns nine times about it: the twist of the
    frames of its links and the writhe of these (Klenin and Langowski 2000) are the turns.
    """
    beam = tb.Beam.straight(
        LINK * LINKS, LINKS, section(radius=RADIUS, **ROPE), root=(LINK, 0, 0.75)
    )

    def turn(t: Tensor) -> Tensor:
        x = ((t - SETTLE) / RAMP).clamp(0, 1)
        angle = 2 * math.pi * TURNS * x * x * (3 - 2 * x)
        return torch.stack((angle, 0 * angle, 0 * angle), -1)

    ends = [tb.Support(0), tb.Support(-1, turn=turn)]
    effects = [tb.Gravity((0, 0, -9.81)), tb.Damping(1e-3)]
    scene = tb.Scene(beam, effects, supports=ends)
    seed = torch.zeros(beam.node_count, 3, dtype=torch.float64)
    seed[LINKS // 2, 1] = 5e-4  # m, so that it leaves its plane
    t = torch.linspace(0, SETTLE + RAMP + HOLD, 64, dtype=torch.float64)
    start = time.process_time()
    state = tb.State.from_nodes(scene, beam.nodes + seed)
    solution = tb.simulate(scene, t, state, step=1 / 360)
    cpu = time.process_time() - start
    last = solution.state[-1]
    assert (solution.status == 0).all()
    points, R = last.position, quat.matrix(last.rotation)
    ahead = torch.tensor([LINK, 0.0, 0.0], dtype=torch.float64)
    points = torch.cat((points[:1] - ahead, points, points[-1:] + ahead))
    middle = quat.half_way(last.rotation[:-1], last.rotation[1:])
    frames = torch.cat((R[:1], quat.matrix(middle), R[-1:]))
    twist, writhe = twist_of(points, frames), writhe_of(points)
    name = f"{TURNS:.0f} turns of an end"
    yield row(name, "link, turns", abs(TURNS - twist - writhe), cpu)
    yield row(name, "least distance, diameters", nearest(points) / (2 * RADIUS), cpu)


def twist_of(points: Tensor, frames: Tensor) -> float:
    """Turns of frames (n, 3, 3) about the links between points (n + 1, 3), from each to the next,
    transported along.
    """
    t = torch.nn.functional.normalize(points.diff(dim=0), dim=-1)
    m = frames[..., 1]
    m = torch.nn.functional.normalize(m - (m * t).sum(-1, keepdim=True) * t, dim=-1)
    a, b = t[:-1], t[1:]
    carried = m[:-1] - ((m[:-1] * b).sum(-1) / (1 + (a * b).sum(-1)))[:, None] * (a + b)
    sine = (b * torch.linalg.cross(carried, m[1:])).sum(-1)
    return torch.atan2(sine, (carried * m[1:]).sum(-1)).sum().item() / (2 * math.pi)


def writhe_of(points: Tensor) -> float:
    """Turns of a polygon (n, 3): the solid angles of its pairs of sides (Klenin and Langowski 2000,
    equations 15 to 16).
    """
    i, j = torch.tensor([k for k in combinations(range(len(points) - 1), 2) if k[1] > k[0] + 1]).T
    a, b, c, d = points[i], points[i + 1], points[j], points[j + 1]
    sides = (c - a, d - a, d - b, c - b)
    n = [torch.linalg.cross(sides[k], sides[(k + 1) % 4]) for k in range(4)]
    n = [torch.nn.functional.normalize(x, dim=-1) for x in n]
    angle = sum((n[k] * n[(k + 1) % 4]).sum(-1).clamp(-1, 1).asin() for k in range(4))
    sense = (torch.linalg.cross(d - c, b - a) * (c - a)).sum(-1).sign()
    return (sense * angle).sum().item() / (2 * math.pi)


def nearest(points: Tensor, apart: int = 3) -> float:
    """m, between links that are at least so many apart: of 33 places of each."""
    share = torch.linspace(0, 1, 33, dtype=torch.float64)[:, None, None]
    places = torch.lerp(points[:-1], points[1:], share)
    distance = torch.cdist(places.flatten(0, 1), places.flatten(0, 1))
    n = len(points) - 1
    each = distance.reshape(33, n, 33, n).amin((0, 2))
    far = torch.arange(n) - torch.arange(n)[:, None] >= apart
    return each[far].min().item()


HEAD = ("case", "measure", "its bound", "newton", "torchbeam", "CPU s: newton", "torchbeam")


def lines(rows: list[dict], theirs: list[dict]) -> list[tuple[str, ...]]:
    """The largest of each measure of each kind of case, and what they took."""
    kinds: dict[tuple[str, str], tuple[list[dict], list[dict]]] = {}
    for k, some in enumerate((rows, theirs)):
        for r in some:
            kind = (r["case"].split(" by ")[0], r["measure"])
            kinds.setdefault(kind, ([], []))[k].append(r)

    def worst(some: list[dict], name: str, least: bool) -> str:
        values = [r[name] for r in some if r.get(name) is not None]
        return f"{(min if least else max)(values):.2g}" if values else ""

    cells = []
    for (kind, measure), (own, other) in kinds.items():
        least = measure.startswith("least")
        numbers = [worst(other, "bound", least), worst(other, "value", least)]
        numbers += [worst(own, "value", least), worst(other, "cpu_s", False)]
        cells.append((kind, measure, *numbers, worst(own, "cpu_s", False)))
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("newton", type=Path, nargs="?", help="rows of newton_cables.py")
    parser.add_argument("--out", type=Path, help="folder for the table")
    options = parser.parse_args()
    rows = [*held("bend"), *held("bend", exact=True), *held("twist"), *link()]
    if options.newton is None:
        for printed in rows:
            print(json.dumps(printed))
        return
    printed = options.newton.read_text().splitlines()
    theirs = [json.loads(line) for line in printed if line.startswith("{")]
    cells = lines(rows, theirs)
    heading = measured_on()
    heading["versions"] |= {"newton": theirs[0]["peer"].split()[-1]}
    text = f"{table(HEAD, cells, 2)}\n\n{sentence(heading)}"
    print(text)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        write_results(options.out, "cables", text, {**heading, "rows": rows + theirs}, HEAD, cells)


if __name__ == "__main__":
    main()
