"""Limit state of a rare event in the space of normal scores: y of a function, there and its gradient."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Executor
from dataclasses import dataclass, field

import torch
from torch import Tensor

from .evaluation import Function, evaluated, split
from .joint_law import JointLaw
from .samples import FAILED, reasons_of

STEP = 1e-4  # of a normal score, for central differences


@dataclass
class LimitState:
    """y of a function at normal scores z (N, d): the event is y > threshold. Counts evaluations, and failures by reason."""

    function: Function
    joint: JointLaw
    threshold: float
    dtype: torch.dtype
    chunk: int
    by_name: bool = False
    executor: Executor | None = None
    evaluations: int = 0
    failures: Counter = field(default_factory=Counter)

    def __call__(self, z: Tensor) -> Tensor:
        """y (N,) float64; -inf where the sample failed: it is not counted as the event."""
        jobs = [(self.function, self.joint, part, self.dtype, self.by_name) for part in z.split(self.chunk)]
        if self.executor is None:
            parts = [_values(*job) for job in jobs]
        else:
            parts = [future.result() for future in [self.executor.submit(_values, *job) for job in jobs]]
        y, status = (torch.cat(part) for part in zip(*parts, strict=True))
        self.evaluations += len(z)
        self.failures.update(reasons_of(y, status, {}))
        return torch.where(status == 0, y, -torch.inf)

    def gradient(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """y (N,) and dy/dz (N, d): by reverse mode, or by central differences where y carries no gradient by z."""
        z = z.detach().requires_grad_()
        theta = self.joint.of_score(z).to(self.dtype)
        y, status = split(self.function(**self.joint.named(theta)) if self.by_name else self.function(theta), len(z))
        self.evaluations += len(z)
        y = _one_number(y)
        status = torch.where((status.to(y.device) == 0) & ~torch.isfinite(y), FAILED, status.to(y.device))
        self.failures.update(reasons_of(y.detach().cpu(), status.cpu(), {}))
        value = torch.where(status == 0, y.detach(), -torch.inf).cpu().double()
        slope, = torch.autograd.grad(torch.where(status == 0, y, 0).sum(), z, allow_unused=True) if y.requires_grad else (None,)
        if slope is not None:
            return value, slope.double()
        at = z.detach()
        steps = STEP * torch.cat((torch.eye(at.shape[1]), -torch.eye(at.shape[1]))).double()
        beside = self((at[:, None] + steps).flatten(0, 1)).reshape(len(at), 2, -1)
        return value, (beside[:, 0] - beside[:, 1]) / (2 * STEP)


def _values(function: Function, joint: JointLaw, z: Tensor, dtype: torch.dtype, by_name: bool) -> tuple[Tensor, Tensor]:
    theta = joint.of_score(z).to(dtype)
    y, status = evaluated(function, joint.named(theta) if by_name else theta, len(z), by_name)
    return _one_number(y).double(), status


def _one_number(y: Tensor) -> Tensor:
    if y.ndim > 2 or (y.ndim == 2 and y.shape[1] != 1):
        raise ValueError(f"a function that gave y {tuple(y.shape)} was given for a rare event; one number a sample, "
                         f"({len(y)},), is wanted")
    return y.reshape(len(y))
