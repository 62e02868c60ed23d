"""Modal start: a structure that may swing in its slowest modes before it is first read."""

from __future__ import annotations

import torch
from torch import Tensor

from ...linear.linear_model import Linear

RIGID = 1e-6  # of the largest frequency: a mode without stiffness
TURNS = 1e-6  # m a rad: of a mode that moves no node


def modal_root(model: Linear, amplitude: float, modes: int) -> Tensor:
    """(2 modes, n): a square root of z's covariance, where the slowest mode has an amplitude of
    this deviation (m, of the node that it moves most; rad where it moves none), and the others the
    same mean energy in free vibration; rigid modes have this deviation too, and rest.

    Raises ValueError for a model whose modes are not those of mass and stiffness.
    """
    small, w = model.reduced(modes), model.space.unknowns
    eye = torch.eye(modes).to(small.A)
    if not torch.allclose(small.A[:modes], torch.cat((0 * eye, eye), 1), atol=1e-6):
        raise ValueError(
            "amplitude was given for a model whose modes are not those of a symmetric mass and "
            "stiffness; a covariance of z is wanted"
        )
    nodes, p = small.moves.shape[-2] // (2 * w), model.space.dims.position
    shapes = small.moves[: w * nodes, :modes].unflatten(0, (nodes, w))
    moved, turned = (part.norm(dim=1).amax(0) for part in shapes.split((p, w - p), 1))
    deviation = amplitude / moved.where(moved > TURNS * turned, turned)
    rate = (-small.A[modes:, :modes].diagonal()).clamp(min=0).sqrt()
    elastic = rate > RIGID * rate.max()
    speed = deviation[elastic][:1] * rate[elastic][:1]  # of amplitudes that are normalised by mass
    both = torch.cat(
        (torch.where(elastic, speed / rate, deviation), torch.where(elastic, speed, 0.0))
    )
    return both[:, None] * (model.reads @ small.moves).mT
