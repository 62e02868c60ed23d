"""Mesh of a cross-section: nodes, elements, and what each element is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .material import Material


@dataclass(frozen=True)
class Mesh:
    """Elements of a cross-section.

    Args:
        nodes: (..., n, 2) m, y and z
        cells: (e, 9) numbers of the nodes of quadrilaterals, or (e, 6) of triangles, see `rule`
        stiffness: (..., e or 1, 6, 6) Pa, strains to stresses 11 22 33 23 13 12 in section axes
        density: (..., e or 1) kg/m^3
        axes: (..., e or 1, 3, 3) the material's axes as columns, in section axes
        coupled, offset: whether the section's stiffness has more than its diagonal, and whether its
            centre of mass is off the origin: False where symmetry says so
    """

    nodes: Tensor
    cells: Tensor
    stiffness: Tensor
    density: Tensor
    axes: Tensor
    coupled: bool = True
    offset: bool = True


def of_one_material(nodes: Tensor, cells: Tensor, material: Material, **symmetry: Any) -> Mesh:
    """A mesh of one material, whose axis 1 is x, 2 is y and 3 is z."""
    eye = torch.eye(3, dtype=nodes.dtype, device=nodes.device)[None]
    stiffness, density = material.stiffness[..., None, :, :], material.rho[..., None]
    return Mesh(nodes, cells.to(nodes.device), stiffness, density, eye, **symmetry)


def ply_axes(angle: Tensor, tangent: Tensor) -> Tensor:
    """(..., 3, 3) axes of a ply as columns: turned by `angle` (...) rad from x towards the wall's
    `tangent` (..., 2), about the normal x cross tangent.
    """
    c, s = torch.cos(angle), torch.sin(angle)
    y, z = tangent.unbind(-1)
    c, s, y, z = torch.broadcast_tensors(c, s, y, z)
    rows = (c, -s, 0 * c, s * y, c * y, -z, s * z, c * z, y)
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def grid(present: Tensor, closed: bool = False) -> tuple[Tensor, Tensor, Tensor]:
    """Cells (e, 9) of a grid of quadrilaterals of which `present` (rows, columns) exist, and the
    row and column (n,) of each node among the grid's lines, mid lines counted.

    closed: the last row of lines is the first again.
    """
    rows, columns = present.shape
    height = 2 * rows + (0 if closed else 1)
    width = 2 * columns + 1
    i, j = present.nonzero().unbind(-1)
    a = torch.arange(3)
    line = (2 * i[:, None, None] + a[:, None]) % height
    number = line * width + 2 * j[:, None, None] + a
    used, cells = torch.unique(number, return_inverse=True)
    return cells.reshape(-1, 9), used // width, used % width


def with_middles(x: Tensor) -> Tensor:
    """(..., 2 n + 1) of (..., n + 1): the means of neighbours between them."""
    middle = (x[..., 1:] + x[..., :-1]) / 2
    return torch.cat((torch.stack((x[..., :-1], middle), -1).flatten(-2), x[..., -1:]), -1)
