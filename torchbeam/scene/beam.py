"""Beam: nodes, element lengths, section axes and section properties of the undeformed chain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import function as check_function
from ..core.leaves import leaf
from ..core.summary import counted, kind, lines, point, span
from ..core.validation import (
    Value,
    as_tensor,
    axis_last,
    common_dtype,
    concrete,
    finite,
    positive,
    refusal,
)
from ..math import quaternions as quat
from ..math.element_shapes import SHAPES
from ..topology.framework import Framework
from .beam_arguments import Sections, check_order, dtype_with, intervals, placed, warn_of_batch
from .beam_recipe import remembered, with_recipe_of
from .beam_rows import BeamRows
from .curve import axes_of_nodes, carried_along, curve, orthonormal, parabolas, places, screws
from .element_sections import of_elements
from .section import Section, notes
from .stations import STATIONS


@dataclass(frozen=True)
class Beam(BeamRows):
    """A beam at rest: a chain of N elements between N + 1 nodes; node 0 is the root, node -1 the
    tip.

    Make it by `straight`, `arc`, `curve` or `from_nodes`.

    Args:
        nodes: (..., N+1, 3) m, frame a
        frames: (..., N+1, 4) unit quaternions: section axes of the nodes -> frame a
        elements: (..., N, 4) unit quaternions: section axes of the elements (C^ab) -> frame a
        length: (..., N) m, of each element along the reference axis
        compliance: (..., N or 1, 6, 6), of each element as in `Section`
        mass: (..., N or 1, 6, 6), likewise
        rigid, coupled, offset, rotary: as in `Section`
        curved: whether node and element axes differ
        order: of the elements, 1 or 2 (see `Beam.straight`). Of order 2 there are 2 N + 1 nodes and
            two stations an element. Axes of N above then have length 2 N, each station for half of
            its element
        linked_interpolation: see `linked`
        taper: (..., N, 2, 6, 6), what a section that changes within an element adds to its
            compliance, of plain elements and of linked ones (see `scene.taper`); None = nothing
        mass_taper: (..., N, 6, 6), how much more mass one end of such an element has than half

    Examples:
        >>> blade = tb.Beam.straight(
        ...     2.0, 10, strip, direction=(0, 0, 1.0), up=(1.0, 0, 0), twist=0.3
        ... )
        >>> ring = tb.Beam.arc(0.5, 3.0, 12, strip)  # radius m, angle rad
        >>> ring.length.sum()  # m, of the chords
        tensor(1.5000)
    """

    nodes: Tensor = leaf(2)
    frames: Tensor = leaf(2)
    elements: Tensor = leaf(2)
    length: Tensor = leaf(1)
    compliance: Tensor = leaf(3)
    mass: Tensor = leaf(3)
    rigid: tuple[bool, ...]
    coupled: bool
    offset: bool
    rotary: bool
    curved: bool
    order: int = 1
    linked_interpolation: bool = False
    taper: Tensor | None = leaf(4, default=None)
    mass_taper: Tensor | None = leaf(3, default=None)

    def __repr__(self) -> str:
        mass = (self.mass[..., 0, 0] * self.length).sum(-1)
        order = f" of order {self.order}" if self.order > 1 else ""
        elements = f"{counted(self.element_count, 'element')}{order}"
        size = [elements, f"{span(self.length.sum(-1))} m long", f"{span(mass)} kg"]
        shape = ["curved or twisted at rest"] * self.curved
        shape += ["linked interpolation"] * self.linked_interpolation
        return lines(
            "Beam",
            ", ".join([*size, *shape, *notes(self)]),
            f"root at {point(self.nodes[..., 0, :])} m, tip at {point(self.nodes[..., -1, :])} m",
            kind(self.batch_shape, self.nodes),
        )

    @property
    def topology(self) -> Framework:
        """Which nodes the elements lie between."""
        return Framework(self.order, (self.element_count,))

    def station_axes(self, frames: Tensor) -> Tensor:
        """Axes of the elements, or of the stations (..., N, 4), of a beam whose nodes have the axes
        (..., N+1, 4), quaternions: frame B, in which strain and stress are told.
        """
        return STATIONS[self.order].axes(frames)

    def linked(self) -> Beam:
        """This beam with linked interpolation: a smaller bending error of coarse meshes, at no
        cost.

        Elements bend between their nodes as loads at the nodes would bend them. Bending of small
        displacements then has fourth order. Use it from four elements on; stretching and twist keep
        second order. Rigid elements stay exact bars. The mixed forms do not take it.

        The displacement across an element is quadratic and linked to the rotations of its nodes
        (Tessler and Dong 1981). The shear compliance of an element of length h gets its residual
        bending flexibility h^2/(12 EI) (MacNeal 1978). Gregory's end-corrected rule integrates mass
        and loads along the beam; mass is lumped. Where a section changes along an element, the
        flexibility is that of a linear moment, exactly (see `scene.taper`).

        Raises:
            ValueError: for elements of order 2, which have a displacement of their own between
                their ends.
        """
        if self.order != 1:
            raise ValueError(
                f"linked interpolation of elements of order {self.order} was asked for; order 1 "
                "is wanted"
            )
        return with_recipe_of(replace(self, linked_interpolation=True), self)

    @classmethod
    @remembered
    def straight(
        cls,
        length: Value,
        elements: int,
        section: Sections,
        direction: Value = (1.0, 0.0, 0.0),
        up: Value | None = None,
        root: Value = (0.0, 0.0, 0.0),
        twist: Value | Callable[[Tensor], Tensor] | None = None,
        order: int = 1,
    ) -> Beam:
        """A straight beam of `elements` equal elements.

        Args:
            length: (...) m
            section: a `Section`, whose batch axes are the beam's. Along the beam: a sequence of
                sections by element, or `Stations`. Or a function of the arc length s (..., m) m
                that returns a `Section` with a last batch axis m
            direction: (..., 3) of the beam, frame a
            up: (..., 3): the section's z axis is `up` made square to the beam; None = frame a's z
                (y, if the beam runs along z)
            root: (..., 3) m, position of node 0, frame a
            twist: rad, turn of the section axes at rest about the beam. A number (...) is the turn
                at the tip, growing evenly from zero at the root; all axes of a tensor are batch
                axes. Along the beam: a `Table`, or a function of s (..., m) m that returns (..., m)
            order: 1: elements of two nodes. 2: elements of three nodes, one in the middle, with two
                stations of stress. Their error falls with the fourth power of their length, so few
                suffice where the solution is smooth

        Raises:
            ValueError: for a length that is not positive, fewer than one element, `up` along
                `direction`, or another order.
        """
        N = intervals(elements, order)
        (length,), axes, root = placed(section, direction, up, root, length=length, _twist=twist)
        s = torch.linspace(0, 1, N + 1, dtype=length.dtype, device=length.device)
        nodes = root[..., None, :] + (length[..., None] * s)[..., None] * axes[..., None, :, 0]
        q = quat.from_matrix(axes)[..., None, :]
        each = (length / N)[..., None].expand(*length.shape, N)
        if twist is None:
            frames = q.expand(*q.shape[:-2], N + 1, 4)
            return cls._with_section(section, nodes, frames, each, order, frames[..., 1:, :], False)
        if callable(twist):
            angle = check_function("twist", twist, "s")(length[..., None] * s)
            angle = as_tensor(angle, length.dtype, length.device)
            if angle.shape[-1:] != (N + 1,):
                raise refusal(f"a twist of shape {tuple(angle.shape)}", f"(..., {N + 1})")
        else:
            tip = as_tensor(twist, length.dtype, length.device)
            warn_of_batch("a twist", tip.shape, N, order, section, nodes.shape[:-2])
            angle = tip[..., None] * s
        frames = quat.multiply(q, quat.exponential(pad(finite("twist", angle)[..., None], (0, 2))))
        return cls._with_section(section, nodes, frames, each, order)

    @classmethod
    @remembered
    def curve(
        cls,
        length: Value,
        elements: int,
        section: Sections,
        curvature: Value | Callable[[Tensor], Tensor],
        direction: Value = (1.0, 0.0, 0.0),
        up: Value | None = None,
        root: Value = (0.0, 0.0, 0.0),
        order: int = 1,
    ) -> Beam:
        """A beam that is curved and twisted at rest, of `elements` elements of equal arc length.

        Args:
            length: (...) m, along the axis
            curvature: (..., 3) 1/m in section axes: twist, and bending about y and z. Constant (an
                arc, a helix), or a function of s (..., m) m that returns (..., m, 3). The function
                is evaluated in the middle of each element, and its value is constant over the
                element. Of order 2 it is evaluated at two Gauss points between neighbouring nodes,
                which then lie on the curve to fourth order
            section, root, order: as in `straight`
            direction, up: as in `straight`, at node 0

        Over a length h of constant curvature k the axes turn by exp(h ~k). The axis advances by the
        integral of exp(s ~k) e1, exactly. No element may turn by pi.

        Raises:
            ValueError: for a length that is not positive, fewer than one element, or elements that
                turn by pi or more.
        """
        N = intervals(elements, order)
        (length,), axes, root = placed(
            section, direction, up, root, length=length, _curvature=curvature
        )
        h = (length / N)[..., None].expand(*length.shape, N)
        s = places(h, order)
        values = (
            check_function("curvature", curvature, "s")(s) if callable(curvature) else curvature
        )
        k = as_tensor(values, length.dtype, length.device)
        k = finite("curvature", axis_last("curvature", k, 3))
        if not callable(curvature):
            others = length.shape, axes.shape[:-2], root.shape[:-1]
            warn_of_batch("a curvature", k.shape[:-1], N, order, section, *others)
            k = k[..., None, :]
        elif k.ndim < 2 or k.shape[-2] != s.shape[-1]:
            raise ValueError(
                f"a curvature of shape {tuple(k.shape)} was given for {s.shape[-1]} places; "
                f"(..., {s.shape[-1]}, 3) is wanted"
            )
        turn, along = screws(k, h)
        if concrete(torch.linalg.vector_norm(turn, dim=-1) >= math.pi).any():
            raise ValueError(
                f"a curvature that turns one of {N} elements by pi or more was given; more "
                "elements are wanted"
            )
        nodes, frames = curve(root, quat.from_matrix(axes), turn, along)
        return cls._with_section(section, nodes, frames, h, order)

    @classmethod
    @remembered
    def from_nodes(
        cls,
        nodes: Value,
        section: Sections,
        frames: Value | None = None,
        order: int = 1,
        up: Value | None = None,
    ) -> Beam:
        """A beam through given nodes (..., N+1, 3) m.

        Elements of order 1 are the chords. Elements of order 2 need (..., 2 N + 1, 3) nodes. They
        are parabolas through three nodes, the second about half way. A corner between two parabolas
        is rounded over the elements beside it, with an error of first order; chords have second
        order there.

        Args:
            frames: (..., N, 3, 3) section axes of the elements as columns, frame a, the first along
                the chord. Of order 2 axes of the nodes, (..., 2 N + 1, 3, 3), the first along the
                tangent. None = axes go from element to element without twist (parallel transport,
                at corners too)
            up: (..., 3), without frames: the first z axis is `up` made square to it. None = frame
                a's z (y, if the beam starts along z). If nodes and `up` turn together, the axes
                turn with them

        Raises:
            ValueError: for fewer than two nodes, coinciding neighbours, or both frames and up. For
                frames that are left-handed or whose x axis leaves the chord. Without frames, for a
                chain that turns back on itself at a node. Of order 2, for an even number of nodes,
                or a midside node off the middle.
        """
        check_order(order)
        dtype, device = dtype_with(section, nodes, frames, up)
        # (..., 3) each
        if isinstance(nodes, (list, tuple)) and any(isinstance(point, Tensor) for point in nodes):
            points = (as_tensor(point, dtype, device) for point in nodes)
            nodes = torch.stack(torch.broadcast_tensors(*points), -2)
        # lengths and axes are of these
        nodes = finite("nodes", axis_last("nodes", as_tensor(nodes, dtype, device), 3)).clone()
        if nodes.ndim < 2 or nodes.shape[-2] < 2:
            raise refusal(
                f"nodes of shape {tuple(nodes.shape)}", "(..., N+1, 3) with N >= 1", were=True
            )
        if up is not None:
            up = finite("up", axis_last("up", as_tensor(up, dtype, device), 3))
            if frames is not None:
                raise refusal("frames and up", "one of them", were=True)
        if SHAPES[order].midside:
            return cls._parabolas(section, nodes, frames, up)
        chord = nodes.diff(dim=-2)
        N = chord.shape[-2]
        length = positive(
            "the distance of neighbouring nodes", torch.linalg.vector_norm(chord, dim=-1)
        )
        if frames is None:
            elements = carried_along(chord, length, up)
        else:
            frames = orthonormal(as_tensor(frames, dtype, device), N)
            if concrete((frames[..., :, 0] - chord / length[..., None]).abs() > 1e-5).any():
                raise ValueError(
                    "frames whose first column leaves the chord were given; it runs from node to "
                    "node"
                )
            elements = quat.from_matrix(frames)
        return cls._with_section(section, nodes, axes_of_nodes(elements), length, 1, elements)

    @classmethod
    @remembered
    def arc(
        cls,
        radius: Value,
        angle: Value,
        elements: int,
        section: Sections,
        direction: Value = (1.0, 0.0, 0.0),
        up: Value | None = None,
        root: Value = (0.0, 0.0, 0.0),
        order: int = 1,
    ) -> Beam:
        """A beam along a planar circular arc.

        It starts along `direction` and turns about `up`, counter-clockwise, by `angle` (rad, up to
        2 pi) at the given radius (m). The section's z axis is `up`. Nodes lie on the arc, and
        elements have the arc's length. order: as in `straight`.

        Raises:
            ValueError: for a radius or angle that is not positive, an angle above 2 pi or fewer
                than one element.
        """
        N = intervals(elements, order)
        (radius, angle), axes, root = placed(
            section, direction, up, root, radius=radius, angle=angle
        )
        if concrete(angle > 2 * math.pi * (1 + 1e-6)).any():
            raise refusal(f"angle = {concrete(angle).max().item():g}", "an arc of up to 2 pi")
        s = torch.linspace(0, 1, N + 1, dtype=angle.dtype, device=angle.device) * angle[..., None]
        circle = torch.stack((torch.sin(s), 1 - torch.cos(s), torch.zeros_like(s)), -1)
        nodes = root[..., None, :] + (radius[..., None, None] * circle) @ axes.mT
        turn = quat.exponential(pad(s[..., None], (2, 0)))
        frames = quat.multiply(quat.from_matrix(axes)[..., None, :], turn)
        each = (radius * angle / N)[..., None]
        each = each.expand(*each.shape[:-1], N)
        return cls._with_section(section, nodes, frames, each, order)

    @classmethod
    def _parabolas(
        cls, section: Sections, nodes: Tensor, frames: Value | None, up: Tensor | None
    ) -> Beam:
        """`from_nodes` of order 2. A station stands for |dr/dx| of its parabola."""
        length, tangent = parabolas(nodes)
        size = positive("the tangent at a node", torch.linalg.vector_norm(tangent, dim=-1))
        if frames is None:
            q = carried_along(tangent, size, up)
        else:
            frames = as_tensor(frames, nodes.dtype, nodes.device)
            q = quat.from_matrix(orthonormal(frames, nodes.shape[-2]))
        return cls._with_section(section, nodes, q, length, 2)

    @classmethod
    def _with_section(
        cls, section: Sections, nodes, frames, length, order, elements=None, curved=True
    ) -> Beam:
        """elements: their axes, None = by those of nodes."""
        uniform = isinstance(section, Section)
        changes: dict[str, Tensor | None] = {}
        if not uniform:
            section, *more = of_elements(section, length, order)
            changes = dict(zip(("taper", "mass_taper"), more, strict=True))
        common_dtype(nodes, section.compliance)  # says so where a section lies on another device
        elements = STATIONS[order].axes(frames) if elements is None else elements
        both = (x[..., None, :, :] if uniform else x for x in (section.compliance, section.mass))
        has = section.rigid, section.coupled, section.offset, section.rotary
        return cls(
            nodes, frames, elements, length, *both, *has, curved=curved, order=order, **changes
        )
