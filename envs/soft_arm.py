"""SoftArm: what the published tasks of soft arms share: where targets are, what is seen of the arm
and what its place is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend import shown

from .config import BeamEnvConfig
from .episodes import Episodes
from .reach import distance
from .sensors import Observed
from .task import Task

OWN = "section", "actuators", "force", "beam", "supports"
Box = tuple[tuple[float, float], ...]
NEAR = 0.05  # m, of the bonuses


@dataclass(frozen=True, kw_only=True)
class SoftArmConfig(BeamEnvConfig):
    """radius (m), young (Pa), density (kg/m^3), smooth (m): see `FollowTargetVectorEnv`; the rest
    as in `BeamEnvConfig`.
    """

    length: float = 1.0
    elements: int = 20
    radius: float = 0.05
    young: float = 10e6
    density: float = 1000.0
    smooth: float = 0.0
    delay: int = 0
    control_cost: float = 0.0
    sensors: str | Observed | Sequence[str | Observed] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("radius", "young", "density", above=0.0)
        self.check_numbers("smooth", least=0.0)
        for name in OWN:
            if self.is_given(name):
                raise ValueError(f"{name} was given; the arm has its own, none is wanted")
        if self.form != "nodal":
            raise ValueError(f"form = {shown(self.form)} was given; 'nodal' is wanted")


class SoftArm(Task):
    """An arm whose tip is to be at a target, in the box `BOX` (m) where it is drawn."""

    Config = SoftArmConfig
    BOX: ClassVar[Box]
    MESHED = False

    def __init__(self, config: SoftArmConfig) -> None:
        super().__init__(config)
        self.low, self.high = torch.tensor(self.BOX, dtype=self.dtype, device=self.device).T

    # The command (n, a): its bounds `limits` (a,), and its `change` by an action of 1

    limits: Tensor
    change: float = 1.0

    def command(self, now: Episodes) -> Tensor:
        """What acts, in units of `limits`."""
        raise NotImplementedError

    def held(self, now: Episodes) -> Tensor:
        """(n, a): the action by which the command stays."""
        return self.command(now)

    def tip_jacobian(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 3, a) m and (n, 3, a) rad: how a change of the command moves and turns the tip of an
        arm that follows it, frame a.
        """
        raise NotImplementedError

    def tip_moved(self, now: Episodes, turn: Tensor) -> tuple[Tensor, Tensor]:
        """The same by how elements turn along themselves, (n, N, a, 3) rad, frame a."""
        x = now.beam.position
        arm = x[:, -1:] - (x[:, :-1] + x[:, 1:]) / 2
        moved = torch.linalg.cross(turn, arm[:, :, None].expand_as(turn)).sum(1)
        return moved.mT, turn.sum(1).mT

    def axes_of_elements(self, now: Episodes) -> Tensor:
        """(n, N, 3, 3): their section axes -> frame a."""
        q = now.beam.rotation
        return quat.matrix(quat.half_way(q[:, :-1], q[:, 1:]))

    # Targets

    def in_box(self, stream: np.random.Generator) -> np.ndarray:
        """(3,) m, uniform."""
        drawn = stream.uniform(*np.transpose(self.BOX))
        return drawn if self.plane is None else drawn * [1, 0, 1]

    def _seen(self, sensor: Any, high: float) -> tuple[Observed, str]:
        whole = self.plane is None
        return Observed(sensor if whole else sensor[self.vector], 1.0, high), ""

    # What it is worth

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {"distance": distance(now.target[:, 0], now.beam.position[:, -1])}

    def cost(self, now: Episodes) -> Tensor:
        d = now.measures["distance"]
        return d.square() - 1.5 * self.below(d, NEAR) - 0.5 * self.below(d, 2 * NEAR)

    def below(self, x: Tensor, bound: float) -> Tensor:
        """1 where x (...) is below the bound, else 0; or a logistic function of width `smooth`."""
        width = self.config.smooth
        if width:
            return torch.sigmoid((bound - x) / width)
        return (x < bound).to(x)


def clamped_over(beam: tb.Beam, share: float) -> tb.Beam:
    """The beam, whose clamp holds a share of its length: there it neither bends nor twists."""
    count = beam.element_count
    rigid = count * overlaps(count, [0.0, share])[0]
    compliance = beam.compliance.expand(count, 6, 6).clone()
    compliance[:, 3:] *= (1 - rigid)[:, None, None]
    return replace(beam, compliance=compliance)


def overlaps(elements: int, bounds: Sequence[float]) -> Tensor:
    """(interval, element): how much of elements lies in intervals, in shares of the length."""
    ends = torch.linspace(0, 1, elements + 1, dtype=torch.float64)
    cuts = torch.tensor(bounds, dtype=torch.float64)[:, None]
    shared = torch.minimum(ends[1:], cuts[1:]) - torch.maximum(ends[:-1], cuts[:-1])
    return shared.clamp(min=0.0)
