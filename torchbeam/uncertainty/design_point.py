"""Design points: the likeliest places of a rare event, by the first-order reliability method."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .limit_state import LimitState

SAME = 0.1  # distance, in normal scores, at which two are one
AGAIN = 4  # times that as many starts are added, as long as a point is told by one alone
SHORTENED = 6  # halvings of a step that are tried at once
# largest distance, in normal scores, of a point from the ray along its gradient, and of its step
FIXED = 1e-4
# largest distance, in normal scores, that is looked at: a law's numbers overflow far out
FARTHEST = 45.0
FAR = 5.0  # distance, in normal scores, of random starts that are far out


@dataclass(frozen=True)
class DesignPoints:
    """Local minima of |z| on y(z) = threshold, the nearest first: z (k, d) normal scores, beta (k,)
    their distances (negative where the medians lie within the event), led (k,) how many starts led
    to each.
    """

    z: Tensor
    beta: Tensor
    led: Tensor

    @property
    def usual(self) -> bool:
        """Whether the medians lie within the event: it is more likely than not."""
        return self.beta[0].item() < 0


def all_design_points(limit: LimitState, starts: int, seed: int) -> DesignPoints:
    """Design points from random starts, and as many again as long as there is one that a single
    start led to: about as large a share of them leads to points that none has found (Good 1953).
    """
    d = limit.work.joint.dimension
    points = design_points(limit, random_starts(starts, d, seed))
    for again in range(1, AGAIN + 1):
        if (points.led > 1).all():
            break
        more = random_starts(starts, d, seed + again)[1:]
        points = design_points(limit, torch.cat((points.z.repeat_interleave(points.led, 0), more)))
    return points


def random_starts(starts: int, dimension: int, seed: int) -> Tensor:
    """Normal scores (starts, d): the medians, and random ones in pairs z, -z, of which one is where
    the other of two opposite branches is. Every other pair is far out, where a branch that is flat
    among usual values rises above the others.
    """
    draw = torch.Generator().manual_seed(seed)
    z = torch.randn(starts // 2, dimension, generator=draw, dtype=torch.float64)
    z[1::2] *= FAR / z[1::2].norm(dim=-1, keepdim=True)
    return torch.cat((z.new_zeros(1, dimension), torch.stack((z, -z), 1).flatten(0, 1)))[:starts]


def design_points(limit: LimitState, z: Tensor, steps: int = 60) -> DesignPoints:
    """Design points from several starts z (starts, d) at once, in normal scores.

    With g = threshold - y: z -> (grad g . z - g) grad g/|grad g|^2 (Hasofer and Lind 1974; Rackwitz
    and Fiessler 1978), of which so much is taken that |z|^2/2 + c |g| falls, c = (2 |z| + 10)/|grad
    g| (Zhang and Der Kiureghian 1995). Raises ValueError where no start ends at a point: y that
    does not depend on the parameters, never comes to the threshold, or is not smooth.
    """
    starts = len(z)
    leader = torch.arange(starts)  # the first start that is where a start is, whose way it goes
    y, slope = limit.gradient(z)
    ends = torch.zeros(starts, dtype=torch.bool)
    fractions = 0.5 ** torch.arange(SHORTENED, dtype=torch.float64)
    size = None
    for _ in range(steps):
        alone = leader == torch.arange(starts)
        together = (torch.cdist(z, z) <= SAME).tril(-1) & alone & alone[:, None]
        leader = torch.where(together.any(-1), together.double().argmax(-1), leader)
        g, steep = limit.threshold - y, slope.norm(dim=-1)
        usable = torch.isfinite(g) & (steep > 0) & torch.isfinite(steep)
        size = g.abs().nan_to_num(0, 0, 0).amax() if size is None else size
        target = (
            -((-slope * z).sum(-1) - g)[:, None] * slope / steep.clamp_min(1e-300).square()[:, None]
        )
        # the target of a flat y is beyond all numbers
        target = target * (FARTHEST / target.norm(dim=-1, keepdim=True)).clamp_max(1.0)
        towards = target - z
        near = towards.norm(dim=-1) <= FIXED
        ends = usable & near & (g.abs() <= FIXED * torch.maximum(steep, size * 1e-6))
        going = usable & ~ends & (leader == torch.arange(starts))
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
        blunt = "".join(
            f" (the law of {name!r} does not tell values more than 7 deviations up apart)"
            for name in limit.work.joint.without_tails[:1]
        )
        raise ValueError(
            f"no design point was found from {starts} starts in {steps} steps; a y that is smooth "
            f'and comes to the threshold is wanted{blunt}, or method="subset"'
        )
    beta = (z * slope / slope.norm(dim=-1, keepdim=True)).sum(-1)
    point = torch.full((starts,), -1)  # that a start led to
    distinct: list[int] = []
    for k in beta.abs().argsort().tolist():
        if ends[k] and leader[k] == k:
            same = [i for i, j in enumerate(distinct) if (z[k] - z[j]).norm() <= SAME]
            point[k] = same[0] if same else len(distinct)
            distinct += [] if same else [k]
    for _ in range(starts.bit_length()):
        leader = leader[leader]
    led = torch.bincount(point[leader] + 1, minlength=len(distinct) + 1)[1:]
    return DesignPoints(z[distinct], beta[distinct], led)
