"""Sensors of tendons: what `State.tendons` holds, by the tendon's place among the scene's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..core.arguments import place, whole
from ..core.leaves import option
from .sensor import Sensor


@dataclass(frozen=True, eq=False, repr=False)
class _OfTendon(Sensor):
    """tendon: its place among the scene's tendons. ValueError for one that is not there."""

    tendon: int = option(whole)

    def row(self, state: Any) -> Tensor:
        tendons = getattr(state, "tendons", None)
        count = 0 if tendons is None else tendons.shape[-2]
        return tendons[..., place("tendon", self.tendon, count, "there are the tendons"), :]


@dataclass(frozen=True, eq=False, repr=False)
class TendonTension(_OfTendon):
    """Tension (..., 2) N of a tendon's first stretch and of its last: over a step its mean, as
    friction leaves it.

    Examples:
        >>> rope = tb.Tendon([(None, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0)
        >>> tb.sensors.TendonTension(0)(tb.equilibrium(tb.Scene(beam, [rope])))  # N
        tensor([1., 1.])
    """

    name = property(lambda self: f"tension of tendon {self.tendon}")
    unit = "N"
    labels = ("first", "last")

    def read(self, state: Any) -> Tensor:
        return self.row(state)[..., :2]


@dataclass(frozen=True, eq=False, repr=False)
class TendonLength(_OfTendon):
    """Length (..., 1) m of a tendon from its first eyelet to its last.

    Examples:
        >>> rope = tb.Tendon([(None, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0)
        >>> tb.sensors.TendonLength(0)(tb.rest(tb.Scene(beam, [rope])))  # m
        tensor([1.])
    """

    name = property(lambda self: f"length of tendon {self.tendon}")
    unit = "m"
    labels = ("length",)

    def read(self, state: Any) -> Tensor:
        return self.row(state)[..., 2:]
