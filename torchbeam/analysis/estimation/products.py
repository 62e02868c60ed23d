"""Products: of deviations of motion and parameters, the part of second order of what follows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...math.square_root import triangle
from ...state.state import State
from .interval import Interval
from .unknowns import Unknowns

STEP = 1e-3  # of a parameter's coordinate, for a difference of derivatives


@dataclass(frozen=True)
class Products:
    """slopes (p, r, n): what each of p parameters adds to the derivatives by z of r numbers, of a
    motion about the linear model's own state
    """

    slopes: Tensor

    @classmethod
    def of(cls, interval: Interval, unknowns: Unknowns) -> Products:
        """Of z and the readings at an interval's end, in this order."""
        p = unknowns.of_model
        steps = STEP * torch.eye(p).to(unknowns.start)
        at = torch.stack((steps, -steps)) + unknowns.start[:p]
        state: State = interval.model.state.broadcast((2, p))
        standing = interval.standing(unknowns, at, (2, p), None)
        still = unknowns.white.new_zeros(len(unknowns.white))
        moved = interval.move(state, unknowns, at, still, None, standing)
        rows = torch.cat((moved.motion_by.motion, moved.readings_by.motion), -2)
        return cls((rows[0] - rows[1]) / (2 * STEP))

    def __call__(self, z: Tensor, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Mean (..., r) of what the products add, and rows (..., s, r) of independent sources of
        its deviations, where z (..., k, n) and parameters (..., k, p) follow from k sources: of a
        normal law, exactly its covariance (a sum of products of two sources).
        """
        p = parameters.shape[-1]
        root = triangle(torch.cat((parameters, z), -1))  # parameters follow from the first p
        own = torch.einsum("...ap,prn->...arn", root[..., :p, :p], self.slopes)
        pairs = torch.einsum("...arn,...bn->...abr", own, root[..., p:])
        square = pairs[..., :p, :].clone()
        both = square + square.transpose(-3, -2)
        upper = torch.ones(p, p).to(both).triu(1) + torch.eye(p).to(both) / 2**0.5
        rows = torch.cat((both * upper[..., None], pairs[..., p:, :]), -2)
        return square.diagonal(dim1=-3, dim2=-2).sum(-1), rows.flatten(-3, -2)
