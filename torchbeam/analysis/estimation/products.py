"""Products: of deviations of motion and parameters, the part of second order of what follows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...math.square_root import triangle
from .instruments import still
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
        """Of z and the readings at an interval's end, in this order; of sensors of several samples
        their mean.
        """
        p, rest, scene = unknowns.of_model, interval.model.state, interval.scene
        lead = interval.instruments.now(scene, rest, still(scene)).shape[:-1]
        steps = STEP * torch.eye(p).to(unknowns.start)
        at = torch.stack((steps, -steps)) + unknowns.start[:p]
        at = at.reshape(2, p, *[1] * len(lead), p).expand(2, p, *lead, p)
        standing = interval.standing(unknowns, at, at.shape[:-1], None)
        none = torch.zeros_like(unknowns.white)
        moved = interval.move(rest.broadcast(at.shape[:-1]), unknowns, at, none, None, standing)
        rows = torch.cat((moved.motion_by.motion, moved.readings_by.motion), -2)
        slopes = (rows[0] - rows[1]) / (2 * STEP)
        return cls(slopes.flatten(1, -3).mean(1) if lead else slopes)

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
