"""The wake of a section: air that meets it, and the lags by which it acts."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.validation import refusal, shown

Lags = tuple[tuple[float, float], ...]  # of each share and rate

# shares and rates (per semichord travelled) of what is late of Wagner's function, by which lift
# follows a section's motion (Jones 1940), and of Kuessner's, by which it follows a gust that the
# section enters (Bisplinghoff, Ashley and Halfman 1955, section 5-7)
LAGS = {"wagner": ((0.165, 0.0455), (0.335, 0.3)), "kussner": ((0.5, 0.13), (0.5, 1.0))}


def delays(name: str, value: Any) -> Lags | None:
    """Lags as pairs of share and rate, checked."""
    if value is None or (isinstance(value, str) and value in LAGS):
        return LAGS.get(value)
    wanted = 'None, "wagner", "kussner" or pairs (share, rate) of positive numbers'
    try:
        pairs = tuple((float(share), float(rate)) for share, rate in value)
    except (TypeError, ValueError):
        raise refusal(f"{name} = {shown(value)}", wanted) from None
    if not all(share > 0 and 0 < rate < math.inf for share, rate in pairs) or (
        sum(share for share, _ in pairs) > 1
    ):
        raise refusal(f"{name} = {shown(value)}", f"{wanted}, shares of 1 in all at most,")
    return pairs


class Flow(NamedTuple):
    """Air that meets a section, in axes of the chord: y toward the leading edge, z that of the
    section; each (..., sites, 1).

    forward m/s: speed of the section along y, against the air
    upwash m/s: of the air along z, at three quarters of the chord, turning included; as it acts,
    delayed by the wake
    pitch rad/s: rate of turning about x, nose up
    semichord m
    speed m/s: of the air in the section's plane, at the beam's axis
    """

    forward: Tensor
    upwash: Tensor
    pitch: Tensor
    semichord: Tensor
    speed: Tensor

    @property
    def turn(self) -> Tensor:
        """b p/V (..., sites), 0 in still air."""
        moves = self.speed > 0
        turn = self.semichord * self.pitch / torch.where(moves, self.speed, 1.0)
        return torch.where(moves, turn, 0.0)[..., 0]

    @property
    def angle(self) -> Tensor:
        """Angle of attack (..., sites) at three quarters of the chord."""
        return torch.atan2(self.upwash, self.forward)[..., 0]

    def delayed(self, lags: Lags | None, z: Tensor | None) -> Flow:
        """As it acts; where nothing is known of internal states, after long."""
        if not lags or z is None:
            return self
        shares = z.new_tensor([share for share, _ in lags])
        late = (shares * z[..., : len(lags)]).sum(-1, keepdim=True)
        return self._replace(upwash=(1 - shares.sum()) * self.upwash + late)

    def lag_rates(self, lags: Lags | None, z: Tensor) -> Tensor:
        """B_i V/b (..., sites, lags)."""
        return z.new_tensor([rate for _, rate in lags or ()]) * self.speed / self.semichord
