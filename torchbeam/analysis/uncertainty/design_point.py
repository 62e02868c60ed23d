"""Design points: the likeliest places of a rare event, by the first-order reliability method."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .limit_state import LimitState

SHORTENED = 6  # halvings of a step that are tried at once
# largest distance, in normal scores, of a point from the ray along its gradient, and of its step
FIXED = 1e-4


@dataclass(frozen=True)
class DesignPoints:
    """Local minima of |z| on y(z) = threshold, the nearest first: z (k, d) normal scores, beta (k,)
    their distances (negative where the medians lie within the event).
    """

    z: Tensor
    beta: Tensor

    @property
    def usual(self) -> bool:
        """Whether the medians lie within the event: it is more likely than not."""
        return self.beta[0].item() < 0


def design_points(limit: LimitState, starts: int, seed: int, steps: int = 60) -> DesignPoints:
    """Design points from several starts at once: the medians, and random ones.

    With g = threshold - y: z -> (grad g . z - g) grad g/|grad g|^2 (Hasofer and Lind 1974; Rackwitz
    and Fiessler 1978), of which so much is taken that |z|^2/2 + c |g| falls, c = (2 |z| + 10)/|grad
    g| (Zhang and Der Kiureghian 1995). Raises ValueError where no start ends at a point: y that
    does not depend on the parameters, never comes to the threshold, or is not smooth.
    """
    draw = torch.Generator().manual_seed(seed)
    z = torch.randn(starts, limit.work.joint.dimension, generator=draw, dtype=torch.float64)
    z[0] = 0
    y, slope = limit.gradient(z)
    ends = torch.zeros(starts, dtype=torch.bool)
    fractions = 0.5 ** torch.arange(SHORTENED, dtype=torch.float64)
    size = None
    for _ in range(steps):
        g, steep = limit.threshold - y, slope.norm(dim=-1)
        usable = torch.isfinite(g) & (steep > 0) & torch.isfinite(steep)
        size = g.abs().nan_to_num(0, 0, 0).amax() if size is None else size
        target = (
            -((-slope * z).sum(-1) - g)[:, None] * slope / steep.clamp_min(1e-300).square()[:, None]
        )
        towards = target - z
        near = towards.norm(dim=-1) <= FIXED
        ends = usable & near & (g.abs() <= FIXED * torch.maximum(steep, size * 1e-6))
        going = usable & ~ends
        if not going.any():
            break
        weight = (2 * z.norm(dim=-1) + 10) / steep.clamp_min(1e-300)
        trial = z[going, None] + fractions[:, None] * towards[going, None]
        value = limit(trial.flatten(0, 1)).reshape(trial.shape[:2])
        merit = trial.square().sum(-1) / 2 + weight[going, None] * (limit.threshold - value).abs()
        now = (z.square().sum(-1) / 2 + weight * g.abs())[going, None]
        better = torch.isfinite(value) & (merit < now)
        # none: the shortest
        first = torch.where(better.any(-1), better.double().argmax(-1), SHORTENED - 1)
        z = z.index_put((going,), trial[torch.arange(len(trial)), first])
        new = limit.gradient(z[going])
        y, slope = y.index_put((going,), new[0]), slope.index_put((going,), new[1])
    if not ends.any():
        blunt = limit.work.joint.without_tails
        also = (
            f" (the law of {blunt[0]!r} does not tell values more than 7 deviations up apart)"
            if blunt
            else ""
        )
        raise ValueError(
            f"no design point was found from {starts} starts in {steps} steps; a y that is "
            "smooth and comes to "
            f'the threshold is wanted{also}, or method="subset"'
        )
    z, slope = z[ends], slope[ends]
    beta = (z * slope / slope.norm(dim=-1, keepdim=True)).sum(-1)
    order = beta.abs().argsort()
    distinct: list[int] = []
    for k in order.tolist():
        if all((z[k] - z[j]).norm() > 0.1 for j in distinct):
            distinct.append(k)
    return DesignPoints(z[distinct], beta[distinct])
