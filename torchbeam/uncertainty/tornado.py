"""Tornado table: what y does when one parameter after the other goes from low to high."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate

import torch
from torch import Tensor

from ..core.arguments import boolean, level_of
from ..core.warning import warn
from ..math.distributions import normal_score
from .called import Function, evaluated
from .evaluation import settings
from .joint_law import JointLaw
from .laws import Law


@dataclass(frozen=True)
class Tornado:
    """Values y (...) with a parameter at its low or high quantile and the others at their medians.
    `names` has the laws, the largest swing (of the largest number of y) first.

    Attributes:
        base: (...) with all parameters at their medians
        low, high: (p, ...) the parameter at its low and its high quantile
        at: (p, 2) the two quantiles (NaN for a field)
        swing: (p, ...) |high - low|
        status: (2 p + 1,) of the base, then of low and high in turns, in the order of evaluation

    Examples:
        >>> table = tb.tornado(deflection, laws, by_name=True)
        >>> table.names, table.low.shape
        (('EI', 'P'), torch.Size([2]))
    """

    names: tuple[str, ...]
    base: Tensor
    low: Tensor
    high: Tensor
    at: Tensor
    status: Tensor

    @property
    def swing(self) -> Tensor:
        return (self.high - self.low).abs()

    def rows(self) -> list[tuple[str, float, float, float, float]]:
        """name, low and high of the parameter, low and high of y: of a y that is one number."""
        if self.base.numel() != 1:
            raise ValueError(
                f"the rows of a y {tuple(self.base.shape)} were asked for; one number is wanted"
            )
        columns = zip(self.names, self.at.tolist(), self.low, self.high, strict=True)
        return [(name, *at, a.item(), b.item()) for name, at, a, b in columns]

    def __repr__(self) -> str:
        return (
            f"Tornado({len(self.names)} laws, the largest swing that of {self.names[0]}; y "
            f"{tuple(self.base.shape)})"
        )


def tornado(
    function: Function,
    laws: Mapping[str, Law],
    *,
    level: float = 0.9,
    dtype: torch.dtype | None = None,
    by_name: bool = False,
) -> Tornado:
    """Effect of each parameter by itself, from its (1 - level)/2 to its (1 + level)/2 quantile, in
    a batch of 2 p + 1 samples.

    Args:
        function, laws, dtype, by_name: as in `monte_carlo`. A `RandomField` moves as a whole, by
            its first term

    It is a screening, not a share of the variance: interactions do not show. Failed samples are
    NaN.

    Raises:
        ValueError: as `monte_carlo`.

    Examples:
        >>> print(tb.tornado(deflection, laws, by_name=True))
        Tornado(2 laws, the largest swing that of EI; y ())
    """
    joint, level = JointLaw.of(laws), level_of("level", level)
    boolean("by_name", by_name)
    dtype = settings(function, 1, 0, 1, None, dtype, None)[-1]
    names = list(random := joint.random())
    firsts = [0, *accumulate(random.values())]  # variates of each: a constant has none
    z = torch.zeros(2 * len(names) + 1, joint.dimension, dtype=torch.float64)
    far = normal_score(torch.tensor((1 + level) / 2, dtype=torch.float64))
    for k in range(len(names)):
        z[1 + 2 * k, firsts[k]], z[2 + 2 * k, firsts[k]] = -far, far
    theta = joint.of_score(z).to(dtype)
    y, status, doubt = evaluated(function, joint, theta, by_name)
    if doubt:
        warn(doubt)
    y = torch.where((status == 0).reshape(-1, *[1] * (y.ndim - 1)), y.double(), torch.nan)
    values = joint.named(theta.double())
    none = torch.full((2,), torch.nan, dtype=torch.float64)  # of a field
    at = [
        none if joint.sizes[name] is not None else values[name][1 + 2 * k : 3 + 2 * k]
        for k, name in enumerate(names)
    ]
    low, high = y[1::2], y[2::2]
    size = (high - low).abs().reshape(len(names), -1).nan_to_num(torch.inf).amax(-1)
    order = size.argsort(descending=True, stable=True)
    ordered = tuple(names[k] for k in order.tolist())
    return Tornado(ordered, y[0], low[order], high[order], torch.stack(at)[order], status)
