"""Random structures, some on an obstacle and with a tendon, and the same said otherwise: turned, in
other units, in batches, restarted, with its beams cut and welded, and differentiated.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

JOINTS = ("weld", "ball", "hinge", "universal", "slider", "cylindrical")
STEPS = 2


@dataclass(frozen=True)
class Units:
    """By how much numbers of mass, length and time grow, and how vectors are turned (3, 3)."""

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0
    turn: Tensor = field(default_factory=lambda: torch.eye(3, dtype=torch.float64))

    def size(self, mass: int, length: int, time: int) -> float:
        return self.mass**mass * self.length**length * self.time**time

    def vector(self, v: Tensor, mass: int = 0, length: int = 1, time: int = 0) -> Tensor:
        return self.size(mass, length, time) * v @ self.turn.mT


@dataclass(frozen=True)
class Drawn:
    """What a structure is made of, and its numbers by name: tensors (...), with three at the end
    where they are vectors.
    """

    kinds: tuple[str, ...]  # "beam" or "body"
    joints: tuple[str, ...]  # between each and the one before; the first to the ground
    elements: tuple[int, ...]
    rod: bool  # from the last end to the ground
    order: int
    method: str
    obstacle: str  # on which its beams lie: "plane", "sphere" or "" = none
    tendon: str  # from the ground by the first end to the last: "pulled", "elastic" or "" = none
    numbers: dict[str, Tensor]


def draw(seed: int) -> Drawn:
    rng = random.Random(seed)
    count = rng.choice((1, 2, 2, 3))
    kinds = tuple(rng.choice(("beam", "beam", "body")) for _ in range(count))
    joints = ["weld" if kinds[0] == "beam" else "hinge", *rng.choices(JOINTS, k=count - 1)]
    if rng.random() < 0.3:
        joints[0] = rng.choice(("ball", "hinge", "free"))
    method = rng.choice(("midpoint", "midpoint", "generalized_alpha"))
    elements = tuple(rng.choice((1, 2)) for _ in kinds)
    rod, order = rng.random() < 0.3, rng.choice((1, 1, 2))
    obstacle = rng.choice(("", "plane", "sphere")) if "beam" in kinds else ""
    tendon = rng.choice(("", "pulled", "elastic"))
    drawn = Drawn(kinds, tuple(joints), elements, rod, order, method, obstacle, tendon, {})
    return replace(drawn, numbers=numbers(drawn, seed))


def numbers(drawn: Drawn, seed: int) -> dict[str, Tensor]:
    """Those of a structure of that kind."""
    rng = torch.Generator().manual_seed(seed)

    def some(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=rng, dtype=torch.float64)

    found = {"g": some(-5, 5, 3), "force": some(-0.3, 0.3, 3), "tau": some(0.001, 0.01)}
    for k in range(len(drawn.kinds)):
        found |= {
            f"way {k}": some(-0.4, 0.4, 3) + torch.eye(3, dtype=torch.float64)[k % 3],
            f"axis {k}": some(-1, 1, 3), f"EI {k}": some(0.5, 2.0), f"mass {k}": some(0.1, 0.4),
            f"stiffness {k}": some(0.5, 3.0), f"damping {k}": some(0.01, 0.1),
        }  # fmt: skip
    found["rod"] = some(0.3, 0.6, 3)
    found |= {"pull": some(0.2, 0.4), "arm": some(-0.02, 0.02, 3), "ground": some(-0.4, -0.2, 3)}
    found |= {"below": some(-0.1, 0.0, 3), "press": some(1.0, 2.0), "thickness": some(0.3, 0.4)}
    return found


def build(drawn: Drawn, units: Units | None = None, cut: bool = False) -> tb.Scene:
    """The scene, in these units; cut: its beams of two elements are two, welded."""
    units, n = units or Units(), drawn.numbers
    here = 0 * n["force"]
    parts: dict[str, Any] = {}
    joints: list[tb.Joint] = []
    supports: list[tb.Support] = []
    first: Any = None
    end: Any = None
    for k, (kind, joint) in enumerate(zip(drawn.kinds, drawn.joints, strict=True)):
        way, name = 0.5 * n[f"way {k}"], f"{kind} {k}"
        if kind == "beam":
            beams = _beams(drawn, k, name, here, way, units, cut)
            parts |= beams
            *halves, last = beams
            joints += [tb.Weld((half, -1), (last, 0)) for half in halves]
            start, tip = (name, 0), (last, -1)
        else:
            inertia = n[f"mass {k}"][..., None] * torch.tensor([0.02, 0.03, 0.04])
            parts[name] = tb.Body(
                units.size(1, 0, 0) * n[f"mass {k}"],
                units.size(1, 2, 0) * inertia,
                position=units.vector(here + way / 2),
                rotation=units.turn,
            )
            start = tip = name
        first = start if first is None else first
        if k == 0 and joint == "weld":
            supports.append(tb.Support(start))
        elif joint != "free":
            joints.append(_joint(joint, end, start, n, k, here, units, drawn.method))
        end, here = tip, here + way
    if drawn.rod and drawn.joints[0] != "free":
        joints.append(tb.Distance(end, None, at=units.vector(here + n["rod"])))
    effects = [
        tb.Gravity(units.vector(n["g"], 0, 1, -2)),
        tb.PointLoad(end, force=units.vector(n["force"], 1, 1, -2)),
    ]
    if "beam" in drawn.kinds:
        effects.append(tb.Damping(units.size(0, 0, 1) * n["tau"]))
    if drawn.obstacle:
        effects.append(_contact(drawn, units))
    if drawn.tendon:
        effects.append(_tendon(drawn, units, first, end))
    return tb.Scene(parts, effects, joints=joints, supports=supports)


def _contact(drawn: Drawn, units: Units) -> tb.Contact:
    """With what the beams start in; rubbing where steps take friction."""
    n, size = drawn.numbers, units.size
    up = torch.tensor([0.2, 0.4, 0.9], dtype=torch.float64)
    if drawn.obstacle == "plane":
        body: Any = tb.Plane(units.vector(n["below"]), units.turn @ up)
    else:
        radius = units.length * (0.5 + n["thickness"])
        centre = n["below"] - (0.5 + n["thickness"])[..., None] * up
        body = tb.Sphere(units.vector(centre), radius)
    rubs = drawn.method == "midpoint"
    slides = dict(friction=0.3, slip_speed=0.1 * size(0, 1, -1)) if rubs else {}
    press, thick = size(1, 0, -2) * n["press"], units.length * n["thickness"]
    return tb.Contact(body, thickness=thick, force=press, radius=0.01 * units.length, **slides)


def _tendon(drawn: Drawn, units: Units, first: Any, end: Any) -> tb.Tendon:
    n, size = drawn.numbers, units.size
    arm = units.length * n["arm"]
    eyelets = [(None, units.vector(n["ground"])), (first, arm), (end, -arm)]
    if drawn.tendon == "pulled":
        rubs = drawn.method == "midpoint"
        slides = dict(friction=0.2, slip_speed=0.1 * size(0, 1, -1)) if rubs else {}
        return tb.Tendon(eyelets, tension=size(1, 1, -2) * n["pull"], **slides)
    stiff, length = 5 * size(1, 0, -2) * n["pull"], units.length * n["pull"]
    return tb.Tendon(eyelets, stiffness=stiff, length=length)


def _beams(
    drawn: Drawn, k: int, name: str, root: Tensor, way: Tensor, units: Units, cut: bool
) -> dict[str, tb.Beam]:
    """One, or its halves."""
    n, count = drawn.numbers, drawn.elements[k]
    EI, mass = units.size(1, 3, -2) * n[f"EI {k}"], units.size(1, -1, 0) * n[f"mass {k}"]
    stiff = units.size(1, 1, -2) * n[f"EI {k}"]
    section = tb.Section.from_stiffness(
        EA=500 * stiff, GA=200 * stiff, GJ=0.7 * EI, EI=(EI, 1.4 * EI), mass=mass,
        inertia=1e-3 * units.length**2 * mass,
    )  # fmt: skip
    length = torch.linalg.vector_norm(way, dim=-1)
    up = torch.tensor([0.3, 0.5, 0.7], dtype=torch.float64) @ units.turn.mT
    shape = dict(direction=way @ units.turn.mT, up=up, order=drawn.order)

    def made(share: float, elements: int, at: Tensor) -> tb.Beam:
        return tb.Beam.straight(
            units.length * share * length, elements, section, root=units.vector(at), **shape
        )

    if not cut or count == 1:
        return {name: made(1.0, count, root)}
    return {name: made(0.5, 1, root), f"{name} more": made(0.5, 1, root + way / 2)}


def _joint(
    kind: str, a: Any, b: Any, n: dict[str, Tensor], k: int, at: Tensor, units: Units, method: str
) -> tb.Joint:
    axis, place = n[f"axis {k}"] @ units.turn.mT, units.vector(at)
    if kind == "weld":
        return tb.Weld(a, b)
    angle = kind != "slider"
    law = {"stiffness": units.size(1, 2 if angle else 0, -2) * n[f"stiffness {k}"]}
    if method == "midpoint":
        law["damping"] = units.size(1, 2 if angle else 0, -1) * n[f"damping {k}"]
    if kind == "ball":
        return tb.Ball(a, b, at=place, **law)
    if kind == "universal":
        pair = {name: torch.stack((value, 2 * value), -1) for name, value in law.items()}
        z = torch.tensor([0.2, 0.3, 0.9], dtype=torch.float64) @ units.turn.mT
        second = torch.linalg.cross(*torch.broadcast_tensors(axis, z))
        return tb.Universal(a, b, axis=axis, second=second, at=place, **pair)
    if kind == "cylindrical":
        return tb.Cylindrical(a, b, axis=axis)
    if angle:
        return tb.Hinge(a, b, axis=axis, at=place, **law)
    return tb.Slider(a, b, axis=axis, **law)


def run(
    scene: tb.Scene,
    drawn: Drawn,
    units: Units | None = None,
    restart: bool = False,
    engine: str = "eager",
) -> Any:
    """The state after some steps."""
    dt = 0.02 * (units or Units()).time
    made = dict(method=drawn.method, tolerance=1e-13, engine=engine)
    stepper, state = tb.Stepper(scene, dt, **made), tb.rest(scene)
    for k in range(STEPS):
        if restart and k == STEPS - 1:
            stepper = tb.Stepper(scene, dt, **made)
        state = stepper(state)
    assert not state.status.any()
    return state


def distances(seed: int) -> dict[str, float]:
    """Of a random structure, how far what each relation says is from what it is to be."""
    drawn = draw(seed)
    plain = run(build(drawn), drawn)
    found = {"restart": _off(run(build(drawn), drawn, restart=True).nodes, plain.nodes)}
    turn = torch.linalg.matrix_exp(
        torch.tensor([[0, -0.4, 0.9], [0.4, 0, -0.7], [-0.9, 0.7, 0]], dtype=torch.float64)
    )
    for name, units in {"turned": Units(turn=turn), "units": Units(1e3, 50.0, 0.1)}.items():
        state = run(build(drawn, units), drawn, units)
        found[name] = _off(state.nodes @ units.turn / units.length, plain.nodes)
        forces, wanted = (
            torch.cat([x.reaction[..., :3], *(j.force[..., None, :] for j in x.joint)], -2)
            for x in (state, plain)
        )
        if wanted.numel():
            forces = forces @ units.turn / units.size(1, 1, -2)
            found[f"forces {name}"] = _off(forces, wanted)
    other = replace(drawn, numbers=numbers(drawn, seed + 1_000_000))
    both = {k: torch.stack((v, other.numbers[k])) for k, v in drawn.numbers.items()}
    batch = run(build(replace(drawn, numbers=both)), drawn)
    found["batch"] = max(
        _off(batch.nodes[0], plain.nodes), _off(batch.nodes[1], run(build(other), drawn).nodes)
    )
    if "beam" in drawn.kinds and 2 in drawn.elements:
        last = f"{drawn.kinds[-1]} {len(drawn.kinds) - 1}"
        cut = run(build(drawn, cut=True), drawn)
        more = f"{last} more"
        name = more if more in [part.name for part in cut.parts] else last
        found["cut"] = _off(_end(cut, name), _end(plain, last))
    return found | {"gradient": gradient(drawn)}


def engine_distances(seed: int) -> dict[str, float]:
    """What native steps of a random structure differ by from eager ones, of the largest."""
    drawn = draw(seed)
    native, eager = (run(build(drawn), drawn, engine=engine) for engine in ("compiled", "eager"))
    names = "position", "rotation", "velocity", "spin", "stress", "reaction", "joints"
    pairs = {name: (getattr(native, name), getattr(eager, name)) for name in names}
    return {
        name: float((a - b).abs().max() / b.abs().max().clamp(min=1.0))
        for name, (a, b) in pairs.items()
        if b is not None and b.numel()
    }


def gradient(drawn: Drawn) -> float:
    """Of a reading by all numbers along one direction, beside a difference."""
    rng = torch.Generator().manual_seed(1)
    way = {
        k: torch.rand(v.shape, generator=rng, dtype=torch.float64) - 0.5
        for k, v in drawn.numbers.items()
    }

    def read(values: dict[str, Tensor]) -> Tensor:
        state = run(build(replace(drawn, numbers=values)), drawn)
        return state.nodes[-1].sum() + sum(0.1 * joint.force.sum() for joint in state.joint)

    traced = {k: v.clone().requires_grad_() for k, v in drawn.numbers.items()}
    slopes = torch.autograd.grad(
        read(traced), list(traced.values()), allow_unused=True, materialize_grads=True
    )
    slope = sum((s * way[k]).sum() for k, s in zip(traced, slopes, strict=True))
    e = 1e-5
    more, less = (
        read({k: v + sign * e * way[k] for k, v in drawn.numbers.items()}) for sign in (1, -1)
    )
    return _off(slope, (more - less) / (2 * e))


def _end(state: Any, name: str) -> Tensor:
    part = state[name]
    return part.tip.position if hasattr(part, "tip") else part.position


def _off(a: Tensor, b: Tensor) -> float:
    return float((a - b).detach().abs().max() / (1e-2 + b.detach().abs().max()))
