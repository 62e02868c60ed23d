"""The same physics in other words: turned, mirrored, moved, in other units, at another time.

A `Similarity` goes by what each number of a scene is (`Quantity`: its dimension and how it turns).
`FIELDS` says that of every field of every effect, motion, support, beam and state; nothing else
here knows them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import Obstacle, WindField, own_leaves
from torchbeam.extend import quaternions as quat
from torchbeam.scene.effects import Eyelet

EYE, ZERO = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
# a mirrored section counts its y axis backwards
FLIP = torch.diag(torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64))


class Quantity(NamedTuple):
    """Powers of mass, length and time, and how it turns.

    "number"; "polar" or "axial" vector in frame a; "place" (a point there); "rotation"
    (a quaternion to frame a); in section axes "own polar", "own axial", "own y" (of a vector), "own
    tensor" (3, 3); of six entries "wrench" (force, moment), "own wrench", "springs" (along and
    about three axes);
    "compliance" and "mass" (6, 6); "frame": quaternion from frame a to inertial axes; "instant".
    """

    mass: int = 0
    length: int = 0
    time: int = 0
    kind: str = "number"


ONE, FORCE, MOMENT = Quantity(), Quantity(1, 1, -2, "polar"), Quantity(1, 2, -2, "axial")
PLACE, VELOCITY = Quantity(0, 1, 0, "place"), Quantity(0, 1, -1, "polar")
INSTANT, DIRECTION = Quantity(0, 0, 1, "instant"), Quantity(kind="polar")
ENERGY, MOVE, TURN = Quantity(1, 2, -2), Quantity(0, 1, 0, "polar"), Quantity(0, 0, 0, "axial")
OFFSET = Quantity(0, 1, 0, "own polar")


def _load(lengths: int) -> Callable[[Any], dict[str, Quantity]]:
    def fields(load: Any) -> dict[str, Quantity]:
        own = "own " if load.follower else ""
        return dict(
            force=Quantity(1, 1 - lengths, -2, own + "polar"),
            moment=Quantity(1, 2 - lengths, -2, own + "axial"),
        )

    return fields


# fmt: off
FIELDS: dict[type, Callable[[Any], dict[str, Quantity]]] = {
    tb.Gravity: lambda e: dict(g=Quantity(0, 1, -2, "polar")),
    tb.TipLoad: lambda e: _load(0)(e) | dict(offset=OFFSET),
    tb.PointLoad: lambda e: _load(0)(e) | dict(offset=OFFSET),
    tb.LineLoad: _load(1),
    tb.Damping: lambda e: dict(tau=Quantity(time=1)),
    tb.Viscoelastic: lambda e: dict(shares=ONE, times=Quantity(time=1)),
    tb.MassDamping: lambda e: dict(alpha=Quantity(time=-1)),
    tb.Drag: lambda e: dict(density=Quantity(1, -3), diameter=Quantity(0, 1), normal=ONE,
                            tangential=ONE, flow=VELOCITY,
                            added_mass=ONE),
    tb.StripAir: lambda e: dict(chord=Quantity(0, 1, 0, "own y"), axis=ONE, lift_slope=ONE,
                                polar=ONE, density=Quantity(1, -3), wind=VELOCITY),
    tb.PointMass: lambda e: dict(mass=Quantity(1), inertia=Quantity(1, 2, 0, "own tensor"),
                                 offset=OFFSET),
    tb.Actuation: lambda e: dict(curvature=Quantity(0, -1, 0, "own axial"),
                                 strain=Quantity(0, 0, 0, "own polar")),
    tb.Spring: lambda e: dict(stiffness=Quantity(1, 0, -2), to=PLACE, length=Quantity(0, 1),
                              damping=Quantity(1, 0, -1), offset=OFFSET),
    tb.Tendon: lambda e: dict(tension=Quantity(1, 1, -2), length=Quantity(0, 1),
                              stiffness=Quantity(1, 0, -2), friction=ONE,
                              slip_speed=Quantity(0, 1, -1)),
    Eyelet: lambda e: dict(point=PLACE if e.node is None else Quantity(0, 1, 0, "own polar")),
    tb.RootSpring: lambda e: dict(stiffness=Quantity(1, 0, -2, "springs"),
                                  damping=Quantity(1, 0, -1, "springs")),
    tb.Contact: lambda e: dict(obstacle=ONE, thickness=Quantity(0, 1), force=Quantity(1, 0, -2),
                               stiffness=Quantity(1, -1, -2), radius=Quantity(0, 1), friction=ONE,
                               slip_speed=Quantity(0, 1, -1), damping=Quantity(0, 0, 1),
                               other_radius=Quantity(0, 1),
                               corners=Quantity(0, 1, 0, "own polar")),
    tb.SelfContact: lambda e: dict(thickness=Quantity(0, 1), force=Quantity(1, 0, -2),
                                   stiffness=Quantity(1, -1, -2), radius=Quantity(0, 1),
                                   friction=ONE, slip_speed=Quantity(0, 1, -1),
                                   damping=Quantity(0, 0, 1)),
    tb.Table: lambda e: dict(s=Quantity(0, 1), values=Quantity(0, 1)),  # of a radius
    tb.Plane: lambda e: dict(point=PLACE, normal=DIRECTION),
    tb.Sphere: lambda e: dict(centre=PLACE, radius=Quantity(0, 1),
                              spin=Quantity(0, 0, -1, "axial")),
    tb.Cylinder: lambda e: dict(point=PLACE, axis=DIRECTION, radius=Quantity(0, 1),
                                spin=Quantity(0, 0, -1)),
    tb.Capsule: lambda e: dict(a=PLACE, b=PLACE, radius=Quantity(0, 1)),
    tb.Load: lambda e: dict(function=ONE, rate=ONE, values=ONE),  # see `Similarity._load`
    tb.Frame: lambda e: dict(velocity=VELOCITY, angular_velocity=Quantity(0, 0, -1, "axial")),
    tb.RootMotion: lambda e: dict(displacement=MOVE, rotation=TURN),
    tb.Support: lambda e: dict(displacement=MOVE, turn=TURN),
    tb.Beam: lambda e: dict(nodes=PLACE, frames=Quantity(kind="rotation"),
                            elements=Quantity(kind="rotation"),
                            length=Quantity(0, 1), compliance=Quantity(kind="compliance"),
                            mass=Quantity(kind="mass"), taper=Quantity(kind="compliance"),
                            mass_taper=Quantity(kind="mass")),
    tb.State: lambda e: dict(position=PLACE, rotation=Quantity(kind="rotation"), velocity=VELOCITY,
                             spin=Quantity(0, 0, -1, "own axial"),
                             stress=Quantity(kind="own wrench"),
                             reaction=Quantity(kind="wrench"),
                             work=ENERGY, defect=ENERGY, t=INSTANT, status=ONE,
                             frame=Quantity(kind="frame"), internal=ONE,
                             acceleration=ONE, straining=ONE, joints=ONE,
                             tendons=ONE, memory=ONE, inelastic=ONE),
}
# fmt: on


def quantities(of: Any) -> dict[str, Quantity]:
    """Those of an object's fields. KeyError for a class, or a leaf of it, that has no row."""
    known = next(FIELDS[kind] for kind in type(of).__mro__ if kind in FIELDS)(of)
    given = {one.name for one in fields(of) if one.init}
    return {one.name: known[one.name] for one in own_leaves(of) if one.name in given}


@dataclass(frozen=True)
class Similarity:
    """x -> length (turn x + origin) and so on, t -> time (t + shift); `turn` (3, 3) may be a
    reflection.
    """

    turn: Tensor = EYE
    origin: Tensor = ZERO
    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0
    shift: float = 0.0

    @property
    def inverse(self) -> Similarity:
        back = self.turn.mT
        return Similarity(
            back, -(back @ self.origin) * self.length, 1 / self.mass, 1 / self.length,
            1 / self.time, -self.shift * self.time,
        )  # fmt: skip

    @property
    def mirrors(self) -> bool:
        return bool(torch.linalg.det(self.turn) < 0)

    @property
    def own(self) -> Tensor:
        """(3, 3) by which vectors in section axes turn."""
        return FLIP if self.mirrors else EYE

    def size(self, q: Quantity) -> float:
        return self.mass**q.mass * self.length**q.length * self.time**q.time

    def matrix(self, kind: str) -> Tensor | None:
        """(3, 3) by which a vector of that kind turns; None = it is none."""
        sign = -1.0 if self.mirrors else 1.0
        return {
            "polar": self.turn,
            "place": self.turn,
            "axial": sign * self.turn,
            "own polar": self.own,
            "own axial": sign * self.own,
        }.get(kind)

    def wrench(self, own: str = "") -> Tensor:
        """(6, 6) of force and moment."""
        force, moment = Quantity(1, 1, -2), Quantity(1, 2, -2)
        return torch.block_diag(
            self.size(force) * self.matrix(f"{own}polar"),
            self.size(moment) * self.matrix(f"{own}axial"),
        )

    def value(self, q: Quantity, x: Any) -> Any:
        """A tensor as it is told there; plain numbers stay plain numbers."""
        if x is None:
            return None
        if not isinstance(x, Tensor):
            return self.value(q, torch.as_tensor(np.asarray(x), dtype=torch.float64)).tolist()
        if q.kind == "number":
            return self.size(q) * x
        if q.kind == "own y":
            return self.size(q) * self.own[1, 1] * x
        if q.kind == "instant":
            return self.time * (x + self.shift)
        if q.kind in ("rotation", "frame"):
            own = self.own if q.kind == "rotation" else self.turn.mT
            return quat.from_matrix(self.turn @ quat.matrix(x) @ own)
        if q.kind in ("wrench", "own wrench"):
            return x @ self.wrench(q.kind.removesuffix("wrench")).mT
        if q.kind == "springs":
            return (
                self.size(q)
                * x
                * torch.tensor([1.0] * 3 + [self.length**2] * 3, dtype=torch.float64)
            )
        if q.kind == "own tensor":
            A = self.matrix("own polar")
            return self.size(q) * (A @ x @ A.mT)
        if q.kind == "compliance":  # strain = S stress, strain conjugate to stress per length
            P = torch.linalg.inv(self.wrench("own "))
            return self.size(Quantity(1, 1, -2)) * (P.mT @ x @ P)  # energy per length = F.S.F / 2
        if q.kind == "mass":
            P = torch.block_diag(
                self.size(Quantity(0, -1, 1)) * self.matrix("own polar"),
                self.time * self.matrix("own axial"),
            )
            return self.size(Quantity(1, 1, -2)) * (P.mT @ x @ P)
        moved = x @ self.matrix(q.kind).mT
        return self.size(q) * (moved + self.origin if q.kind == "place" else moved)

    def instant(self, t: Tensor) -> Tensor:
        """The instant here of one there."""
        return t / self.time - self.shift

    def function(self, q: Quantity, f: Callable) -> Callable:
        """A function of t as it is told there."""
        return lambda t: self.value(q, tensor(f(self.instant(t))))

    def field(self, wind: Callable) -> Callable:
        """A wind, a function of place and t, as it is told there."""
        return lambda x, t: self.value(
            VELOCITY, tensor(wind(self.inverse.value(PLACE, x), self.instant(t)))
        )

    def given(self, q: Quantity, value: Any) -> Any:
        """Whatever may stand in a field: numbers, a function of t, along the beam, an Input."""
        if value is None or isinstance(value, tb.Input):
            return value
        if isinstance(value, Obstacle):
            return self(value)
        if isinstance(value, WindField):
            return self.field(value.velocity)
        if isinstance(value, (tb.Polar, tb.DynamicStall)):  # by the angle, in section axes
            return value
        if isinstance(value, tb.PerElement):
            return tb.PerElement(self.given(q, value.value))
        if isinstance(value, tb.PerInterval):
            return tb.PerInterval(self.given(q, value.value))
        if isinstance(value, tb.Along):
            return tb.Along(
                lambda s, t: self.value(q, tensor(value.function(s / self.length, self.instant(t))))
            )
        return self.function(q, value) if callable(value) else self.value(q, value)

    def __call__(self, of: Any) -> Any:
        """An object as it is told there."""
        if isinstance(of, tb.Load):
            return self._load(of)
        found = {name: self.given(q, getattr(of, name)) for name, q in quantities(of).items()}
        if isinstance(of, tb.Drag) and callable(of.flow):
            found["flow"] = self.field(of.flow)
        if isinstance(of, tb.Tendon):
            found["eyelets"] = [
                (e.node, self.value(PLACE if e.node is None else OFFSET, torch.as_tensor(e.point)))
                for e in of.eyelets
            ]
        if isinstance(of, tb.Support):
            found |= dict(position=self._letters(of.position), rotation=self._letters(of.rotation))
        return replace(of, **found)

    def _letters(self, letters: str) -> str:
        """Axes that are held, turned: of some of them only where axes stay axes."""
        if len(letters) in (0, 3):
            return letters
        found = self.turn[:, ["xyz".index(c) for c in letters]].abs().argmax(0)
        return "".join("xyz"[i] for i in sorted(found.tolist()))

    def _load(self, load: Any) -> Any:
        """What it reads is told here, what it answers there; internal states have no dimension."""
        back, along = self.inverse, load.node is None
        reads = (PLACE, None, VELOCITY, Quantity(0, 0, -1, "axial"))
        named = dict(
            acceleration=Quantity(0, 1, -2, "polar"),
            angular_acceleration=Quantity(0, 0, -2, "axial"),
            s=Quantity(0, 1),
        )

        def arguments(motion: tuple, t: Tensor, more: dict) -> tuple[list, dict]:
            here = [
                x if x is None else back.turn @ x @ self.own if q is None else back.value(q, x)
                for q, x in zip(reads, motion, strict=True)
            ]
            return [*here, self.instant(t)], {
                n: back.value(named[n], v) if n in named else v for n, v in more.items()
            }

        def function(*motion: Any, **more: Any) -> tuple:
            here, more = arguments(motion[:4], motion[4], more)
            force, moment = load.function(*here, **more)
            lengths = 1 if along else 0
            return (
                self.value(Quantity(1, 1 - lengths, -2, "polar"), tensor(force)),
                self.value(Quantity(1, 2 - lengths, -2, "axial"), tensor(moment)),
            )

        def rate(z: Tensor, *motion: Any, **more: Any) -> Tensor:
            here, more = arguments(motion[:4], motion[4], more)
            return tensor(load.rate(z, *here, **more)) / self.time

        return replace(load, function=function, rate=None if load.rate is None else rate)


def tensor(value: Any) -> Tensor | None:
    """What a user's function returned: a tensor, or a sequence of components."""
    if value is None or isinstance(value, Tensor):
        return value
    return torch.stack(
        torch.broadcast_tensors(*(torch.as_tensor(v, dtype=torch.float64) for v in value)), -1
    )


def input_quantities(effects: Any) -> dict[str, Quantity]:
    """What the inputs are, by name; those of a user's load are numbers."""
    found = {}
    for effect in effects:
        values = ((getattr(effect, name), q) for name, q in quantities(effect).items())
        found |= {value.name: q for value, q in values if isinstance(value, tb.Input)}
        found |= {
            given.name: ONE for given in (effect.inputs if isinstance(effect, tb.Load) else ())
        }
    return found
