"""Random cases: sections, shapes at rest, loads of every effect, supports, frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import effects as fx
from .rod import Case, Rod, Support, Value
from .rotations import Array, exponential, skew

SUPPORTS = (
    "clamp", "elastic clamp", "clamp and pin", "hinge and pin", "clamp and slide",
    "two clamps, moved", "clamp, moved",
)  # fmt: skip
SHAPES = ("straight", "arc", "helix", "pretwisted")
SECTIONS = ("plain", "coupled", "rotated", "rigid", "tapered")
FORGETS = 6  # cases from one to the next with arms that forget
RIGID = ((1, 2), (0, 1, 2), (0,), (3,))
# axes and strains in it
PLANES = {
    "xy": (np.array((1.0, 1.0, 0.0)), (0, 1, 5)),
    "xz": (np.array((1.0, 0.0, 1.0)), (0, 2, 4)),
}


@dataclass(frozen=True)
class Draw:
    """Random numbers. Where there is a plane, vectors lie in it and moments are across."""

    random: np.random.Generator
    plane: str | None = None

    def __call__(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        return float(np.exp(self.random.uniform(np.log(low), np.log(high))))

    def one(self, *options: Any) -> Any:
        return options[int(self.random.integers(len(options)))]

    def chance(self, share: float) -> bool:
        return bool(self.random.uniform() < share)

    def vector(self, size: float, across: bool = False) -> Array:
        """(3,) of a length, to any side of the plane; across: a moment, or an axis of turning."""
        x = self.random.normal(size=3)
        if self.plane is not None:
            keep = PLANES[self.plane][0]
            x = x * (1 - keep if across else keep)
        return size * x / np.linalg.norm(x)


def section(draw: Draw, kind: str, L: float) -> tuple[Array, float, Array, Array]:
    """Compliance, mass per length, centre and inertia about the axis of a section with bending
    stiffnesses near 1 N m^2.
    """
    EI = np.array((draw(0.5, 1.5), draw(0.6, 1.2), draw(0.7, 2.0)))  # GJ, EI_y, EI_z
    K = np.diag([*(draw.log(50, 2000) / L**2 * np.array((1.0, 0.3, 0.5))), *EI])
    mass, centre = draw(0.2, 1.0), np.zeros(3)
    i_y, i_z = mass * (draw(0.005, 0.04) * L) ** 2, mass * (draw(0.005, 0.04) * L) ** 2
    J = np.diag((i_y + i_z, i_y, i_z))
    if kind == "coupled":
        within = range(6) if draw.plane is None else PLANES[draw.plane][1]
        mixed = np.eye(6)
        for i in within:
            for j in within:
                if i < j:
                    mixed[i, j] = mixed[j, i] = draw(-0.15, 0.15)
        half = np.sqrt(K)
        K = half @ mixed @ half
        centre = draw.vector(0.03 * L) * (0, 1, 1)
    if kind == "rotated" and draw.plane is None:
        turned = exponential(np.array((draw(-1.5, 1.5), 0.0, 0.0)))
        both = np.kron(np.eye(2), turned)
        K, J = both @ K @ both.T, turned @ J @ turned.T
    S, lost = np.zeros((6, 6)), draw.one(*RIGID) if kind == "rigid" else ()
    flexible = [i for i in range(6) if i not in lost]
    S[np.ix_(flexible, flexible)] = np.linalg.inv(K[np.ix_(flexible, flexible)])
    return (S + S.T) / 2, mass, centre, J - mass * skew(centre) @ skew(centre)


def rod(draw: Draw, shape: str, kind: str) -> Rod:
    """A rod of 0.5 to 2 m."""
    L = draw(0.5, 2.0)
    S, mass, centre, inertia = section(draw, kind, L)
    axes = np.eye(3) if draw.plane is not None else exponential(draw.vector(draw(0.0, 3.0)))
    root = draw.vector(draw(0.0, 1.0))
    across = np.array((0.0, 1.0, 0.0)) if draw.plane == "xz" else np.array((0.0, 0.0, 1.0))
    curvature = {
        "straight": np.zeros(3),
        "arc": across * draw(0.5, 2.0) / L,
        "helix": draw.vector(draw(0.5, 2.5) / L, across=True),
        "pretwisted": np.array((draw(0.4, 2.0), 0, 0)) / L,
    }[shape]
    return Rod(
        L, root, axes, curvature, S, mass, centre, inertia,
        draw(0.2, 0.5) if kind == "tapered" else 0.0,
    )  # fmt: skip


def effect(draw: Draw, name: str, rod: Rod, force: float, moving: bool) -> Any:
    """An effect by name, that bends a rod of EI/L^2 = force much; one that changes in time where it
    is moving.
    """
    L, at = rod.length, draw.one(0.25, 0.5, 0.75)
    # sqrt(EI/(m L^4)), a third of the first frequency
    rate = np.sqrt(force / rod.mass) / L if moving else None

    def value(size: float, across: bool = False, along: bool = False) -> Value:
        frequency = rate * draw(1.0, 5.0) if moving else None
        return Value(
            draw.vector(draw(0.3, 1.0) * size, across), draw(-1.5, 1.5) if along else 0.0, frequency
        )

    def given(scale: float, along: bool = False) -> dict[str, Any]:
        which = draw.one("force", "moment", "both")
        return dict(
            force=None if which == "moment" else value(scale * force, along=along),
            moment=None if which == "force" else value(scale * force * L, True, along),
            follower=draw.chance(0.5),
        )

    def inertia(mass: float) -> Array:
        turned = np.eye(3) if draw.plane is not None else exponential(draw.vector(1.0))
        return turned @ np.diag(mass * (0.05 * L) ** 2 * np.array((1.0, 0.8, 0.5))) @ turned.T

    free = rod.rest(np.array(at))[0]
    body = draw(0.05, 0.4) * rod.mass * L
    speed = np.sqrt(force / rod.mass)
    # fmt: off
    make = {
        "LineLoad": lambda: fx.LineLoad(**{k: v if k == "follower" or v is None
                                           else Value(v.vector / L, v.along, v.frequency)
                                           for k, v in given(1.0, draw.chance(0.5)).items()}),
        "PointLoad": lambda: fx.PointLoad(**given(1.5), at=at),
        "TipLoad": lambda: fx.TipLoad(**given(0.8)),
        "Gravity": lambda: fx.Gravity(draw.vector(draw(0.3, 2.0) * force / (rod.mass * L))),
        "MassDamping": lambda: fx.MassDamping(draw(0.2, 2.0)),
        "Drag": lambda: fx.Drag(draw(0.3, 1.0) * force / L / speed**2 / 0.1, 0.1, draw(0.5, 1.5),
                                draw(0.0, 0.1),
                                draw.vector(speed),
                                draw.one(0.0, draw(0.1, 1.0) * rod.mass / (force / speed**2))),
        "StripAir": lambda: fx.StripAir(draw(0.1, 0.4) * force / L**2 / speed**2, 0.2 * L,
                                        draw(0.1, 0.6), draw(4.0, 7.0), draw.vector(speed),
                                        draw.chance(0.5)),
        "PointMass": lambda: fx.PointMass(body, inertia(body), draw.vector(0.1 * L),
                                          draw.one(at, 1.0)),
        "Spring": lambda: fx.Spring(draw(0.5, 3.0) * force / L,
                                    free + draw.vector(draw(0.2, 0.6) * L),
                                    draw.one(None, draw(0.1, 0.4) * L),
                                    draw.one(0.0, draw(0.02, 0.1) * np.sqrt(force * rod.mass)), at),
        "RootSpring": lambda: fx.RootSpring(
            np.array([draw(20, 80) * force / L for _ in range(3)] + [draw(3,
                10) * force * L for _ in range(3)]),
            np.array([draw(0, 0.05) for _ in range(3)] + [draw(0,
                0.05) * L**2 for _ in range(3)]) * np.sqrt(force * rod.mass)),
        "Contact": lambda: fx.Contact(free + draw.vector(0.5 * L), 0.15 * L, 0.05 * L, 0.6 * L,
                                      draw(1.0, 4.0) * force / L),
        "Actuation": lambda: fx.Actuation(value(1.0 / L, True),
                                          Value(draw.vector(0.02), frequency=rate and 2 * rate)),
        "Damping": lambda: fx.Damping(np.array([draw(0.002,
            0.02) for _ in range(6)] if rod.S.diagonal().all() else
                                               [draw(0.002,
                                                     0.02)] * 6) * (1 / rate if moving else 1.0)),
        "Load": lambda: fx.Load(draw(0.2, 1.0) * force / L, free + draw.vector(0.2 * L),
                                draw(0, 0.1) * rod.mass / L,
                                0.0 if draw.plane == "xz" else draw(-0.5, 0.5) * force,
                                draw(0, 0.02) * rod.mass * L**2,
                                draw.vector(0.0 if draw.plane == "xy" else 0.3 * force * L),
                                at) if draw.chance(0.5) else
                       fx.Load(draw(0.2, 1.0) * force / L**2, free + draw.vector(0.2 * L),
                               draw(0, 0.1) * rod.mass / L**2,
                               0.0 if draw.plane == "xz" else draw(-0.5, 0.5) * force / L,
                               draw(0, 0.02) * rod.mass * L,
                               draw.vector(0.0 if draw.plane == "xy" else 0.3 * force), None),
    }
    # fmt: on
    return make[name]()


def forgetting(draw: Draw, kind: str, rate: float) -> fx.Viscoelastic:
    """Two arms that creep faster than the first vibrations; a plain section has them in each strain
    by itself.
    """
    rows = 6 if kind == "plain" else 1
    shares, times = (
        np.array([[draw.log(low, high) for _ in range(2)] for _ in range(rows)]) + np.zeros((6, 2))
        for low, high in ((0.05, 0.3), (0.02, 0.1))
    )
    return fx.Viscoelastic(shares, times / rate)


def supports(draw: Draw, kind: str, rod: Rod, moving: bool, rate: float) -> dict[float, Support]:
    """By place."""

    def value(size: float, across: bool = False) -> Value:
        return Value(draw.vector(size, across), frequency=rate * draw(1.0, 4.0) if moving else None)

    moved = dict(displacement=value(0.05 * rod.length), turn=value(draw(0.1, 0.5), True))
    hinge = {"xy": "xy", "xz": "xz", None: draw.one("xy", "yz", "xz")}[draw.plane]
    slide = {"xy": "y", "xz": "z", None: draw.one("yz", "x", "y", "xz")}[draw.plane]
    return {
        "clamp": {0.0: Support()},
        "elastic clamp": {0.0: Support("", "", **moved)},
        "clamp and pin": {0.0: Support(), 1.0: Support("xyz", "")},
        "hinge and pin": {0.0: Support("xyz", hinge), 1.0: Support("xyz", "")},
        "clamp and slide": {0.0: Support(), 1.0: Support(slide, "")},
        "two clamps, moved": {0.0: Support(), 1.0: Support(**moved)},
        "clamp, moved": {0.0: Support(**moved)},
    }[kind]


def case(
    random: np.random.Generator, number: int = 0, moving: bool = False, every: bool = False
) -> Case:
    """A random case. Numbers in a row take all effects, supports and sections in turn, the rest at
    random. every: all effects at once, in space.
    """
    plane = None if every or random.uniform() < 0.75 else str(random.choice(("xy", "xz")))
    draw = Draw(random, plane)
    kind, hold = SECTIONS[number % 5], "elastic clamp" if every else SUPPORTS[number % 7]
    shapes = SHAPES if plane is None else SHAPES[:2]
    shape = shapes[int(random.integers(len(shapes)))]
    if kind == "rigid" and hold in ("clamp and pin", "hinge and pin", "two clamps, moved"):
        kind = "coupled"
    own = rod(draw, shape, kind)
    force = 1 / own.length**2
    rate = float(np.sqrt(force / own.mass) / own.length)  # sqrt(EI/(m L^4))
    names = [name for name in fx.ROWS if name not in ("RootSpring", "Viscoelastic")]
    chosen = {
        names[number % len(names)],
        names[int(random.integers(len(names)))],
        draw.one("TipLoad", "LineLoad", "Gravity"),
    }
    if every:
        chosen = set(fx.ROWS) - {"Viscoelastic"}
    elif hold == "elastic clamp":
        chosen.add("RootSpring")
    spin = draw.vector(draw(0.2, 1.0) * rate, across=True) if draw.chance(0.4) else None
    velocity = (
        draw.vector(draw(0.2, 1.0) * rate * own.length)
        if spin is not None and draw.chance(0.5)
        else None
    )
    acting = tuple(effect(draw, name, own, force, moving) for name in sorted(chosen))
    order = draw.one(2, 2, 1)
    if every or number % FORGETS == FORGETS - 1:
        acting, chosen = (*acting, forgetting(draw, kind, rate)), {*chosen, "Viscoelastic"}
    text = ", ".join(
        [
            shape,
            kind,
            hold,
            *sorted(chosen),
            *([f"plane {plane}"] if plane else []),
            *(["turning"] if spin is not None else []),
            f"order {order}",
        ]
    )
    return Case(
        own, acting, supports(draw, hold, own, moving, rate), velocity, spin, order, plane, text
    )
