"""Point masses: rigid bodies at nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...core.declared import own, plain
from ...core.leaves import leaf
from ...core.validation import (
    ROUNDING,
    Value,
    axis_last,
    concrete,
    finite,
    numbers,
    positive,
    refusal,
)
from ...core.validation import inertia as check_inertia
from ...math.block_matrices import of_blocks
from ...math.quaternions import skew
from ..parts import Place
from .effect import Effect
from .loads import at_offset


@dataclass(frozen=True)
class PointMass(Effect):
    """A rigid body at a node.

    Args:
        mass: (...) kg; or the 6x6 mass matrix (..., 6, 6) about the node, [velocity; spin], section
            axes, without inertia and offset
        inertia: kg m^2, section axes: (..., 3) principal or (..., 3, 3) moments about its own
            centre; None = a point. A sequence of three has principal moments. A tensor whose shape
            ends in (3, 3) has matrices; principal moments of three bodies in one tensor go by
            `torch.diag_embed`
        offset: (..., 3) m of its centre from the node, section axes; None = at the node. On a body,
            node = (name, point in its axes) says the same
        node: counts from the root, -1 is the tip

    It has weight if the scene has `Gravity`. After construction mass is (...), offset (..., 3) or
    None, inertia (..., 3, 3) or None, whichever way they were given.

    Raises:
        ValueError: for a negative mass, an asymmetric inertia, or an impossible one (a principal
            moment that is negative or above the sum of the others). For a 6x6 matrix that no rigid
            body has (a mass that depends on the direction).

    Examples:
        >>> tipped = tb.Scene(beam, [tb.PointMass(0.1)])  # kg, at the tip
        >>> tb.modes(tipped, count=1).frequency < tb.modes(tb.Scene(beam), count=1).frequency
        tensor([True])
    """

    mass: Value = leaf(0)
    inertia: Value | None = leaf(2, default=None)
    offset: Value | None = leaf(1, default=None, size=3)
    node: Place = -1

    kind = "inertia"

    def __post_init__(self) -> None:
        at_offset(self)
        super().__post_init__()
        mass, offset = plain(self.mass), self.offset
        inertia = None if self.inertia is None else plain(self.inertia)
        if mass.ndim >= 2 and mass.shape[-2:] == (6, 6):
            if inertia is not None or offset is not None:
                raise ValueError(
                    "PointMass with a 6x6 mass and an inertia or offset was given; the matrix "
                    "holds them"
                )
            mass, inertia, offset = _rigid_body(mass)
        positive("PointMass's mass", torch.as_tensor(mass), zero=True)
        if inertia is not None:
            axis_last("PointMass's inertia", inertia, 3)
            several = isinstance(self.inertia, (list, tuple))
            flat = several and not isinstance(self.inertia[0], (list, tuple))
            if flat or inertia.ndim < 2 or inertia.shape[-2] != 3:
                tensor = isinstance(inertia, Tensor)
                inertia = torch.diag_embed(inertia) if tensor else inertia[..., None] * np.eye(3)
            J, m = torch.as_tensor(inertia), torch.as_tensor(mass)
            arm = torch.zeros(()) if offset is None else torch.as_tensor(offset).square().sum(-1)
            _check_inertia(J, m.detach() * arm.detach())
        # its own: a model's inertia is of these
        held = dict(mass=mass, inertia=inertia, offset=offset)
        vars(self).update({k: None if value is None else own(value) for k, value in held.items()})

    @property
    def about_node(self) -> Tensor:
        """The 6x6 mass (..., 6, 6) about the node, section axes: with ~c of the offset,
        [[m I, -m ~c], [m ~c, J - m ~c ~c]].
        """
        m = self.mass[..., None, None]
        eye = torch.eye(3, dtype=m.dtype, device=m.device)
        c = torch.zeros_like(eye) if self.offset is None else skew(self.offset)
        J = torch.zeros_like(eye) if self.inertia is None else self.inertia
        mI, mc, J = torch.broadcast_tensors(m * eye, m * c, J - m * (c @ c))
        return of_blocks(mI, -mc, mc, J)


def _check_inertia(J: Tensor, moved: Tensor) -> None:
    """J (..., 3, 3) about the centre; `moved` (...) mass times offset^2."""
    finite("PointMass's inertia", J)
    size = J.detach().abs().amax((-1, -2), keepdim=True)
    if concrete((J - J.mT).abs() > ROUNDING * size).any():
        raise ValueError(
            "a PointMass's inertia that is not symmetric was given; moments of inertia are "
            "symmetric"
        )
    check_inertia("a PointMass's inertia", J, size[..., 0, 0] + moved.to(J))


def _rigid_body(matrix: Tensor | np.ndarray) -> tuple:
    """(mass, inertia about the centre, offset) of a 6x6 mass about the node."""
    M = torch.as_tensor(matrix)
    finite("PointMass's mass", M)
    m = M[..., 0, 0]
    size = M.detach().abs().amax((-1, -2), keepdim=True)
    eye = torch.eye(3, dtype=M.dtype, device=M.device)
    mc = (M[..., 3:, :3] - M[..., 3:, :3].mT) / 2  # m ~c
    c = (
        torch.stack((mc[..., 2, 1], mc[..., 0, 2], mc[..., 1, 0]), -1)
        / torch.where(m > 0, m, torch.ones_like(m))[..., None]
    )
    J = M[..., 3:, 3:] + m[..., None, None] * skew(c) @ skew(c)
    body = torch.cat(
        (torch.cat((m[..., None, None] * eye, -mc), -1), torch.cat((mc, M[..., 3:, 3:]), -1)), -2
    )
    if concrete((body - M).abs() > ROUNDING * size).any():
        raise refusal("a PointMass's 6x6 mass that no rigid body has", "[[m I, -m ~c], [m ~c, J]]")
    body = m, J, c
    return body if isinstance(matrix, Tensor) else tuple(numbers(x.tolist()) for x in body)
