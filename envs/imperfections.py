"""Imperfections: what lies between a controller and its beam, and may change with the episode.

latency  control intervals by which an action acts later than the task's delay, also fractions: over
         an interval in which one action gives way to the next their mean acts, by their times
lag      s, of the actuators: what acts follows what is asked by 1 - exp(-interval/lag) an interval
gain     of the actuators: what acts over what was asked
bias     standard deviation, in units of the observation, of a constant error of each entry of the
         sensors, drawn with the episode
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import ceil

import torch
from torch import Tensor

from .noise import normal
from .parameters import Parameter

# none is drawn by randomize=True, which is about the beam
PARAMETERS = {
    "latency": Parameter(0.0, 0.0, 0.0),
    "lag": Parameter(0.0, 0.0, 0.0),
    "gain": Parameter(1.0, 1.0, 1.0),
    "bias": Parameter(0.0, 0.0, 0.0),
}
BEFORE = -1  # the step of an episode whose random numbers are its bias


def spare(ranges: Mapping[str, tuple[float, float]]) -> int:
    """Intervals by which actions may be late."""
    return ceil(ranges["latency"][1]) if "latency" in ranges else 0


def late_action(queue: Tensor, latency: Tensor, spare: int) -> Tensor:
    """(n, a), of a queue (n, spare + ..., a), oldest first, whose entry `spare` acts now where
    latency (n,) is 0.
    """
    whole = latency.detach().floor().clamp(max=spare - 1)
    first = spare - whole.long()
    rows = torch.arange(len(queue), device=queue.device)
    part = (latency - whole)[:, None]
    return torch.lerp(queue[rows, first], queue[rows, first - 1], part)


def lagging(before: Tensor, asked: Tensor, lag: Tensor, interval: float) -> Tensor:
    """(n, a) what acts, from what acted before and what is asked (n, a)."""
    return torch.lerp(before, asked, _followed(lag, interval)[:, None])


def _followed(lag: Tensor, interval: float) -> Tensor:
    """(...) the share of what is asked that is reached in an interval."""
    follows = lag > 0
    share = 1 - torch.exp(-interval / torch.where(follows, lag, 1.0))
    return torch.where(follows, share, 1.0)


def acting(asked: Tensor, latency: Tensor, lag: Tensor, interval: float, spare: int) -> Tensor:
    """(..., a) what acts by all that was asked, (..., H + spare, a), the last first, of any samples
    at once and with derivatives by latency and lag (...): what `late_action`, then `lagging` make
    of it one after the other, where nothing acted before.
    """
    late = torch.arange(spare + 1).to(latency)
    hats = (1 - (latency[..., None] - late).abs()).clamp(min=0)
    arrived = (asked.unfold(-2, spare + 1, 1) * hats[..., None, None, :]).sum(-1)
    share = _followed(lag, interval)[..., None]
    weights = share * (1 - share) ** torch.arange(arrived.shape[-2]).to(share)
    return (weights[..., None] * arrived).sum(-2)


def acting_ahead(
    before: Tensor, queue: Tensor, latency: Tensor, lag: Tensor, interval: float, spare: int
) -> Tensor:
    """(n, T, a) what acts over the next T intervals by a queue (n, spare + T, a), oldest first, and
    by what acted last (n, a): what `late_action`, then `lagging` make of it one after the other.
    """
    if spare:
        late = torch.arange(spare, -1, -1).to(latency)
        hats = (1 - (latency[:, None] - late).abs()).clamp(min=0)[..., None, None]
        parts = (queue[:, k : queue.shape[1] - spare + k] for k in range(spare + 1))
        queue = torch.stack(
            [hat * part for hat, part in zip(hats.unbind(1), parts, strict=True)]
        ).sum(0)
    if not lag.ndim:
        return queue
    share, at = _followed(lag, interval)[:, None], torch.arange(queue.shape[1]).to(lag)
    passed = at[:, None] - at
    left = (1 - share[..., None]) ** passed.clamp(min=0)
    weights = torch.where(passed >= 0, share[..., None] * left, 0.0)
    return weights @ queue + ((1 - share) ** (at + 1))[..., None] * before[:, None]


def erroneous(seen: Tensor, noise: float, bias: Tensor, key: Tensor, steps: Tensor) -> Tensor:
    """Readings (n, o) at their steps (n,), with white noise of this standard deviation and constant
    errors of that of `bias` (n,), () = none.
    """
    at = [steps] * bool(noise) + [torch.full_like(key, BEFORE)] * bool(bias.ndim)
    if not at:
        return seen
    errors = [*normal(key, torch.stack(at), seen.shape[-1], seen.dtype)]
    if noise:
        seen = seen + noise * errors[0]
    return seen + bias[:, None] * errors[-1] if bias.ndim else seen


def beside_the_beam(names: Collection[str]) -> bool:
    """Whether all of these are parameters of this kind."""
    return all(name in PARAMETERS for name in names)
