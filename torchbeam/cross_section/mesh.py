"""Mesh of a cross-section: nodes, elements, and what each element is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.arguments import some
from ..core.validation import Value, as_tensor, axis_last, common_dtype, finite, refusal
from .elements import plain
from .material import Material

MEETING = 1e-9  # of the section's size: places that are one


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


def points_of(name: str, value: Value, least: int) -> Tensor:
    """(..., n, 2) m, y and z of `least` points or more, checked."""
    points = some(name, as_tensor(value, *common_dtype(value)))
    points = axis_last(name, finite(name, points), 2)
    if points.ndim < 2 or points.shape[-2] < least:
        raise refusal(f"{name} of shape {tuple(points.shape)}", f"(..., n, 2) of {least} or more")
    return points


def of_one_material(nodes: Tensor, cells: Tensor, material: Material, **symmetry: Any) -> Mesh:
    """A mesh of one material, whose axis 1 is x, 2 is y and 3 is z."""
    eye = torch.eye(3, dtype=nodes.dtype, device=nodes.device)[None]
    stiffness, density = material.stiffness[..., None, :, :], material.rho[..., None]
    return Mesh(nodes, cells.to(nodes.device), stiffness, density, eye, **symmetry)


def of_materials(nodes: Tensor, cells: Tensor, materials: list[Material], which: Tensor) -> Mesh:
    """A mesh of several, whose axis 1 is x, 2 is y and 3 is z. which: (e,) of each element."""
    mesh = of_one_material(nodes, cells, materials[0])
    if len(materials) == 1:
        return mesh
    which = which.to(nodes.device)
    stiffness = torch.stack(torch.broadcast_tensors(*(x.stiffness for x in materials)), -3)
    density = torch.stack(torch.broadcast_tensors(*(x.rho for x in materials)), -1)
    return replace(mesh, stiffness=stiffness[..., which, :, :], density=density[..., which])


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


def merged(nodes: Tensor, cells: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes and cells with one node for those that lie at one place."""
    number, first = meeting("walls", plain(nodes).reshape(-1, *nodes.shape[-2:]))
    cells = torch.from_numpy(number)[cells]
    in_one_piece("walls", plain(cells))
    return nodes[..., torch.from_numpy(first).to(nodes.device), :], cells


def meeting(name: str, every: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of points (samples, n, 2) the number (n,) of each one's place, and (m,) the first at each.
    Raises ValueError where points of the first sample that meet do not in another.
    """
    from scipy.spatial import cKDTree

    size = np.ptp(every[0], axis=0).max()
    pairs = cKDTree(every[0]).query_pairs(MEETING * size, output_type="ndarray")
    apart = np.abs(every[:, pairs[:, 0]] - every[:, pairs[:, 1]])
    if apart.max(initial=0.0) > 1e3 * MEETING * size:
        given = f"{name} that meet in some samples alone"
        raise refusal(given, "the same meetings in all", are=True)
    same = np.arange(every.shape[1])
    for a, b in sorted(pairs.tolist()):
        same[b] = same[a]
    first, number = np.unique(same, return_inverse=True)
    return number, first


def in_one_piece(name: str, cells: np.ndarray) -> None:
    """Raises ValueError where cells (e, k) of numbers are in parts that share none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, number = np.unique(cells, return_inverse=True)
    number = number.reshape(cells.shape)
    a, b = number[:, :-1].ravel(), number[:, 1:].ravel()
    parts, _ = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (len(used),) * 2), False)
    if parts > 1:
        raise refusal(f"{name} in {parts} parts", f"{name} that meet", are=True)
