"""Motions whose accuracy is measured: what a beam is made of and what moves it, for any mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from ..common_case import STRIP, straight

INTERVALS = 600  # between the instants of a reference
PARAMETERS = "stiffness", "mass", "load"  # multipliers, by which gradients are taken


@dataclass(frozen=True)
class Motion:
    """A motion of a clamped beam along x.

    name, about  what tables say;  kind  "smooth", "damped" or "sudden": what the order in time
                 depends on
    length       m;  duration s
    section      of multipliers (...) of stiffness and of mass
    effects      of the multiplier of the load;  frame: likewise, None = inertial
    plane        that it is solved in, None = 3D;  flat: the plane that it stays in, None = it does
                 not
    of           name of the motion whose reference is that of this one
    """

    name: str
    about: str
    kind: str
    length: float
    duration: float
    section: Callable[[Tensor, Tensor], tb.Section]
    effects: Callable[[Tensor], tuple[Any, ...]]
    frame: Callable[[Tensor], tb.Frame] | None = None
    plane: str | None = None
    flat: str | None = None
    of: str | None = None

    @property
    def reference(self) -> str:
        """The name of the motion whose reference is compared with."""
        return self.of or self.name

    def scene(
        self, element: str, elements: int, by: Tensor | None = None, flat: bool = False
    ) -> tb.Scene:
        """The scene by an element of `KINDS`.

        by    (..., 3) multipliers, see `PARAMETERS`; None = 1
        flat  in the plane that it stays in
        """
        by = torch.ones(3, dtype=torch.float64) if by is None else by
        stiffness, mass, load = by.unbind(-1)
        beam = straight(
            by.new_tensor(self.length), elements, self.section(stiffness, mass), element
        )
        frame = {} if self.frame is None else dict(frame=self.frame(load))
        return tb.Scene(
            beam,
            self.effects(load),
            plane=(self.plane or self.flat) if flat else self.plane,
            **frame,
        )

    def instants(self, count: int = INTERVALS) -> Tensor:
        """(count + 1,) s, equally spaced."""
        return torch.linspace(0, self.duration, count + 1, dtype=torch.float64)


def _plain(**of: float) -> Callable[[Tensor, Tensor], tb.Section]:
    """A section by its stiffness, mass and rotary inertia."""

    def section(stiffness: Tensor, mass: Tensor) -> tb.Section:
        return tb.Section.from_stiffness(
            **{
                name: value * (mass if name in ("mass", "inertia") else stiffness)
                for name, value in of.items()
            }
        )

    return section


def _coupled(stiffness: Tensor, mass: Tensor) -> tb.Section:
    """Bending coupled with stretching and torsion, mass off the axis."""
    K = torch.diag(stiffness.new_tensor((1e3, 4e2, 4e2, 0.8, 1.0, 2.0)))
    M = torch.diag(mass.new_tensor((1.0, 1.0, 1.0, 0.02, 0.01, 0.01)))
    K[3, 4] = K[4, 3] = 0.3
    K[0, 5] = K[5, 0] = 5.0
    # its centre is at (0.03, -0.03) m
    for i, j, entry in ((0, 4, -0.03), (0, 5, -0.03), (1, 3, 0.03), (2, 3, 0.03)):
        M[i, j] = M[j, i] = entry
    return tb.Section(torch.linalg.inv(K) / stiffness[..., None, None], M * mass[..., None, None])


def _force(load: Tensor, *force: float) -> Tensor:
    return load[..., None] * load.new_tensor(force)


def _swung(load: Tensor) -> tuple[Any, ...]:
    def course(*size: float) -> Callable[[Tensor], Tensor]:
        return lambda t: _force(load, *size) * torch.sin(3.0 * t)[..., None] ** 2

    return (tb.TipLoad(force=course(0.5, 1.5, 3.0), moment=course(0.0, 0.0, 0.2)),)


def _spin_up(load: Tensor) -> tb.Frame:
    """Angular velocity 6/15 (t - 15/(2 pi) sin(2 pi t/15)) rad/s until 15 s, then 6."""

    def rate(t: Tensor) -> Tensor:
        s = torch.clamp(t, max=15.0)
        return (
            _force(load, 0.0, 0.0, 0.4)
            * (s - 15.0 / (2 * math.pi) * torch.sin(2 * math.pi * s / 15.0))[..., None]
        )

    return tb.Frame(angular_velocity=rate)


SOFT = _plain(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=1.0, inertia=0.01)
SILICONE = _plain(EA=200.0, GA=80.0, GJ=0.015, EI=0.02, mass=0.3, inertia=1e-3)
ARM = _plain(EA=2.8e7, GA=1e7, GJ=1.4e4, EI=1.4e4, mass=1.2, inertia=6e-4)


def _pushed(load: Tensor) -> tuple[Any, ...]:
    return (tb.TipLoad(force=_force(load, 0.0, 1.0, 0.0)),)


# fmt: off
MOTIONS = (
    Motion("sudden",
           "strip of 1 m, EI = 1 N m^2, 0.2 kg/m, a sudden dead tip load of 1 N, undamped, 2 s "
           "(the common dynamic case); in 3D", "sudden", 1.0, 2.0, _plain(**STRIP), _pushed,
           flat="xy"),
    Motion("sudden, plane", "the same, solved in its plane", "sudden", 1.0, 2.0, _plain(**STRIP),
           _pushed, plane="xy",
           of="sudden"),
    Motion("coupled",
           "1 m, bending coupled with stretching and torsion, mass off the axis; force (0.5, 1.5, "
           "3) N and moment (0, 0, 0.2) N m on the tip, times sin(3 t)^2, undamped, 2 s", "smooth",
           1.0, 2.0,
           _coupled, _swung),
    Motion("follower",
           "1 m, EI = 1 N m^2, 1 kg/m, a sudden follower force (0, 1, 2) N on the tip, "
           "`Damping(0.01)`, 2 s",
           "damped", 1.0, 2.0, SOFT,
           lambda load: (tb.TipLoad(force=_force(load, 0.0, 1.0, 2.0), follower=True),
                         tb.Damping(0.01))),
    Motion("silicone",
           "0.5 m, EI = 0.02 N m^2, 0.3 kg/m, falls by its weight across (q L^3/EI = 18), "
           "`Damping(0.005)`, 2 s",
           "damped", 0.5, 2.0, SILICONE,
           lambda load: (tb.Gravity(_force(load, 0.0, 0.0, -9.81)), tb.Damping(0.005)), flat="xz"),
    Motion("spin-up",
           "Simo and Vu-Quoc's arm of 10 m, brought to 6 rad/s within 15 s about an axis "
           "across, undamped, 20 s",
           "smooth", 10.0, 20.0, ARM, lambda load: (), _spin_up, flat="xy"),
)
# fmt: on
