"""Sensors of the support at node 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .sensor import XYZ, Sensor


@dataclass(frozen=True, eq=False, repr=False)
class RootForce(Sensor):
    """Force (..., 3) N of the support at node 0 on the beam, frame a: the state's own (see `State`)."""

    name = "root force"
    unit = "N"
    labels = XYZ

    def read(self, state: Any) -> Tensor:
        return state.root.force


@dataclass(frozen=True, eq=False, repr=False)
class RootMoment(Sensor):
    """Moment (..., 3) N m of the support at node 0 on the beam, frame a: the state's own (see `State`)."""

    name = "root moment"
    unit = "N m"
    labels = XYZ

    def read(self, state: Any) -> Tensor:
        return state.root.moment


@dataclass(frozen=True, eq=False, repr=False)
class RootReaction(Sensor):
    """Force and moment (..., 6) N and N m of the support at node 0 on the beam, frame a: the state's own (see `State`)."""

    name = "root reaction"
    unit = "N, N m"
    labels = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

    def read(self, state: Any) -> Tensor:
        return torch.cat(tuple(state.root), -1)
