"""Curves: from a curvature; and section axes of nodes, and between them: along a curve by parallel
transport, along a beam at rest from directions.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete, positive, refusal, rotations
from ..math import quaternions as quat
from ..math.element_shapes import SHAPES, at_points, threes

# 1 + cosine of the turn from one tangent to the next: less, and the curve turns back on itself
BACK = 1e-6
TURNS_BACK = (
    "a curve that turns back on itself at a node was given; nodes that are nearer to "
    "each other are wanted, or frames"
)


def places(h: Tensor, order: int) -> Tensor:
    """Arc lengths s m at which a curvature is asked for over intervals h (..., n) m: the middles
    (..., n), or, of order 2, the two Gauss points of each (..., 2 n).
    """
    middle, x = h.cumsum(-1) - h / 2, h.new_tensor(SHAPES[order].stations)
    return (middle[..., None] + h[..., None] * (x / 2)).flatten(-2)


def screws(curvature: Tensor, h: Tensor) -> tuple[Tensor, Tensor]:
    """Over intervals h (..., n) m, of curvatures (..., n or 1, 3) 1/m that are constant over each,
    or (..., 2 n, 3) at the Gauss points: the rotation vector `turn` rad and the vector `along` m
    (..., n, 3) of the screw that leads to its end (see `curve`). Of two points k_1, k_2 by the
    fourth-order Magnus expansion of R' = R ~k, r' = R e_1 (Iserles and Norsett 1999):

        turn = h (k_1 + k_2)/2 + sqrt(3)/12 h^2 k_1 x k_2
        along = h e_1 + sqrt(3)/12 h^2 (k_1 - k_2) x e_1
    """
    h, e_1 = h[..., None], h.new_tensor((1.0, 0, 0))
    if curvature.shape[-2] in (1, h.shape[-2]):
        return h * curvature, h * e_1
    (k_1, k_2), c = curvature.unflatten(-2, (-1, 2)).unbind(-2), 3**0.5 / 12 * h**2
    turn = h / 2 * (k_1 + k_2) + c * torch.linalg.cross(k_1, k_2)
    return turn, h * e_1 + c * torch.linalg.cross(k_1 - k_2, e_1.expand_as(k_1))


def curve(root: Tensor, axes: Tensor, turn: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes (..., n+1, 3) m and axes (..., n+1, 4) from the root (..., 3) and its axes (..., 4) on,
    by screws (..., n, 3): the axes turn by exp(~turn), and the node moves by the integral of
    exp(x ~turn) along over x from 0 to 1, in its axes.
    """
    each, step = quat.exponential(turn), quat.spin_of_vector(*torch.broadcast_tensors(turn, along))
    frames, nodes = [axes], [root]
    for i in range(each.shape[-2]):
        nodes.append(nodes[-1] + quat.rotate(frames[-1], step[..., i, :]))
        frames.append(quat.normalize(quat.multiply(frames[-1], each[..., i, :])))
    nodes, frames = (torch.stack(torch.broadcast_tensors(*x), -2) for x in (nodes, frames))
    return nodes, frames


def tangents(nodes: Tensor, length: Tensor) -> Tensor:
    """Unit tangents (..., N+1, 3) at nodes (..., N+1, 3) that lie `length` (..., N) m apart along
    the axis: of the parabola through each node and its neighbours, at the ends of that through the
    three last ones; second order in the length.
    """
    slope, h = nodes.diff(dim=-2) / length[..., None], length[..., None]
    if slope.shape[-2] == 1:
        slopes = slope.expand(*slope.shape[:-2], 2, 3)
    else:
        a, b = h[..., :-1, :], h[..., 1:, :]
        inner = (b * slope[..., :-1, :] + a * slope[..., 1:, :]) / (a + b)
        first, last = (2 * slope[..., k, :] - inner[..., k, :] for k in (slice(1), slice(-1, None)))
        slopes = torch.cat((first, inner, last), -2)
    size = torch.linalg.vector_norm(slopes, dim=-1, keepdim=True)
    if concrete(size == 0).any():
        raise ValueError(TURNS_BACK)
    return slopes / size


def shortest_turn(a: Tensor, b: Tensor) -> Tensor:
    """Quaternion (..., 4) of the smallest rotation that takes the unit vectors a to b (..., 3).
    Raises ValueError where they are opposite.
    """
    a, b = torch.broadcast_tensors(a, b)
    cosine = 1 + (a * b).sum(-1, keepdim=True)
    if concrete(cosine < BACK).any():
        raise ValueError(TURNS_BACK)
    return quat.normalize(torch.cat((cosine, torch.linalg.cross(a, b)), -1))


def transported(along: Tensor) -> Tensor:
    """Quaternions (..., N+1, 4) that take what is fixed to the first of the tangents (..., N+1, 3)
    to each: parallel transport, by the smallest rotation from one to the next.
    """
    each, size = shortest_turn(along[..., :-1, :], along[..., 1:, :]), 1
    while size < each.shape[-2]:  # each is the product of those up to its own
        products = quat.multiply(each[..., size:, :], each[..., :-size, :])
        each = torch.cat((each[..., :size, :], products), -2)
        size *= 2
    none = pad(torch.zeros_like(along[..., :1, :]), (1, 0), value=1.0)
    return quat.normalize(torch.cat((none, each), -2))


def carried_axes(
    frames: Tensor, rest: Tensor, nodes: Tensor, length: Tensor, twist: Tensor | None = None
) -> Tensor:
    """Axes (..., N+1, 4) of a beam with those `frames` (..., N+1, 4) where its nodes are at `rest`,
    when they are at `nodes` (..., N+1, 3): those at rest, carried to the new curve without a twist
    beside their own, then turned about it by `twist` (..., N+1) rad. At the first node they turn as
    little as its tangent asks for. What is unchanged stays to rounding.
    """
    before, after = tangents(rest, length), tangents(nodes, length)
    first = shortest_turn(before[..., 0, :], after[..., 0, :])[..., None, :]
    turn = quat.multiply(
        quat.multiply(transported(after), first), quat.conjugate(transported(before))
    )
    if twist is not None:
        turn = quat.multiply(quat.exponential(twist[..., None] * after), turn)
    return quat.normalize(quat.multiply(turn, frames))


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
