"""Controllers of TipReach: (observation (n, 17), hold (n, 2)) -> action (n, 2). `hold` is the
action that holds the target in static equilibrium; every controller but `nothing` is given it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..baselines.holding import pd

GAP, VELOCITY = [1, 2], [7, 8]  # y and z in the observation: target - tip, tip velocity
MIDDLE = [13, 14]  # mid-span velocity
# the network's gains on the (scaled) tip velocity before learning: light damping
START = [-0.4, -0.1]
PENDING = [15, 16]  # the action that is still to act
# observations to about one
SCALE = [4.0, 4.0, 10.0, 4.0, 4.0, 10.0, 2.0, 2.0, 5.0, 8.0, 8.0, 20.0, 4.0, 4.0, 10.0, 1.0, 1.0]


def nothing(observation: Tensor, hold: Tensor) -> Tensor:
    """No force."""
    return torch.zeros_like(hold)


def static(observation: Tensor, hold: Tensor) -> Tensor:
    """The force that holds the target in equilibrium, all the time."""
    return hold


@dataclass(frozen=True)
class PD:
    """hold + p * (target - tip) - d * tip velocity, each along y and z; gains (n or 1, 4): p_y,
    d_y, p_z, d_z.
    """

    gains: Tensor

    def __call__(self, observation: Tensor, hold: Tensor) -> Tensor:
        return pd(self.gains, observation[:, GAP], observation[:, VELOCITY], hold)


class Policy(nn.Module):
    """tanh(atanh(hold) + G e): feedback on e = (target - tip, tip velocity, mid-span velocity,
    pending action - hold) along y and z, whose gains G (2, 8) a small network reads off the
    observation and `hold`. At rest on the target it gives `hold`, whatever was learned; before
    learning it is `hold` with light damping.
    """

    def __init__(self, hidden: int = 64) -> None:
        super().__init__()
        self.gains = nn.Sequential(
            nn.Linear(19, hidden),
            nn.Tanh(),
            nn.Linear(hidden, hidden),
            nn.Tanh(),
            nn.Linear(hidden, 16),
        )
        self.register_buffer("scale", torch.tensor(SCALE))
        self.double()
        nn.init.zeros_(self.gains[-1].weight)
        nn.init.zeros_(self.gains[-1].bias)
        with torch.no_grad():
            self.gains[-1].bias.unflatten(0, (2, 8)).diagonal(2).copy_(torch.tensor(START))

    def forward(self, observation: Tensor, hold: Tensor) -> Tensor:
        x = observation * self.scale
        G = self.gains(torch.cat((x, hold), -1)).unflatten(-1, (2, 8))
        e = torch.cat((x[:, GAP + VELOCITY + MIDDLE], observation[:, PENDING] - hold), -1)
        return torch.tanh(torch.atanh(hold) + (G @ e[..., None])[..., 0])
