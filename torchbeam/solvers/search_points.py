"""Points of a least-squares search: values, derivatives and prior where its starts are."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .region import Region


@dataclass
class Points:
    """Where starts are: x (N, p), residuals r (N, T), J (N, T, p); minus the logarithm of the prior
    phi (N,), its gradient and curvature slope, bend (N, p).
    """

    x: Tensor
    r: Tensor
    J: Tensor
    phi: Tensor
    slope: Tensor
    bend: Tensor

    def of(self, which: Tensor) -> Points:
        return Points(*(v[which] for v in vars(self).values()))

    def put(self, which: Tensor, moved: Points) -> None:
        """The starts `which` are where they have moved to."""
        self.x = self.x.index_put((which,), moved.x)  # anew: the history has the one before
        for name in ("r", "J", "phi", "slope", "bend"):
            getattr(self, name)[which] = getattr(moved, name)

    @property
    def objective(self) -> Tensor:
        """(N,) squares, with the prior's part."""
        return self.r.square().sum(-1) + 2 * self.phi

    @property
    def gradient(self) -> Tensor:
        """(N, p) of half the objective."""
        return (self.J.mT @ self.r[..., None])[..., 0] + self.slope

    def promised(self, step: Tensor) -> Tensor:
        """(N,) decrease of the objective by steps (N, p), were the model linear."""
        return -(
            (self.gradient * step).sum(-1) * 2
            + (self.J @ step[..., None])[..., 0].square().sum(-1)
            + (self.bend * step.square()).sum(-1)
        )


def carried(J: Tensor, r: Tensor, r_trial: Tensor, step: Tensor, region: Region) -> Tensor:
    """Broyden's update: J (N, T, p) changed as little as gives what the step gave, steps in the
    parameters' sizes.
    """
    size = torch.where(region.additive, 1.0, torch.where(region.size > 0, region.size, 1.0))
    scaled = step / size**2
    length = (step * scaled).sum(-1)
    off = r_trial - r - (J @ step[..., None])[..., 0]
    return J + off[..., None] * (scaled / torch.where(length > 0, length, 1)[:, None])[:, None]
