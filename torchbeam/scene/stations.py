"""Stations, where strain and stress are told and sections stand, by the elements' order (another
element is a class here); section properties at places along a beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count, instance, listed
from ..core.leaves import Tree, leaf, option
from ..core.validation import as_tensor, broadcast, common_dtype, finite, refusal
from ..math import quaternions as quat
from ..math.element_shapes import X, at_points, threes
from ..topology.framework import within_elements
from .section import STRUCTURE, Section


class Middle:
    """The middle of an element of two nodes, which stands for all of it: a section that changes
    along the beam is averaged over the element.
    """

    averaged = True

    @staticmethod
    def axes(frames: Tensor) -> Tensor:
        """Axes (..., stations, 4) at rest, of nodes with the axes (..., nodes, 4)."""
        return quat.half_way(frames[..., :-1, :], frames[..., 1:, :])

    @staticmethod
    def places(length: Tensor) -> Tensor:
        """Arc lengths (..., stations) m, of stations that stand for a length each."""
        return length.cumsum(-1) - length / 2

    @staticmethod
    def lines(length: Tensor) -> tuple[Tensor, int]:
        """Straight lines by which values at stations are told between them, each through two:
        where one ends and the next begins (..., lines - 1) m, and how many stations further on
        that has its two.
        """
        return Middle.places(length)[..., 1:-1], 1


class GaussPoints:
    """The two Gauss points of an element of three nodes; see `Middle`, and `quadratic_element`."""

    averaged = False

    @staticmethod
    def axes(frames: Tensor) -> Tensor:
        axes = at_points(frames)[0] @ quat.aligned(*threes(frames))
        return quat.normalize(axes).flatten(-3, -2)

    @staticmethod
    def places(length: Tensor) -> Tensor:
        return within_elements(length, (-X, X)).flatten(-2)

    @staticmethod
    def lines(length: Tensor) -> tuple[Tensor, int]:
        return length.cumsum(-1)[..., 1:-1:2], 2


STATIONS = {1: Middle, 2: GaussPoints}  # by the order of the elements


@dataclass(frozen=True)
class Table(Tree):
    """A number along the beam, from a table: linear between its places, constant outside.

    Args:
        s: (..., n) m, arc length from the root, strictly increasing
        values: (..., n), or (..., n, k) with `width` = k numbers at each place

    Examples:
        >>> measured = tb.Table((0.0, 0.4, 1.0), (0.0, 0.1, 0.3))  # rad, linear between places
        >>> twisted = tb.Beam.straight(1.0, 8, strip, twist=measured)
        >>> twisted.node_count
        9
    """

    s: Tensor = leaf(1)
    values: Tensor = leaf(lambda table: 1 if table.width is None else 2)
    width: int | None = option(count, default=None, name="width")

    def __post_init__(self) -> None:
        super().__post_init__()
        dtype, device = common_dtype(self.s, self.values)
        s, values = (as_tensor(v, dtype, device) for v in (self.s, self.values))
        vars(self).update(s=_places(s), values=finite("a Table's values", values))
        shape = s.shape[-1:] if self.width is None else (*s.shape[-1:], self.width)
        if values.ndim < len(shape) or values.shape[values.ndim - len(shape) :] != shape:
            wanted = f"(..., {', '.join(map(str, shape))})"
            raise refusal(
                f"a Table's values of shape {tuple(values.shape)}", wanted, were=True, are=True
            )

    def __call__(self, s: Tensor) -> Tensor:
        """Values (..., m) or (..., m, k) at s (..., m) m."""
        values = self.values[..., None] if self.width is None else self.values
        values_at_s = _between(self.s, values, s)
        return values_at_s[..., 0] if self.width is None else values_at_s

    def ramps(self, s: Tensor) -> Tensor:
        """The same table (..., m) of a number at each place, as a sum of ramps. It needs no
        look-up, so native code can evaluate it.
        """
        share = (s[..., None] - self.s[..., None, :-1]) / self.s.diff(dim=-1)[..., None, :]
        share = share.clamp(0, 1)
        # where one ramp ends and the next begins, the next alone has a slope, as in a look-up
        inner = torch.where(share[..., :-1] < 1, share[..., :-1], 1.0)
        rise = torch.cat((inner, share[..., -1:]), -1) * self.values.diff(dim=-1)[..., None, :]
        return self.values[..., :1] + rise.sum(-1)


@dataclass(frozen=True)
class Stations(Tree):
    """Sections at places along a beam, in place of one section.

    Use it as `Beam.straight(length, elements, Stations(s, sections))`.

    Args:
        s: (n,) or (..., n) m, arc length from the root, strictly increasing; the beam lies between
            the first and the last
        section: a sequence of n `Section`, or one whose last batch axis is n

    The 6x6 stiffness and the 6x6 mass are linear between stations, the compliance is not. Where a
    height tapers, EI grows as its p-th power, p = 1 to 4. With a relative change x of the height
    from station to station, linear EI errs by p (p - 1) x^2/8, linear 1/EI by p (p + 1) x^2/8. A
    strain that is impossible must be so at every station.

    Raises:
        ValueError: for places that do not increase, another number of sections, or a strain that is
            impossible at some stations only.

    Examples:
        >>> thick = tb.Section.rectangle(0.03, 0.004, E=69e9, nu=0.33, rho=2700.0)
        >>> tapered = tb.Beam.straight(1.0, 8, tb.Stations((0.0, 1.0), [thick, strip]))
        >>> tapered.mass.shape  # one an element
        torch.Size([8, 6, 6])
    """

    s: Tensor = leaf(1)
    section: Section | Sequence[Section]

    def __post_init__(self) -> None:
        section = self.section
        section = section if isinstance(section, Section) else stacked(_sections(section))
        s = _places(as_tensor(self.s, *common_dtype(self.s, section.compliance)))
        n = s.shape[-1]
        if section.batch_shape[-1:] != (n,):
            given = section.batch_shape[-1] if section.batch_shape else 1
            raise ValueError(f"{given} sections were given for {n} stations; one each is wanted")
        zero = section.compliance.diagonal(dim1=-2, dim2=-1) == 0
        if (zero.any(-2) != zero.all(-2)).any():
            raise refusal("a strain that is impossible at some stations", "at all or at none")
        vars(self).update(s=s, section=section)

    def __call__(self, s: Tensor) -> Section:
        """The sections at s (..., m) m, m their last batch axis. Raises ValueError for s beyond."""
        slack = 1e-5 * (self.s[..., -1:] - self.s[..., :1])
        if ((s < self.s[..., :1] - slack) | (s > self.s[..., -1:] + slack)).any():
            span = f"{self.s.min().item():g} to {self.s.max().item():g} m"
            raise ValueError(
                f"a beam from {s.min().item():g} to {s.max().item():g} m was given stations from "
                f"{span}; stations from end to end are wanted"
            )
        S, mass, n = self.section.compliance, self.section.mass, self.s.shape[-1]
        rigid = S.new_tensor([float(r) for r in self.section.rigid]).diag()
        stiffness = torch.linalg.inv(S + rigid)
        K, mass = (
            _between(self.s, x.expand(*x.shape[:-3], n, 6, 6).flatten(-2), s).unflatten(-1, (6, 6))
            for x in (stiffness, mass)
        )
        S = torch.linalg.inv((K + K.mT) / 2) - rigid
        return self.section.like((S + S.mT) / 2, mass)


def _sections(given: Any) -> tuple[Section, ...]:
    """One `Section` or more; ValueError otherwise."""
    sections = listed(given)
    for section in sections:
        instance("a section", section, Section)
    if not sections:
        raise refusal("no sections", "one for each station", were=True)
    return sections


def stacked(sections: Sequence[Section]) -> Section:
    """One section whose last batch axis counts the given ones."""
    compliance, mass = (
        torch.stack(torch.broadcast_tensors(*(getattr(s, name) for s in sections)), -3)
        for name in ("compliance", "mass")
    )
    return Section(compliance, mass).declared(
        *(any(getattr(s, what) for s in sections) for what in STRUCTURE)
    )


def _places(s: Tensor) -> Tensor:
    finite("s", s)
    if s.ndim == 0 or s.shape[-1] < 2 or not (s.diff(dim=-1) > 0).all():
        raise ValueError(
            f"the places s = {s.flatten().tolist()[:8]} were given; two or more, strictly "
            "increasing, are wanted"
        )
    return s


def _between(s: Tensor, values: Tensor, at: Tensor) -> Tensor:
    """Straight lines through values (..., n, k) at s (..., n), looked up at (..., m)."""
    shape = broadcast("places and values", s.shape[:-1], values.shape[:-2], at.shape[:-1])
    n, m, k = s.shape[-1], at.shape[-1], values.shape[-1]
    s, at = s.expand(*shape, n), at.to(values).expand(*shape, m)
    values = values.expand(*shape, n, k)
    i = torch.searchsorted(s.detach().contiguous(), at.detach().contiguous(), right=True)
    i = (i - 1).clamp(0, n - 2)
    a, b = s.gather(-1, i), s.gather(-1, i + 1)
    share = ((at - a) / (b - a)).clamp(0, 1)[..., None]
    before, after = (values.gather(-2, j[..., None].expand(*shape, m, k)) for j in (i, i + 1))
    return torch.lerp(before, after, share)  # exact at both ends, however small one is
