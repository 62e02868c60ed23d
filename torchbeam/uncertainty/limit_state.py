"""Limit state of a rare event: y of a function, and its gradient, by normal scores."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from .called import called
from .designs import Scores
from .evaluation import Evaluation
from .samples import reasons_of

STEP = 1e-4  # of a normal score, for central differences
# of a derivative along a line, by which the one that is carried may differ from the difference
CARRIED = 0.1


@dataclass
class LimitState:
    """y of a function at normal scores z (N, d): the event is y > threshold. Counts evaluations,
    and failures by reason.

    work  the function, its laws and how it is evaluated; z take the place of the design
    """

    work: Evaluation
    threshold: float
    evaluations: int = 0
    failures: Counter = field(default_factory=Counter)
    reverse: bool | None = None  # whether gradients are those that y carries; None = not known yet

    def __call__(self, z: Tensor, failed: float = -torch.inf) -> Tensor:
        """y (N,) float64; `failed` where the sample failed: -inf is no event, inf is one."""
        parts = [
            (_one_number(y).double(), status)
            for _, y, status in replace(self.work, design=Scores(z)).chunks(0, len(z))
        ]
        y, status = (torch.cat(part) for part in zip(*parts, strict=True))
        self.evaluations += len(z)
        self.failures.update(reasons_of(y, status, {}))
        return torch.where(status == 0, y, failed)

    def gradient(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """y (N,) and dy/dz (N, d): by reverse mode, or by central differences where y carries no
        gradient by z, or one that is not that of y at the first z: a law or a function that
        computes with NumPy carries none by some of them.
        """
        z = z.detach()
        if self.reverse is False:
            return self(z), self._differences(z)
        at, work = z.clone().requires_grad_(), self.work
        y, status, _ = called(
            work.function, work.joint, work.joint.of_score(at).to(work.dtype), work.by_name
        )
        self.evaluations += len(z)
        y = _one_number(y)
        self.failures.update(reasons_of(y.detach().cpu(), status.cpu(), {}))
        value = torch.where(status == 0, y.detach(), -torch.inf).cpu().double()
        (slope,) = (
            torch.autograd.grad(torch.where(status == 0, y, 0).sum(), at, allow_unused=True)
            if y.requires_grad
            else (None,)
        )
        if self.reverse is None:
            self.reverse = slope is not None and self._agrees(z, slope)
        return value, slope.double() if self.reverse else self._differences(z)

    def _agrees(self, z: Tensor, slope: Tensor) -> bool:
        """Whether slopes (N, d) at z are those of y, along a line through each."""
        draw = torch.Generator().manual_seed(0)
        line = torch.randn(z.shape, generator=draw, dtype=z.dtype)
        more, less = self(torch.cat((z + STEP * line, z - STEP * line))).chunk(2)
        carried, seen = (slope * line).sum(-1), (more - less) / (2 * STEP)
        size = torch.maximum(carried.abs(), seen.abs())
        return bool(((carried - seen).abs() <= CARRIED * size)[torch.isfinite(seen)].all())

    def _differences(self, z: Tensor) -> Tensor:
        steps = STEP * torch.cat((torch.eye(z.shape[1]), -torch.eye(z.shape[1]))).double()
        beside = self((z[:, None] + steps).flatten(0, 1)).reshape(len(z), 2, -1)
        return (beside[:, 0] - beside[:, 1]) / (2 * STEP)


def _one_number(y: Tensor) -> Tensor:
    if y.ndim > 2 or (y.ndim == 2 and y.shape[1] != 1):
        raise ValueError(
            f"a function that gave y {tuple(y.shape)} was given for a rare event; one number a "
            f"sample, ({len(y)},), is wanted"
        )
    return y.reshape(len(y))
