"""Gravity: weight of the beam and of point masses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.leaves import leaf
from ...core.validation import Value, refusal, shown
from ...math.quaternions import skew
from .load_point import ROTATION, LoadEffect, LoadPoint
from .values import Inputs, load_value, value_at


def _acceleration(name: str, value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        raise refusal(f"{name} = {shown(value)}", "three numbers, as (0, 0, -9.81),", are=True)
    return load_value(name, value)


@dataclass(frozen=True)
class Gravity(LoadEffect):
    """Gravity: weight by a uniform acceleration g.

    Args:
        g: (..., 3) m/s^2, in inertial axes that coincide with frame a at t = 0
        on: name of a beam or a body of a structure; None = all

    Examples:
        >>> weighed = tb.Scene(beam, [tb.Gravity((0, 0, -9.81))])
        >>> tb.equilibrium(weighed).root.force[2]  # N, the weight
        tensor(1.5892)
    """

    g: Value = leaf(1, check=_acceleration)
    on: str | None = field(default=None, kw_only=True)

    conservative = True
    by_place = False
    by_mass = True
    wants_axes = True
    depends = frozenset({ROTATION})

    def turning_resistance(self, length: Tensor, mass: Tensor) -> Tensor | None:
        g = self.g
        return mass * length * torch.linalg.vector_norm(g, dim=-1) if torch.is_tensor(g) else None

    def depends_on(self, offset: bool) -> frozenset[str]:
        """The moment of an offset centre of mass turns; the force does not."""
        return self.depends if offset else frozenset()

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Per unit length: force R M11 R^T g, moment R M21 R^T g."""
        body = point.R.mT @ self._here(point, t, inputs)[..., None]
        weight = point.mass[..., :3] @ body
        return tuple(point.rotate(w[..., 0]) for w in (weight[..., :3, :], weight[..., 3:, :]))

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        turned = point.mass[..., :3] @ point.R.mT @ skew(self._here(point, t, inputs))
        parts = zip(
            (turned[..., :3, :], turned[..., 3:, :]), self.wrench(point, t, inputs), strict=True
        )
        return {ROTATION: torch.cat([point.R @ part - skew(w) for part, w in parts], -2)}

    def _here(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
        """g (..., 1, 3) in frame a."""
        return point.from_inertial(value_at(self.g, t, inputs, point.R))[..., None, :]
