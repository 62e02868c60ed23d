"""Smoothness: a prior of a parameter field, as rows of Tikhonov regularisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.arguments import boolean
from ...core.validation import Value, as_tensor, finite, increasing, refusal, shown


@dataclass(frozen=True, eq=False)
class Smoothness:
    """Prior of a smooth field of n numbers: its derivative of some order is normally distributed
    about zero (Tikhonov 1963).

    Args:
        order: of the derivative: 0, the field is near its start; 1, near a constant; 2, near a
            straight line. Orders 1 and 2 need data that determine this constant, or line
        sharp: large derivatives are rare but not excluded: Student's t with one degree of freedom
            in place of the normal law, by reweighting (Lange, Little and Taylor 1989, JASA 84,
            881). For dents and steps, which a normal law would smear
        at: (n,) places of the numbers, increasing (arc length, time); None = evenly spaced. Only
            their proportions count

    The penalty is weight / 2 times the integral of the squared derivative over places from 0 to 1.
    The derivative is that of theta, or of log theta for a search by the logarithm.

    Examples:
        >>> x = torch.linspace(0, 3, 20)
        >>> found = tb.identify_fields(
        ...     lambda p: p["f"],
        ...     torch.sin(x),
        ...     {"f": torch.zeros(20)},
        ...     {"f": tb.Smoothness(order=2)},
        ...     sigma=0.05,
        ... )
        >>> found.fit.theta.shape
        torch.Size([20])
    """

    order: int = 1
    at: Value | None = None
    sharp: bool = False

    def __post_init__(self) -> None:
        if type(self.order) is not int or self.order not in (0, 1, 2):
            raise refusal(f"order = {shown(self.order)}", "0, 1 or 2")
        boolean("sharp", self.sharp)
        if self.at is not None:
            finite("at", as_tensor(self.at, torch.float64))

    def rows(self, like: Tensor) -> Tensor:
        """(n - order, n) for a field `like` (n,). ValueError for too few numbers, other places."""
        n = len(like)
        if n < self.order + 2:
            raise ValueError(
                f"smoothness of order {self.order} was given for a field of {n} numbers; "
                f"{self.order + 2} or more are wanted"
            )
        if self.at is None:
            at = torch.linspace(0, 1, n, dtype=like.dtype, device=like.device)
        else:
            at = increasing("at", as_tensor(self.at, like.dtype, like.device))
            if at.shape != (n,):
                raise ValueError(
                    f"places of shape {tuple(at.shape)} were given for a field of {n} numbers; "
                    f"({n},) are wanted"
                )
            at = (at - at[0]) / (at[-1] - at[0])
        operator = torch.eye(n).to(like)
        # about each place
        width = torch.cat((at[1:2] - at[:1], (at[2:] - at[:-2]) / 2, at[-1:] - at[-2:-1]))
        for _ in range(self.order):
            width = at.diff()
            operator = operator.diff(dim=0) / width[:, None]
            at = (at[1:] + at[:-1]) / 2
        return operator * width.sqrt()[:, None]

    @staticmethod
    def factors(squares: Tensor) -> Tensor:
        """(rows,) by which rows count where they are `sharp`, from their squares over the prior's
        variance: (n + 1) / (n + d^2) of Student's t with n = 1, so that those of the prior's own
        size count as they are.
        """
        return 2 / (1 + squares)


@dataclass(frozen=True, eq=False)
class SmoothnessRows:
    """Model of one field's smoothness: rows L (rows, n) times the field, or its logarithm. It reads
    no data, but a prior's.
    """

    name: str
    L: Tensor
    log: bool

    def of(self, field: Tensor) -> Tensor:
        """(..., rows) of a field (..., n)."""
        return (field.log() if self.log else field) @ self.L.mT

    def __call__(self, theta: Mapping[str, Tensor]) -> Tensor:
        return self.of(theta[self.name])
