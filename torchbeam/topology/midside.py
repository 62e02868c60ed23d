"""Static condensation of one element's midside node, for native code; see `midside_nodes`."""

from __future__ import annotations

from torch import Tensor

from .chain import Chain
from .midside_nodes import Midside, following
from .midside_nodes import condensed as of_framework

__all__ = ["condensed", "following"]


def condensed(
    D: Tensor, L: Tensor, U: Tensor, far_U: Tensor, far_L: Tensor
) -> tuple[Tensor, Tensor, Tensor, Midside]:
    """D, L, U of the end nodes, and what leads back."""
    D, U, L, midside = of_framework(Chain(2, 1), D, U, L, far_U, far_L)
    return D, L, U, midside
