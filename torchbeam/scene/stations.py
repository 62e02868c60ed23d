"""Stations, where strain and stress are told and sections stand, by the elements' order (another
element is a class here); section properties at places along a beam, and their averages over
elements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import count, instance, listed
from ..core.arguments import function as check_function
from ..core.leaves import Tree, leaf, option
from ..core.validation import as_tensor, broadcast, common_dtype, concrete, finite, refusal
from ..core.warning import warn
from ..math import quaternions as quat
from ..math.element_shapes import X, at_points, threes
from ..math.shapes import broadcast_shapes
from ..topology.framework import within_elements
from .section import STRUCTURE, Section
from .taper import additions


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


# Gauss-Legendre points and weights on [0, 1], exact to the seventh power
POINTS = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263)
SHARP = 20.0  # times that a stiffness changes within an element: a height by 2.7
# of the tip's flexibility: less in an element is of no account, as at the tip of a wind blade
LEAST_SHARE = 0.02
WEIGHTS = (0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692)


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
        """The same (..., m) of one number at each place, as a sum of ramps: nothing is looked up,
        so that native code can be made of it.
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


class ElementSections(NamedTuple):
    """Of N elements: means of compliance and mass, N (or 1) their last batch axis; taper: see
    `taper.additions`; mass_taper (..., N, 6, 6) kg/m: mean of x/h times the mass, x from the
    middle; both None where nothing is known to change, taper also of impossible strains.
    """

    section: Section
    taper: Tensor | None = None
    mass_taper: Tensor | None = None


def of_elements(
    section: Sequence[Section] | Callable[[Tensor], Section], length: Tensor, order: int = 1
) -> ElementSections:
    """The sections of N elements of the given length (..., N) m. A function of s, `Stations` among
    them, is integrated over each element, compliance and mass: means, and what else the ends of the
    element show. Four Gauss points of each element take part, of `Stations` four between the
    stations in it, where their lines have corners; one that changes much within an element is
    warned of. Of order 2 those of the stations of stress, (..., 2 N); a function is taken there.
    """
    N = length.shape[-1]
    if callable(section):
        if not STATIONS[order].averaged:
            return ElementSections(_sections_at(section, STATIONS[order].places(length)))
        corners = section.s if isinstance(section, Stations) else None
        return _integrated(section, length, *_quadrature(length, corners))
    sections = tuple(section)
    known = sections and all(isinstance(s, Section) for s in sections)
    if not known or len(sections) not in (1, N // order):
        raise ValueError(
            f"{len(sections)} sections were given for {N // order} elements; one Section or one "
            "each is wanted"
        )
    return ElementSections(
        stacked([s for s in sections for _ in range(order if len(sections) > 1 else 1)])
    )


def _integrated(
    function: Callable[[Tensor], Section],
    length: Tensor,
    places: Tensor,
    weights: Tensor,
    element: Tensor,
) -> ElementSections:
    """By a quadrature, see `_quadrature`."""
    N, at = length.shape[-1], _sections_at(function, places)
    middle = Middle.places(length)
    x = places - middle.expand(*element.shape[:-1], N).gather(-1, element)

    def means(values: Tensor, count: int) -> list[Tensor]:
        return [_gathered(values, weights * x**k, element, N) for k in range(count)]

    by_place, mass = (x if x.ndim > 2 else x[None] for x in (at.compliance, at.mass))
    S, mass = means(by_place, 3), means(mass, 2)
    _warn_of_sharp_tapers(by_place, S, element, length)
    section, taper = at.like(S[0], mass[0]), None
    if not any(at.rigid):
        taper = additions(S, means(torch.linalg.inv(by_place), 3), length)
    return ElementSections(section, taper, mass[1] / length[..., None, None])


def _sections_at(function: Callable[[Tensor], Section], places: Tensor) -> Section:
    sections = check_function("section", function, "s")(places)
    if not isinstance(sections, Section) or sections.batch_shape[-1:] != places.shape[-1:]:
        kind = type(sections).__name__
        if isinstance(sections, Section):
            kind = f"of batch shape {tuple(sections.batch_shape)}"
        raise refusal(
            f"a function of s that gave a section {kind} for {places.shape[-1]} places",
            "one Section with a last batch axis of that many",
        )
    return sections


def _quadrature(length: Tensor, corners: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    """Places (..., m) m along elements of length (..., N) m, the share of its element that each
    stands for, and that element's number (..., m): four Gauss points between neighbours among the
    elements' ends and `corners` (..., n) m.
    """
    ends = pad(length.cumsum(-1), (1, 0))
    if corners is not None:
        inside = torch.maximum(torch.minimum(corners, ends[..., -1:]), ends[..., :1])
        shape = broadcast("stations and elements", inside.shape[:-1], ends.shape[:-1])
        ends = torch.cat([x.expand(*shape, x.shape[-1]) for x in (ends, inside)], -1)
        ends = ends.sort(-1).values
    size, (points, weights) = ends.diff(dim=-1), (length.new_tensor(x) for x in (POINTS, WEIGHTS))
    places = ends[..., :-1, None] + size[..., None] * points
    inner = length.cumsum(-1)[..., :-1].detach().expand(*size.shape[:-1], -1).contiguous()
    middle = (ends[..., :-1] + size / 2).detach().contiguous()
    element = torch.searchsorted(inner, middle, right=True)
    share = size / length.expand(*size.shape[:-1], -1).gather(-1, element)
    shares = (share[..., None] * weights).flatten(-2)
    return places.flatten(-2), shares, element.repeat_interleave(len(POINTS), -1)


def _warn_of_sharp_tapers(
    S: Tensor, means: Sequence[Tensor], element: Tensor, length: Tensor
) -> None:
    """A warning of compliances S (..., m or 1, 6, 6) that change too much in one of N elements, if
    it takes part in how far a force at the tip moves it; means: of x^k S.
    """
    N, S = length.shape[-1], concrete(S.detach()).diagonal(dim1=-2, dim2=-1)
    if S.shape[-2] == 1:
        return
    S = S.expand(*broadcast_shapes(S.shape[:-1], element.shape), 6)
    index = concrete(element)[..., None].expand(S.shape)
    most, least = (
        S.new_zeros(*S.shape[:-2], N, 6).scatter_reduce(-2, index, S, of, include_self=False)
        for of in ("amax", "amin")
    )
    S0, S1, S2 = (concrete(x.detach()).diagonal(dim1=-2, dim2=-1) for x in means)
    h = concrete(length.detach())[..., None]
    lever = h.sum(-2, keepdim=True) - h.cumsum(-2) + h / 2
    share = (h * (S0 * lever**2 - 2 * S1 * lever + S2))[..., 4:].abs().sum(-1, keepdim=True)
    counts = share > LEAST_SHARE * share.sum(-2, keepdim=True)
    change = torch.where((least > 0) & counts, most / least, 1.0).amax(-1).reshape(-1, N).amax(0)
    if change.amax() > SHARP:
        at = int(change.argmax())
        warn(
            f"a section whose stiffness changes {change[at].item():.3g}-fold within element {at} "
            f"of 0 to {N - 1} was given: its moment may be far from linear there; more elements, "
            "short ones where it tapers (Beam.from_nodes), or order=2 are wanted"
        )


def _gathered(x: Tensor, weights: Tensor, element: Tensor, N: int) -> Tensor:
    """Sums (..., N, 6, 6) by element of weights (..., m) times x (..., m or 1, 6, 6)."""
    parts = weights[..., None, None] * x
    return parts.new_zeros(*parts.shape[:-3], N, 6, 6).scatter_add(
        -3, element[..., None, None].expand(parts.shape), parts
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
