"""What elements are, by their order: how many nodes one has, how it interpolates between them, and
where its stations are. What depends on the order asks this table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from .quadratic import X


class ElementShape(NamedTuple):
    """nodes of an element; midside: whether one of these is inside it; stations: places x in
    [-1, 1] at which stress is told; values(x (points,)): N_i (points, nodes).
    """

    nodes: int
    midside: bool
    stations: tuple[float, ...]
    values: Callable[[Tensor], Tensor]


def _linear(x: Tensor) -> Tensor:
    return torch.stack(((1 - x) / 2, (1 + x) / 2), -1)


def _quadratic(x: Tensor) -> Tensor:
    return torch.stack((x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2), -1)


SHAPES = {1: ElementShape(2, False, (0.0,), _linear), 2: ElementShape(3, True, (-X, X), _quadratic)}
