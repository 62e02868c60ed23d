"""Random scenes: soft rods in families that are loaded, held and moved differently, each sample
with its own values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb


class Draw:
    """Random numbers, one for each sample."""

    def __init__(self, seed: int, samples: int) -> None:
        self.random, self.samples = torch.Generator().manual_seed(seed), samples

    def __call__(self, low: float, high: float, *shape: int) -> Tensor:
        """Evenly between two."""
        return low + (high - low) * torch.rand(
            self.samples, *shape, generator=self.random, dtype=torch.float64
        )

    def log(self, low: float, high: float) -> Tensor:
        """Evenly between the logarithms of two."""
        return self(math.log(low), math.log(high)).exp()

    def vector(self, size: Tensor) -> Tensor:
        """(..., 3) of a length, to any side."""
        x = self(-1.0, 1.0, 3)
        return size[:, None] * x / torch.linalg.vector_norm(x, dim=-1, keepdim=True)


def rod(draw: Draw, elements: int) -> tuple[tb.Beam, Tensor]:
    """A soft rod, and the force EI/L^2 that bends it much."""
    L, EI, mass = draw(0.3, 0.8), draw.log(0.007, 0.06), draw(0.15, 0.6)
    section = tb.Section.from_stiffness(
        EA=1e4 * EI, GA=4e3 * EI, GJ=draw(0.5, 1.0) * EI, EI=EI, mass=mass,
        inertia=mass * draw.log(3e-5, 3e-3),
    )  # fmt: skip
    return tb.Beam.straight(L, elements, section), EI / L**2


def families(elements: int) -> dict[str, Callable[[Draw], tb.Scene]]:
    """Name -> scenes of random values."""

    def made(*effects: Callable[[Draw, Tensor], Any], **options: Any) -> Callable[[Draw], tb.Scene]:
        def scene(draw: Draw) -> tb.Scene:
            beam, force = rod(draw, elements)
            more = {
                name: value(draw) if callable(value) else value for name, value in options.items()
            }
            return tb.Scene(beam, [effect(draw, force) for effect in effects], **more)

        return scene

    def push(low: float, high: float, **more: Any) -> Callable[[Draw, Tensor], Any]:
        return lambda draw, force: tb.TipLoad(force=draw.vector(draw(low, high) * force), **more)

    def damping(draw: Draw, force: Tensor) -> Any:
        return tb.Damping(draw.log(1e-3, 5e-2))

    def weight(draw: Draw, force: Tensor) -> Any:
        return tb.Gravity((0.0, 0.0, -9.81))

    def shaking(draw: Draw, force: Tensor) -> Any:
        size, rate = draw.vector(draw(0.3, 1.5) * force), draw(3.0, 25.0)
        return tb.TipLoad(force=lambda t: size * torch.sin(rate * t)[..., None])

    def moment(draw: Draw, force: Tensor) -> Any:
        size, rate = draw.vector(draw(0.1, 0.8) * force), draw(1.0, 8.0)  # force times 1 m
        return tb.TipLoad(
            moment=lambda t: size * torch.sin(rate * t)[..., None] ** 2, follower=True
        )

    def kick(draw: Draw, force: Tensor) -> Any:
        size, at, width = draw.vector(draw(2.0, 8.0) * force), draw(0.2, 0.6), draw.log(0.005, 0.05)
        return tb.TipLoad(force=lambda t: size * torch.exp(-((t - at) / width).square())[..., None])

    def turning(draw: Draw) -> tb.Frame:
        rate = draw(1.0, 6.0)
        return tb.Frame(
            angular_velocity=lambda t: torch.stack(
                (0 * rate, 0 * rate, rate * torch.tanh(t) ** 2), -1
            )
        )

    def shaken(draw: Draw) -> tb.RootMotion:
        size, rate = draw(0.01, 0.05), draw(3.0, 15.0)
        return tb.RootMotion(
            displacement=lambda t: torch.stack(
                (0 * size, 0 * size, size * torch.sin(rate * t) ** 2), -1
            )
        )

    return {
        "sudden": made(push(0.3, 2.0)),
        "sudden, damped": made(push(0.3, 3.0), damping),
        "weight": made(weight, damping),
        "weight, plane": made(weight, plane="xz"),
        "follower": made(push(0.5, 4.0, follower=True), damping),
        "shaking": made(shaking, damping),
        "kick": made(kick, damping),
        "turning": made(damping, weight, frame=turning),
        "shaken root": made(weight, damping, root=shaken),
        "pendulum": made(
            weight,
            damping,
            lambda draw, force: tb.PointMass(draw(0.01, 0.1)),
            supports=[tb.Support(0, "xyz", "xz")],
        ),
        "drag": made(
            push(0.5, 3.0),
            damping,
            lambda draw, force: tb.Drag(1000.0, draw(0.002, 0.01), added_mass=1.0),
        ),
        "follower moment": made(moment),
        "free": made(
            push(0.1, 1.0, follower=True),
            damping,
            lambda draw, force: tb.MassDamping(draw(0.1, 1.0)),
            supports=[tb.Support(0, "", "")],
        ),
    }
