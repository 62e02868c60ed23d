"""Rigid motions of a beam, or of the parts of a structure, of a `Model`."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad


class Base(NamedTuple):
    """A part that moves as a rigid one: name, nodes, and the one that rotations are about."""

    name: str
    nodes: slice
    node: int


def bases_of(model: Any) -> list[Base]:
    """The beam, or all parts of a structure; rotations are about the first node that has a support,
    or the first of all.
    """
    held = sorted(model.constraints.nodes)
    parts = [(part.name, part.nodes) for part in model.scene.beam.parts] or [
        ("", slice(0, model.node_count))
    ]
    return [
        Base(name, nodes, next((n for n in held if nodes.start <= n < nodes.stop), nodes.start))
        for name, nodes in parts
    ]


def moves_of(nodes: Tensor, bases: list[Base]) -> tuple[Tensor, Tensor]:
    """Displacements m and rotations (..., 6 of each part, N+1, 3) of nodes by rigid motions."""
    eye, parts = torch.eye(6).to(nodes), []
    for base in bases:
        moved_nodes = nodes[..., base.nodes, :]
        shift, turn = (
            x[:, None].expand(*moved_nodes.shape[:-2], 6, moved_nodes.shape[-2], 3)
            for x in eye.split(3, -1)
        )
        arm = (moved_nodes - nodes[..., base.node : base.node + 1, :])[..., None, :, :].expand_as(
            turn
        )
        shift = length_of(nodes)[..., None, None, None] * shift + torch.linalg.cross(turn, arm)
        others = (0, 0, base.nodes.start, nodes.shape[-2] - base.nodes.stop)
        parts.append([pad(x, others) for x in (shift, turn)])
    return tuple(torch.cat(x, -3) for x in zip(*parts, strict=True))


def length_of(nodes: Tensor) -> Tensor:
    length = torch.linalg.vector_norm(nodes.diff(dim=-2), dim=-1).sum(-1)
    return torch.where(length > 0, length, 1.0)  # of a body alone


def free_pieces(model: Any) -> list[list[Base]]:
    """What joints, tendons and contacts with each other make of the parts, but for pieces whose
    momentum not dead loads alone change: by a support, joint or eyelet of the ground, a load by how
    it stands or moves, or an interaction. Rotations are about the first node of a piece.
    """
    scene, bases = model.scene, bases_of(model)
    links = [joint.ends for joint in scene.joints]
    links += [[eyelet.node for eyelet in tendon.eyelets] for tendon in scene.tendons]
    links += [(None, node) for node in model.constraints.nodes]
    named = [{None if row is None else _at(bases, row, row + 1)[0] for row in x} for x in links]
    named += [{None, *_of_load(model, load, bases)} for load in model.loads[0]]
    named += [{None, *(_at(bases, k, k + 1)[0] for k in x.nodes)} for x in scene.interactions]
    named += [{pair.on, pair.partner} for pair in scene.pairs]
    pieces: list[set[str | None]] = [{base.name} for base in bases]
    for link in named:
        piece = link.union(*(other for other in pieces if other & link))
        pieces = [*(other for other in pieces if not other & piece), piece]
    free = [[base for base in bases if base.name in piece] for piece in pieces if None not in piece]
    return [[base._replace(node=piece[0].nodes.start) for base in piece] for piece in free]


def _of_load(model: Any, load: Any, bases: list[Base]) -> list[str]:
    """The parts that a load acts on."""
    if load.node is not None:
        row = load.node % model.node_count
        return _at(bases, row, row + 1)
    spans = model.scene.beam.spans(load)
    spans = [slice(0, model.node_count)] if spans is None else [span.nodes for span in spans]
    return [name for rows in spans for name in _at(bases, rows.start, rows.stop)]


def _at(bases: list[Base], first: int, end: int) -> list[str]:
    """The parts that have some of these nodes."""
    return [base.name for base in bases if base.nodes.start < end and first < base.nodes.stop]
