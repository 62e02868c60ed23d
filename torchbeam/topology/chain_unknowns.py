"""Blocks of one element's matrix where something is held, for native code; see
`framework_unknowns`.
"""

from __future__ import annotations

from torch import Tensor

from .chain import Chain
from .framework_unknowns import masked as of_framework


def masked(order: int, free: Tensor, D: Tensor, *couplings: Tensor) -> tuple[Tensor, ...]:
    """See `framework_unknowns.masked`."""
    return of_framework(Chain(order, 1), free, D, *couplings)
