"""Section axes along a beam at rest: from directions, of nodes and between them."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.validation import concrete, positive, refusal, rotations
from ..math import quaternions as quat
from ..math.element_shapes import at_points, threes
from .curve import transported

# cosine between a beam and frame a's z, from which on its z axis is looked for elsewhere
STEEP = 0.99
PARALLEL = 1e-6  # sine between two directions, up to which they are one
HALF_WAY = 0.5  # of an element's chord: twice as far may its midside node be off the middle


def axes_along(direction: Tensor, up: Tensor | None) -> Tensor:
    """Columns x along `direction`, z along `up` made square to it, y = z x x: (..., 3, 3).
    None = frame a's z (y, where `direction` is along z itself).

    Raises ValueError where `up` is parallel to `direction` or either is zero.
    """
    length = positive(
        "the length of direction", torch.linalg.vector_norm(direction, dim=-1, keepdim=True)
    )
    x = direction / length
    if up is None:
        y, z = x.new_tensor([0.0, 1, 0]), x.new_tensor([0.0, 0, 1])
        flat = torch.linalg.vector_norm(x[..., :2], dim=-1, keepdim=True)
        up = torch.where(flat <= PARALLEL, y, z)
    x, up = torch.broadcast_tensors(x, up)
    across = up - (up * x).sum(-1, keepdim=True) * x
    size = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    if concrete(size <= PARALLEL * torch.linalg.vector_norm(up, dim=-1, keepdim=True)).any():
        raise refusal("an up vector parallel to the beam's direction", "one that leaves it")
    z = across / size
    return torch.stack((x, torch.linalg.cross(z, x), z), -1)


def carried_along(direction: Tensor, length: Tensor, up: Tensor | None) -> Tensor:
    """Quaternions (..., n, 4) of axes along successive directions (..., n, 3) of that length,
    carried from each to the next without twist, by the smallest rotation; z of the first is `up`
    (..., 3) made square to it. None = frame a's z (y, where it runs along z). Whoever turns
    directions and `up` turns the axes; in a plane that one of y and z is across from, it stays so.
    """
    along = direction / length[..., None]
    first = along[..., 0, :]
    if up is None:
        y, z = first.new_tensor([0.0, 1, 0]), first.new_tensor([0.0, 0, 1])
        up = torch.where(first[..., 2:].abs() > STEEP, y, z)
    return quat.multiply(transported(along), quat.from_matrix(axes_along(first, up))[..., None, :])


def orthonormal(frames: Tensor, *counts: int) -> Tensor:
    """`frames` (..., n, 3, 3), n one of `counts`, if they are rotations; ValueError otherwise."""
    if frames.ndim < 3 or frames.shape[-3] not in counts or frames.shape[-2:] != (3, 3):
        wanted = " or ".join(f"(..., {n}, 3, 3)" for n in counts)
        raise refusal(f"frames of shape {tuple(frames.shape)}", wanted, were=True)
    return rotations("frames", frames)


def axes_of_nodes(elements: Tensor) -> Tensor:
    """Axes of the nodes (..., N+1, 4), half way between those of the neighbouring elements
    (..., N, 4); those of the end elements at the ends.
    """
    inner = quat.half_way(elements[..., :-1, :], elements[..., 1:, :])
    return torch.cat((elements[..., :1, :], inner, elements[..., -1:, :]), -2)


def parabolas(nodes: Tensor) -> tuple[Tensor, Tensor]:
    """Parabolas through the nodes (..., 2 N + 1, 3) of elements of order 2: |dr/dx| (..., 2 N) at
    their stations, and the tangent (..., 2 N + 1, 3) at the nodes, at those of two elements the
    mean of theirs.

    Raises ValueError for an even number of nodes, or one in the middle of an element that is far
    from its middle.
    """
    if nodes.shape[-2] % 2 == 0:
        raise ValueError(
            f"{nodes.shape[-2]} nodes were given to elements of order 2; an odd number is wanted"
        )
    r_1, r_2, r_3 = threes(nodes)
    off = torch.linalg.vector_norm(r_1 + r_3 - 2 * r_2, dim=-1)
    if concrete(off > HALF_WAY * torch.linalg.vector_norm(r_3 - r_1, dim=-1)).any():
        raise refusal("a node far from the middle of its element of order 2", "one about half way")
    along = (at_points(nodes)[1] @ torch.stack((r_1, r_2, r_3), -2)).flatten(-3, -2)
    # at the ends of the elements
    first, last = (4 * r_2 - 3 * r_1 - r_3) / 2, (r_1 - 4 * r_2 + 3 * r_3) / 2
    ends = torch.cat(
        (first[..., :1, :], (first[..., 1:, :] + last[..., :-1, :]) / 2, last[..., -1:, :]), -2
    )
    inner = torch.stack((ends[..., :-1, :], (r_3 - r_1) / 2), -2).flatten(-3, -2)
    return torch.linalg.vector_norm(along, dim=-1), torch.cat((inner, ends[..., -1:, :]), -2)
