"""Beam: where the nodes are, how long the elements, which way their axes point, and their sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from . import quaternions as quat
from .checks import Value, as_tensor, axis_last, common_dtype, count, finite, positive
from .section import Section


@dataclass(frozen=True)
class Beam:
    """A chain of N elements between N + 1 nodes, undeformed, at rest; node 0 is the root, node -1 the tip.

    nodes       (..., N+1, 3) m, frame a
    frames      (..., N+1, 4) unit quaternions: section axes of the nodes -> frame a
    elements    (..., N, 4) unit quaternions: section axes of the elements (C^ab) -> frame a
    length      (..., N) m, of each element along the reference axis
    compliance  (..., N or 1, 6, 6) and mass (..., N or 1, 6, 6): as in `Section`, per element
    rigid, coupled, offset, rotary: as in `Section`; curved: whether node and element axes differ
    """

    nodes: Tensor
    frames: Tensor
    elements: Tensor
    length: Tensor
    compliance: Tensor
    mass: Tensor
    rigid: tuple[bool, ...]
    coupled: bool
    offset: bool
    rotary: bool
    curved: bool

    @property
    def count(self) -> int:
        """N, the number of elements."""
        return self.nodes.shape[-2] - 1

    @property
    def batch_shape(self) -> torch.Size:
        return torch.broadcast_shapes(
            self.nodes.shape[:-2], self.frames.shape[:-2], self.length.shape[:-1], self.compliance.shape[:-3],
            self.mass.shape[:-3],
        )

    @classmethod
    def straight(
        cls,
        length: Value,
        elements: int,
        section: Section | Sequence[Section],
        direction: Value = (1.0, 0.0, 0.0),
        up: Value = (0.0, 0.0, 1.0),
        root: Value = (0.0, 0.0, 0.0),
    ) -> Beam:
        """A straight beam of `elements` equal elements.

        length     (...) m
        section    one Section, or a sequence of one per element
        direction  (..., 3) of the beam, frame a;  up (..., 3): the section's z axis is `up` made square to it
        root       (..., 3) m, position of node 0, frame a

        Raises ValueError for a length that is not positive, fewer than one element, or `up` along `direction`.
        """
        N = count("elements", elements)
        dtype, device = _dtype_with(section, length, direction, up, root)
        length = positive("length", as_tensor(length, dtype, device))
        direction, up, root = (
            finite(name, axis_last(name, as_tensor(value, dtype, device), 3))
            for name, value in (("direction", direction), ("up", up), ("root", root))
        )
        axes = axes_along(direction, up)
        s = torch.linspace(0, 1, N + 1, dtype=dtype, device=device)
        along = axes[..., :, 0]
        nodes = root[..., None, :] + (length[..., None] * s)[..., None] * along[..., None, :]
        q = quat.from_matrix(axes)[..., None, :]
        each = (length / N)[..., None].expand(*length.shape, N)
        return cls._with_section(section, N, nodes, q.expand(*q.shape[:-2], N + 1, 4), q.expand(*q.shape[:-2], N, 4),
                                 each, curved=False)

    @classmethod
    def from_nodes(cls, nodes: Value, section: Section | Sequence[Section], frames: Value | None = None) -> Beam:
        """A chain through `nodes` (..., N+1, 3) m; elements are the chords.

        frames  (..., N, 3, 3) section axes of the elements as columns, frame a, the first along the chord; without
                them, z is frame a's z made square to the chord (y instead, where the chord runs along z).

        Raises ValueError for fewer than two nodes, coinciding neighbours, or frames whose x axis leaves the chord.
        """
        dtype, device = _dtype_with(section, nodes, frames)
        if isinstance(nodes, (list, tuple)) and any(isinstance(point, Tensor) for point in nodes):  # (..., 3) each
            nodes = torch.stack(torch.broadcast_tensors(*(as_tensor(point, dtype, device) for point in nodes)), -2)
        nodes = finite("nodes", axis_last("nodes", as_tensor(nodes, dtype, device), 3))
        if nodes.ndim < 2 or nodes.shape[-2] < 2:
            raise ValueError(f"nodes of shape {tuple(nodes.shape)} were given; (..., N+1, 3) with N >= 1 is wanted")
        chord = nodes.diff(dim=-2)
        N = chord.shape[-2]
        length = positive("the distance of neighbouring nodes", torch.linalg.vector_norm(chord, dim=-1))
        if frames is None:
            z = torch.tensor([0.0, 0, 1], dtype=dtype, device=device)
            y = torch.tensor([0.0, 1, 0], dtype=dtype, device=device)
            steep = chord[..., 2:].abs() > 0.99 * length[..., None]
            frames = axes_along(chord, torch.where(steep, y, z))
        else:
            frames = finite("frames", as_tensor(frames, dtype, device))
            if frames.shape[-3:] != (N, 3, 3):
                raise ValueError(f"frames of shape {tuple(frames.shape)} were given; (..., {N}, 3, 3) is wanted")
            if ((frames[..., :, 0] - chord / length[..., None]).abs() > 1e-5).any():
                raise ValueError("frames whose first column leaves the chord were given; it runs from node to node")
            if ((frames.mT @ frames - torch.eye(3, dtype=dtype, device=device)).abs() > 1e-5).any():
                raise ValueError("frames that are not orthonormal were given; rotation matrices are wanted")
        return cls._chain(section, nodes, quat.from_matrix(frames), length)

    @classmethod
    def arc(
        cls,
        radius: Value,
        angle: Value,
        elements: int,
        section: Section | Sequence[Section],
        direction: Value = (1.0, 0.0, 0.0),
        up: Value = (0.0, 0.0, 1.0),
        root: Value = (0.0, 0.0, 0.0),
    ) -> Beam:
        """A planar circular arc that starts along `direction` and turns about `up` (counter-clockwise) by `angle` (rad,
        up to 2 pi) with the given radius (m); the section's z axis is `up`. Nodes lie on the arc, elements have the
        arc's length.

        Raises ValueError for a radius or angle that is not positive or fewer than one element.
        """
        N = count("elements", elements)
        dtype, device = _dtype_with(section, radius, angle, direction, up, root)
        radius = positive("radius", as_tensor(radius, dtype, device))
        angle = positive("angle", as_tensor(angle, dtype, device))
        direction, up, root = (finite(n, axis_last(n, as_tensor(v, dtype, device), 3))
                               for n, v in (("direction", direction), ("up", up), ("root", root)))
        axes = axes_along(direction, up)
        s = torch.linspace(0, 1, N + 1, dtype=dtype, device=device) * angle[..., None]
        in_plane = radius[..., None, None] * torch.stack((torch.sin(s), 1 - torch.cos(s), torch.zeros_like(s)), -1)
        nodes = root[..., None, :] + in_plane @ axes.mT
        turn = torch.stack((torch.zeros_like(s), torch.zeros_like(s), s), -1)
        frames = quat.multiply(quat.from_matrix(axes)[..., None, :], quat.exponential(turn))
        middle = quat.half_way(frames[..., :-1, :], frames[..., 1:, :])
        each = (radius * angle / N)[..., None].expand(*torch.broadcast_shapes(radius.shape, angle.shape), N)
        return cls._with_section(section, N, nodes, frames, middle, each, curved=True)

    @classmethod
    def _chain(cls, section, nodes: Tensor, elements: Tensor, length: Tensor) -> Beam:
        """Node axes half way between the axes of the neighbouring elements; those of the end elements at the ends."""
        inner = quat.half_way(elements[..., :-1, :], elements[..., 1:, :])
        frames = torch.cat((elements[..., :1, :], inner, elements[..., -1:, :]), -2)
        return cls._with_section(section, elements.shape[-2], nodes, frames, elements, length, curved=True)

    @classmethod
    def _with_section(cls, section, N, nodes, frames, elements, length, curved) -> Beam:
        sections = (section,) if isinstance(section, Section) else tuple(section)
        if not all(isinstance(s, Section) for s in sections) or len(sections) not in (1, N):
            raise ValueError(f"{len(sections)} sections were given for {N} elements; one Section or one each is wanted")
        stack = (torch.stack(torch.broadcast_tensors(*[getattr(s, name) for s in sections]), -3)
                 for name in ("compliance", "mass"))
        return cls(
            nodes, frames, elements, length, *stack,
            rigid=tuple(any(r) for r in zip(*(s.rigid for s in sections), strict=True)),
            coupled=any(s.coupled for s in sections), offset=any(s.offset for s in sections),
            rotary=any(s.rotary for s in sections), curved=curved,
        )


def axes_along(direction: Tensor, up: Tensor) -> Tensor:
    """Columns x along `direction`, z along `up` made square to it, y = z x x: (..., 3, 3).

    Raises ValueError where `up` is parallel to `direction` or either is zero.
    """
    direction, up = torch.broadcast_tensors(direction, up)
    length = positive("the length of direction", torch.linalg.vector_norm(direction, dim=-1, keepdim=True))
    x = direction / length
    across = up - (up * x).sum(-1, keepdim=True) * x
    size = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    if (size <= 1e-6 * torch.linalg.vector_norm(up, dim=-1, keepdim=True)).any():
        raise ValueError("an up vector parallel to the beam's direction was given; one that leaves it is wanted")
    z = across / size
    return torch.stack((x, torch.linalg.cross(z, x), z), -1)


def _dtype_with(section: Section | Sequence[Section], *values: Value) -> tuple[torch.dtype, torch.device]:
    sections = tuple(section) if isinstance(section, Sequence) else (section,)
    for s in sections:
        if not isinstance(s, Section):
            raise ValueError(f"a section of type {type(s).__name__} was given; a torchbeam.Section is wanted")
    return common_dtype(*values, *(s.compliance for s in sections))
