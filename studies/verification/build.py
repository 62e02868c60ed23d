"""Building blocks of the cases."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

INF = math.inf


def section(
    EA: Any = INF, GA: Any = INF, GJ: Any = 1.0, EI: Any = 1.0, mass: Any = 1.0, inertia: Any = 0.0
) -> tb.Section:
    """Inextensible and unshearable unless said otherwise: what the elastica is, exactly."""
    return tb.Section.from_stiffness(EA=EA, GA=GA, GJ=GJ, EI=EI, mass=mass, inertia=inertia)


def planar(EI: Any = 1.0, GA: Any = INF, inertia: Any = 0.0, mass: Any = 1.0) -> tb.Section:
    """Bends in the x-z plane alone."""
    return section(GA=(INF, GA), GJ=INF, EI=(EI, INF), mass=mass, inertia=(inertia, 0.0))


def cantilever(
    N: int,
    *effects: Any,
    of: tb.Section | None = None,
    L: Any = 1.0,
    order: int = 1,
    **options: Any,
) -> tb.Scene:
    return tb.Scene(tb.Beam.straight(L, N, of or section(), order=order), effects, **options)


def along(axis: int, values: Tensor) -> Tensor:
    """(...) -> (..., 3)"""
    return values[..., None] * torch.eye(3)[axis]
