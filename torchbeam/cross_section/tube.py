"""Circular tube: nodes and cells of rings of quadrilaterals."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .mesh import grid

AROUND, THROUGH = 24, 3  # elements


def tube(outer: Tensor, inner: Tensor, fineness: int) -> tuple[Tensor, Tensor]:
    """Nodes (..., n, 2) m and cells between two radii (...) m, about the centre."""
    rings = THROUGH * fineness
    cells, i, j = grid(torch.ones(AROUND * fineness, rings, dtype=torch.bool), closed=True)
    i, j = i.to(outer), j.to(outer)
    share = j / (2 * rings)
    radius = outer[..., None] * share + inner[..., None] * (1 - share)
    turn = -math.pi * i / (AROUND * fineness)  # against the rings: elements are right-handed
    return radius[..., None] * torch.stack((torch.cos(turn), torch.sin(turn)), -1), cells
