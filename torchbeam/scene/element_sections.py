"""Sections of elements: integrals of a section that changes along a beam over each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import function as check_function
from ..core.validation import broadcast, concrete, refusal
from ..core.warning import warn
from ..math.shapes import broadcast_shapes
from .section import Section
from .stations import STATIONS, Middle, Stations, stacked
from .taper import additions, inverse

# Gauss-Legendre points and weights on [0, 1], exact to the seventh power
POINTS = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263)
SHARP = 20.0  # times that a stiffness changes within an element: a height by 2.7
# of the tip's flexibility: less in an element is of no account, as at the tip of a wind blade
LEAST_SHARE = 0.03
WEIGHTS = (0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692)


class ElementSections(NamedTuple):
    """Of N elements: means of compliance and mass, N (or 1) their last batch axis; taper: see
    `taper.additions`; mass_taper (..., N, 6, 6) kg/m: mean of x/h times the mass, x from the
    middle; both None where nothing is known to change.
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
    section = at.like(S[0], mass[0])
    taper = additions(S, means(inverse(by_place, at.rigid), 3), length, at.rigid)
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
