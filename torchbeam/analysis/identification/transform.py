"""Coordinates of the search for parameters: themselves, logarithms, or logits between bounds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

TRANSFORMS = (None, "log", "logit")


@dataclass(frozen=True)
class Transform:
    """theta = x, exp x, or low + (high - low) / (1 + exp -x), each parameter by its own.

    log, logit  (p,) bool: which;  low, high  (p,): bounds of the latter
    """

    log: Tensor
    logit: Tensor
    low: Tensor
    high: Tensor

    @property
    def additive(self) -> Tensor:
        """(p,) bool: coordinates whose zero means nothing: a change of 1 is large from anywhere."""
        return self.log | self.logit

    def theta(self, x: Tensor) -> Tensor:
        """Parameters (..., p) of coordinates."""
        zero = torch.zeros_like(x)
        theta = torch.where(self.log, torch.where(self.log, x, zero).exp(), x)
        share = torch.sigmoid(torch.where(self.logit, x, zero))
        return torch.where(self.logit, self.low + (self.high - self.low) * share, theta)

    def x(self, theta: Tensor) -> Tensor:
        """Coordinates (..., p) of parameters; infinite at the ends of what they can be."""
        one = torch.ones_like(theta)
        coordinates = torch.where(self.log, torch.where(self.log, theta, one).log(), theta)
        width = torch.where(self.logit, self.high - self.low, one)
        share = torch.where(self.logit, (theta - self.low) / width, 0.5 * one)
        return torch.where(self.logit, torch.logit(share), coordinates)

    def log_slope(self, x: Tensor) -> Tensor:
        """ln d theta / d x (..., p): by which densities of coordinates are those of theta."""
        zero = torch.zeros_like(x)
        logit = torch.where(self.logit, x, zero)
        width = torch.where(self.logit, self.high - self.low, torch.ones_like(x))
        sigmoid = torch.nn.functional.logsigmoid
        steep = width.log() + sigmoid(logit) + sigmoid(-logit)
        return torch.where(self.logit, steep, torch.where(self.log, x, zero))

    def slope(self, x: Tensor) -> Tensor:
        """d theta / d x (..., p)."""
        share = torch.sigmoid(x)
        slope = torch.where(self.log, self.theta(x), torch.ones_like(x))
        return torch.where(self.logit, (self.high - self.low) * share * (1 - share), slope)
