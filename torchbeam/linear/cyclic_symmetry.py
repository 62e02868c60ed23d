"""Cyclic symmetry of a rotor: by which part of a turn it comes onto itself, what that makes of its
moves and internal states, and the generator of such turns, see `multiblade`.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ..core.validation import concrete
from ..math import quaternions as quat
from ..math.block_matrices import block_diagonal
from ..nodal.model import Model
from ..scene.parts import Part
from .bearing import Bearing

MET = 1e-6  # of the structure's size: blades that are turned onto each other


def symmetry(bearing: Bearing, X: Tensor) -> tuple[int, Tensor | None, bool]:
    """By which part of a turn the rotor comes onto itself, three or more; how that moves moves and
    internal states (..., w nodes + Z, w nodes + Z), X (..., w, w) axis x ...; and whether parts lie
    off the axis. (0, None, True) where it does not.
    """
    beam = bearing.model.scene.beam
    nodes = beam.nodes.detach().reshape(-1, *beam.nodes.shape[-2:])
    parts = [part for part in beam.parts if bearing.rotor[part.nodes.start]]
    point, axis = (v.detach().reshape(-1, 3) for v in (bearing.point, bearing.direction))
    apart = nodes - point[:, None, :]
    near = MET * beam.extent.detach().reshape(-1)
    for order in range(len(parts) + 2, 2, -1):
        turn = quat.matrix(quat.exponential(axis * (2 * math.pi / order)))
        turned = (turn[:, None] @ apart[..., None])[..., 0]
        images = [_image(part, parts, apart, turned, near) for part in parts]
        if None in images:
            continue
        turn = torch.linalg.matrix_exp(X * (2 * math.pi / order))
        moved = any(a is not b for a, b in zip(parts, images, strict=True))
        return order, _permutation(bearing, parts, images, turn), moved
    return 0, None, True


def _image(part: Part, parts: list[Part], nodes: Tensor, turned: Tensor, near: Tensor) -> Any:
    """The part that this is turned onto, itself first; None = there is none."""
    for other in (part, *parts):
        if other.node_count == part.node_count and other.body == part.body:
            off = torch.linalg.vector_norm(
                turned[:, part.nodes] - nodes[:, other.nodes], dim=-1
            ).amax(-1)
            if bool(concrete(off <= near).all()):
                return other
    return None


def _permutation(
    bearing: Bearing, parts: list[Part], images: list[Part], turn: Tensor
) -> Tensor | None:
    """(..., w nodes + Z, w nodes + Z): a node's moves, turned (..., w, w), as those of its image,
    and its internal states as they are. None where its image has others.
    """
    model = bearing.model
    node, station = list(range(model.node_count)), list(range(model.station_count))
    for part, image in zip(parts, images, strict=True):
        node[part.nodes], station[part.stations] = _rows(image.nodes), _rows(image.stations)
    places = _onto(node, turn) * bearing.rotor.to(turn)
    P = (places[:, None, :, None] * turn[..., None, :, None, :]).flatten(-4, -3).flatten(-2)
    if not model.lag_count:
        return P
    sites = _sites(model)
    images, at = [], {site: [k for k, x in enumerate(sites) if x == site] for site in set(sites)}
    for k, (kind, row) in enumerate(sites):
        others = at.get((kind, (node if kind == "node" else station)[row]), [])
        if len(others) != len(at[kind, row]):
            return None
        images.append(others[at[kind, row].index(k)])
    return block_diagonal(P, _onto(images, turn))


def _rows(rows: slice) -> list[int]:
    return list(range(rows.start, rows.stop))


def _onto(images: list[int], like: Tensor) -> Tensor:
    """(n, n): takes the k-th number to that place."""
    return torch.eye(len(images), dtype=like.dtype, device=like.device)[:, images]


def _sites(model: Model) -> list[tuple[str, int]]:
    """Of each internal state the node whose it is, of what elements have crept by the station."""
    sites: list[tuple[str, int]] = []
    for act in model.acts:
        if act.internal is not None:
            rows = [row for row in range(model.node_count) if act.acts_on(row)]
            each = (act.internal.stop - act.internal.start) // len(rows)
            sites += [("node", row) for row in rows for _ in range(each)]
    crept = model.lag_count - len(sites)
    each = crept // max(1, model.station_count)
    return sites + [("station", k // each) for k in range(crept)]


def generator(P: Tensor | None, Z: Tensor, size: Tensor, order: int) -> Tensor | None:
    """S (..., n, n) of moves Z (..., w nodes + Z, n), orthonormal by their size; None where P does
    not take these to themselves, as joints hold others.
    """
    if P is None:
        return None
    Q = Z / size[..., None]
    turned = P @ Q
    P, S, power = Q.mT @ turned, torch.zeros_like(Q.mT @ Q), Q.mT @ Q
    if bool(concrete((turned - Q @ P).abs() > MET).any()):
        return None
    for j in range(1, order):
        power = power @ P
        angles = ((k, 2 * math.pi * j * k / order) for k in range(1, (order + 1) // 2))
        S = S + sum(2 * k * math.sin(angle) for k, angle in angles) / order * power
    return S
