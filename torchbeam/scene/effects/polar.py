"""Polars: coefficients of lift, drag and moment of an aerofoil by its angle of attack."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...core.leaves import Tree, leaf, with_values
from ...core.validation import Value, as_tensor, common_dtype, concrete, finite, increasing, refusal
from ...math.hat_functions import hats
from ...math.shapes import broadcast_shapes
from .polar_sources import from_network, read, up_to_half_a_turn

TURN = math.pi + 1e-3  # rad, half a turn; what is beyond are degrees


@dataclass(frozen=True, eq=False)
class Polar(Tree):
    """Coefficients of an aerofoil by its angle of attack: cubic pieces through a table, monotone
    between its places, with a continuous slope (Fritsch and Butland 1984, SIAM J. Sci. Stat.
    Comput. 5, 300).

    Args:
        alpha: (n,) rad, strictly increasing
        cl, cd, cm: (..., n), or with `s` (..., m, n), by chord and dynamic pressure; cm about the
            quarter chord, nose up, None = 0
        s: (m,) m, arc length from the root, strictly increasing, of several aerofoils along the
            beam, between which the coefficients are linear; None = one

    Beyond the table the coefficients stay as they are at its ends; `extended` adds places up to
    half a turn. Differentiable in the angle and in the table's coefficients. Native code compares
    the angle with every place of the table, and takes up to 256.

    Raises:
        ValueError: for angles that do not increase or are beyond half a turn, or coefficients of
            another shape.

    Examples:
        >>> flat = tb.Polar((-0.2, 0.0, 0.2), cl=(-1.2, 0.0, 1.2), cd=(0.02, 0.01, 0.02))
        >>> [round(x.item(), 4) for x in flat(torch.tensor([0.1]))]
        [0.6, 0.0125, 0.0]
    """

    alpha: Tensor = leaf(lambda polar: 1 + polar.by_site)
    cl: Tensor = leaf(lambda polar: 1 + (polar.s is not None))
    cd: Tensor = leaf(lambda polar: 1 + (polar.s is not None))
    cm: Tensor | None = leaf(lambda polar: 1 + (polar.s is not None), default=None)
    s: Tensor | None = leaf(1, default=None, kw_only=True)
    by_site: bool = field(default=False, init=False)  # whether it has a row for each site
    _pieces: Tensor = leaf(lambda polar: 2 + (polar.s is not None or polar.by_site), init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        cm = self.cm
        dtype, device = common_dtype(self.alpha, self.cl, self.cd, *(() if cm is None else (cm,)))
        alpha = as_tensor(self.alpha, dtype, device)
        increasing("a Polar's alpha", alpha)
        if concrete(alpha.abs() > TURN).any():
            largest = f"a Polar's alpha up to {alpha.abs().max():.4g}"
            raise refusal(largest, "half a turn at most, in rad,")
        s = None if self.s is None else as_tensor(self.s, dtype, device)
        size = (len(alpha),) if s is None else (len(increasing("a Polar's s", s)), len(alpha))
        curves = {"cl": self.cl, "cd": self.cd}
        curves["cm"] = 0 * as_tensor(self.cl, dtype, device) if cm is None else cm
        for name, value in curves.items():
            curves[name] = value = as_tensor(value, dtype, device)
            if tuple(value.shape[-len(size) :]) != size:
                wanted = f"(..., {', '.join(map(str, size))})"
                raise refusal(f"a Polar's {name} of shape {tuple(value.shape)}", wanted)
            finite(f"a Polar's {name}", value)
        pieces = pieces_through(alpha, torch.stack(torch.broadcast_tensors(*curves.values()), -1))
        vars(self).update(alpha=alpha, s=s, _pieces=pieces, **curves)

    def __call__(self, angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """cl, cd and cm (..., sites) at the angles (..., sites) rad; of several aerofoils each site
        its own.
        """
        return looked_up(self.alpha, self._pieces, angle.to(self.alpha)).unbind(-1)

    def __str__(self) -> str:
        several = "" if self.s is None else f" at {len(self.s)} places"
        return f"a Polar of {self.alpha.shape[-1]} angles{several}"

    def at_sites(self, s: Tensor) -> Polar:
        """With a row for each of the sites with the arc lengths s (..., sites) m."""
        if self.s is None:
            return self
        alpha, pieces = at_sites(self.alpha, self._pieces, self.s, s)
        none = dict.fromkeys(("cl", "cd", "cm", "s"))
        return with_values(self, alpha=alpha, _pieces=pieces, by_site=True, **none)

    @property
    def zero_lift(self) -> Tensor:
        """(...) rad: the angle without lift, by a line between the places about it that are next
        to 0.
        """
        a, cl = self.alpha, self.cl
        crosses = (cl[..., :-1] <= 0) & (cl[..., 1:] > 0)
        if not concrete(crosses).any(-1).all():
            raise refusal("a Polar whose lift does not rise through 0", "one")
        near = torch.where(crosses, (a[:-1] + a[1:]).abs(), torch.inf)
        k = near.argmin(-1, keepdim=True)
        left, right = cl.gather(-1, k)[..., 0], cl.gather(-1, k + 1)[..., 0]
        k = k[..., 0]
        return a[k] - left * (a[k + 1] - a[k]) / (right - left)

    def slope(self, width: float = math.radians(5.0)) -> Tensor:
        """(...) 1/rad: the largest slope of lift between places within `width` rad of the angle
        without lift.
        """
        middle = (self.alpha[1:] + self.alpha[:-1]) / 2
        slopes = self.cl.diff(dim=-1) / self.alpha.diff()
        near = (middle - self.zero_lift[..., None]).abs() <= width
        return torch.where(near, slopes, -torch.inf).amax(-1)

    @classmethod
    def blended(cls, s: Value, polars: Sequence[Polar]) -> Polar:
        """Of aerofoils at arc lengths s (m,) m along the beam, each with a polar of its own; at all
        angles of their tables.

        Raises:
            ValueError: for another number of polars than places.
        """
        s = as_tensor(s, *common_dtype(s))
        if len(polars) != s.numel():
            raise refusal(f"{len(polars)} polars for {s.numel()} places", "one for each", were=True)
        alpha = torch.cat([polar.alpha for polar in polars]).unique()
        alpha = alpha[torch.cat((alpha.diff() > 1e-9, alpha.new_ones(1, dtype=torch.bool)))]
        curves = zip(*(polar(alpha) for polar in polars), strict=True)
        return cls(alpha, *(torch.stack(x, -2) for x in curves), s=s)

    def extended(self, aspect_ratio: float = 10.0) -> Polar:
        """The same with places up to half a turn on both sides, as a plate has them (Viterna and
        Corrigan 1982, NASA CP-2230).

        Beyond the last place a_s of the table, where the aerofoil is stalled,

            cd = B1 sin^2 a + B2 cos a          B1 = cd_max = 1.11 + 0.018 aspect_ratio
            cl = B1/2 sin 2a + A2 cos^2 a/sin a  (B1 = 2.01 from an aspect ratio of 50 on)

        with A2 and B2 from cl and cd at a_s. Past a right angle, and on the other side, the lift is
        that of the mirrored angle times -0.7, and 0 at half a turn. The normal force acts at a
        share of the chord that goes from where it acts at a_s linearly to 1/2 at a right angle
        and 3/4 at half a turn.
        """
        return Polar(*up_to_half_a_turn(self.alpha, (self.cl, self.cd, self.cm), aspect_ratio))

    @classmethod
    def read(cls, path: str | Path) -> Polar:
        """From a file of columns: angle in degrees, cl, cd, and cm if there is one.

        It takes what XFOIL saves, AirfoilInfo files of AeroDyn, and plain columns: of rows of
        numbers the longest run of one length. XFOIL's column of the pressure drag is left out.

        Raises:
            ValueError: for a file without such rows.
        """
        return cls(*read(Path(path)))

    @classmethod
    def neuralfoil(
        cls, aerofoil: str | Any, reynolds: float, *, alpha: Value | None = None,
        model: str = "large", extended: bool = True, **options: Any,
    ) -> Polar:  # fmt: skip
        """From NeuralFoil, a network trained on XFOIL (Sharpe 2024; `pip install torchbeam[air]`).

        Args:
            aerofoil: a name ("naca0012") or a file of coordinates, or coordinates (n, 2) by chord,
                from the trailing edge over the upper side
            reynolds: number, by the chord
            alpha: (n,) rad; None = -15 to 20 degrees, by a degree
            model: size of its network, "xxsmall" to "xxxlarge"
            extended: whether up to half a turn, see `extended`
            options: others of `neuralfoil.get_aero_from_airfoil`, like n_crit

        Raises:
            ImportError: where NeuralFoil is not installed.
        """
        polar = cls(*from_network(aerofoil, reynolds, alpha, model, options))
        return polar.extended() if extended else polar


def at_sites(alpha: Tensor, pieces: Tensor, at: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
    """Places (..., sites, n) and pieces (..., sites, n - 1, k) at arc lengths s (..., sites), of
    pieces (..., m, n - 1, k) at the arc lengths `at` (m,).
    """
    rows = hats(s, at)[..., None, :] @ pieces.flatten(-2)[..., None, :, :]
    rows = rows[..., 0, :].unflatten(-1, pieces.shape[-2:])
    return alpha.expand(*s.shape, len(alpha)), rows


def looked_up(alpha: Tensor, pieces: Tensor, angle: Tensor) -> Tensor:
    """Curves (..., sites, m) at angles (..., sites), of pieces (..., n - 1, 1 + 4 m) between the
    places alpha (n,); or each site of its own, with an axis for them before the others.
    """
    each = alpha.ndim > 1
    inside = torch.minimum(torch.maximum(angle, alpha[..., 0]), alpha[..., -1])
    places = alpha[..., 1:-1].detach()
    if each:
        shape = broadcast_shapes(places.shape[:-1], inside.shape)
        inside = inside.expand(shape)
        places = places.expand(*shape, places.shape[-1]).contiguous()
        k = torch.searchsorted(places, inside.detach()[..., None].contiguous(), right=True)
    else:
        k = torch.searchsorted(places.contiguous(), inside.detach().contiguous(), right=True)
    lead = broadcast_shapes(pieces.shape[:-2], k.shape[:-1])
    rows = pieces.expand(*lead, *pieces.shape[-2:])
    at = k.expand(*lead, k.shape[-1])[..., None]
    row = torch.gather(rows, -2, at.expand(*at.shape[:-1], pieces.shape[-1]))
    row = row[..., 0, :] if each else row
    h = (inside - row[..., 0])[..., None]
    a, b, c, d = row[..., 1:].unflatten(-1, (4, -1)).unbind(-2)
    return a + h * (b + h * (c + h * d))


def pieces_through(x: Tensor, y: Tensor) -> Tensor:
    """Cubic pieces (..., n - 1, 1 + 4 m) through y (..., n, m) at x (n,): x at their beginning, and
    coefficients of the powers of the distance from there.
    """
    h = x.diff()[:, None]
    s = y.diff(dim=-2) / h
    m = _slopes(h, s)
    left, right = m[..., :-1, :], m[..., 1:, :]
    c, d = (3 * s - 2 * left - right) / h, (left + right - 2 * s) / h**2
    start = x[:-1, None].expand(*y.shape[:-2], len(h), 1)
    return torch.cat((start, y[..., :-1, :], left, c, d), -1)


def _slopes(h: Tensor, s: Tensor) -> Tensor:
    """Slopes (..., n, m) at the places, of lines s (..., n - 1, m) over h (n - 1, 1): their
    weighted harmonic mean, 0 where they turn; at the ends that of a parabola, held monotone.
    """
    if len(h) == 1:
        return torch.cat((s, s), -2)
    first, last, left, right = h[:-1], h[1:], s[..., :-1, :], s[..., 1:, :]
    same = left * right > 0
    one = torch.ones_like(left)
    left, right = torch.where(same, left, one), torch.where(same, right, one)
    u, v = 2 * last + first, last + 2 * first
    inner = torch.where(same, (u + v) / (u / left + v / right), 0.0)

    def end(h0: Tensor, h1: Tensor, s0: Tensor, s1: Tensor) -> Tensor:
        m = ((2 * h0 + h1) * s0 - h0 * s1) / (h0 + h1)
        m = torch.where(m * s0 > 0, m, 0.0)
        return torch.where((s0 * s1 <= 0) & (m.abs() > 3 * s0.abs()), 3 * s0, m)

    begin = end(h[0], h[1], s[..., 0, :], s[..., 1, :])
    close = end(h[-1], h[-2], s[..., -1, :], s[..., -2, :])
    return torch.cat((begin[..., None, :], inner, close[..., None, :]), -2)
