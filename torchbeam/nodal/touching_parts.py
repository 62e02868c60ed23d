"""Which parts of a scene touch each other, and at which places along them."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.validation import concrete
from ..scene.effects.contact_terms import ContactTerms
from ..scene.parts import part_of
from ..scene.scene import Scene
from .centreline import bernstein, control_shares, piece_nodes
from .coordinates.spatial import Spatial
from .touching import AllTouching, Touching
from .touching_motion import NoTouching

DENSITY = 2.0  # places in half of the length along which two that cross touch


def touching_of(scene: Scene, space: Spatial, s: Tensor) -> NoTouching:
    """Of a scene; s (..., N+1) m, arclength of its nodes."""
    if not scene.pairs:
        return NoTouching()
    each = [one for k, pair in enumerate(scene.pairs) for one in _both(scene, pair, k, s)]
    eye = torch.eye(space.unknowns, dtype=scene.dtype, device=scene.device)
    return AllTouching(space, space.embed(eye), tuple(each))


def _both(scene: Scene, pair: ContactTerms, k: int, s: Tensor) -> list[Touching]:
    """From each of two beams to the other, of which each has half of the force; from a body to a
    beam, or to a body; from a beam to itself.
    """
    first, second = (_nodes(scene, name) for name in (pair.on, pair.partner))
    radius = s.new_zeros(()) if pair.radius is None else pair.radius
    other = radius if pair.other_radius is None else pair.other_radius
    radii = torch.stack(torch.broadcast_tensors(radius, other), -1)
    if first == second:
        return [_one(pair, k, s, first, second, radii, 0.5)]
    if len(second) == 1:
        return [_one(pair, k, s, second, first, radii.flip(-1), 1.0, False)]
    if len(first) == 1:
        return [_one(pair, k, s, first, second, radii, 1.0)]
    return [
        _one(pair, k, s, first, second, radii, 0.5),
        _one(pair, k, s, second, first, radii.flip(-1), 0.5, False),
    ]


def _nodes(scene: Scene, name: str | None) -> range:
    if name is None:
        beams = [part for part in scene.beam.parts if not part.body]
        return range(beams[0].node_count if beams else scene.beam.node_count)
    part = part_of(scene.beam.parts, name)
    return range(part.first_node, part.first_node + part.node_count)


def _one(
    pair: ContactTerms,
    k: int,
    s: Tensor,
    first: range,
    second: range,
    radii: Tensor,
    share: float,
    is_first: bool = True,
) -> Touching:
    """Places along the first nodes, and pieces of the second."""
    control = s.new_tensor(control_shares(len(second)))
    ends = s.new_zeros(len(second), 2)
    ends[0, 0] = ends[-1, 1] = 1.0
    own = piece_nodes(first.start, len(first))
    if len(first) == 1:
        count, shares, measure = 1, s.new_tensor([[0.0, 1.0, 0.0]]), s.new_ones(1)
    else:
        corners = (s.new_tensor(control_shares(len(first))) @ s[..., own, None])[..., 0]
        lengths = corners.diff(dim=-1)  # (..., n, 2), halves of what the curve begins and ends with
        number = _number(pair, lengths, radii)
        count = int(concrete(number).amax())
        t = (torch.arange(count, dtype=s.dtype, device=s.device) + 0.5) / number
        t = t.clamp(max=1)[..., None, :]  # 1: a place that this sample has not
        shares = (bernstein(t) @ s.new_tensor(control_shares(len(first)))).flatten(-3, -2)
        speed = 2 * (lengths[..., :1] * (1 - t) + lengths[..., 1:] * t)
        measure = share * (speed / number[..., None] * (t < 1)).flatten(-2)
    points = tuple(nodes for nodes in own for _ in range(count))
    allowed = s.new_ones(len(points), len(second))
    if first == second:
        along = s.detach()[..., list(first)]
        away = (along[..., :, None] - along[..., None, :]).abs()
        away = away >= (pair.apart * radii.detach()[..., 0])[..., None, None]
        number = torch.arange(len(first), device=s.device)
        away = away & ((number[:, None] - number).abs() > 1)
        allowed = away.to(s).repeat_interleave(count, -2)
    return Touching(
        contact=pair,
        pair=k,
        first=is_first,
        points=points,
        pieces=piece_nodes(second.start, len(second)),
        shares=shares,
        measure=measure,
        allowed=allowed,
        control=control,
        ends=ends,
        radii=radii,
    )


def _number(pair: ContactTerms, lengths: Tensor, radii: Tensor) -> Tensor:
    """(..., 1) places of a piece, each sample's own: `DENSITY` in half of the length along which
    two beams touch that cross at a right angle, or as the pair says.
    """
    if pair.points:
        return radii.new_tensor([float(pair.points)])
    d, D = pair.thickness.detach(), radii.detach().sum(-1)
    half = (d * (2 * D + d)).sqrt()
    longest = lengths.detach().sum(-1).amax(-1)
    return (DENSITY * longest / half).ceil().clamp(min=1)[..., None]
