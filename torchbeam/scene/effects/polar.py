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
from ...core.validation import Value, as_tensor, common_dtype, finite, increasing, refusal
from ...math.shapes import broadcast_shapes
from .wind import hats

FLAT = 50.0  # aspect ratio from which the drag of a plate across the wind is that of an endless one
BACK = 0.7  # of the lift with the trailing edge first, over that with the leading edge
SPACING = math.radians(10.0)  # of places that an extension adds, at most


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
    half a turn. Differentiable in the angle and in the table's coefficients. Native code looks at
    every place of the table, and takes up to 256.

    Raises:
        ValueError: for angles that do not increase, or coefficients of another shape.

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
        if not crosses.any(-1).all():
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
        return _extended(self, aspect_ratio)

    @classmethod
    def read(cls, path: str | Path) -> Polar:
        """From a file of columns: angle in degrees, cl, cd, and cm if there is one.

        It takes what XFOIL saves, AirfoilInfo files of AeroDyn, and plain columns: of rows of
        numbers the longest run of one length. XFOIL's column of the pressure drag is left out.

        Raises:
            ValueError: for a file without such rows.
        """
        return _read(cls, Path(path))

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
        return _from_network(cls, aerofoil, reynolds, alpha, model, extended, options)


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


def _extended(polar: Polar, aspect_ratio: float) -> Polar:
    a, right = polar.alpha, math.pi / 2
    if not (-right < a[0] < 0 < a[-1] < right):
        raise refusal("a Polar whose table does not lie about 0, within a right angle,", "one")
    most = 2.01 if aspect_ratio >= FLAT else 1.11 + 0.018 * aspect_ratio
    most = torch.maximum(polar.cd.amax(-1), torch.full_like(polar.cd[..., 0], most))
    above = _past(a[-1], *(x[..., -1] for x in (polar.cl, polar.cd, polar.cm)), most)
    cl, cm = -polar.cl[..., 0], -polar.cm[..., 0]
    below = _past(-a[0], cl, polar.cd[..., 0], cm, most)
    below = tuple(sign * x.flip(-1) for sign, x in zip((-1, -1, 1, -1), below, strict=True))
    parts = (a, polar.cl, polar.cd, polar.cm)
    return Polar(
        *(torch.cat(x, -1) for x in zip(below, parts, above, strict=True))
    )  # fmt: skip


def _past(
    start: Tensor, cl: Tensor, cd: Tensor, cm: Tensor, most: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Angles (k,) beyond `start` up to half a turn, and cl, cd, cm (..., k) there, which begin at
    these (...).
    """
    right = math.pi / 2

    def spread(first: float, last: float) -> Tensor:
        return torch.linspace(first, last, 1 + math.ceil((last - first) / SPACING)).to(start)

    ahead = spread(start.item(), right)
    back = spread(right, math.pi - start.item())[1:]
    a = torch.cat((ahead, back, start.new_tensor([math.pi])))
    mirrored = torch.cat((ahead, math.pi - back, start[None]))
    sin, cos = mirrored.sin(), mirrored.cos()
    A2 = (cl - most * sin[0] * cos[0]) * sin[0] / cos[0] ** 2
    B2 = (cd - most * sin[0] ** 2) / cos[0]
    B1 = most[..., None]
    lift = B1 / 2 * (2 * mirrored).sin() + A2[..., None] * cos**2 / sin
    drag = B1 * sin**2 + B2[..., None] * cos
    lift = lift * torch.where(a > right, -BACK, 1.0)
    lift = lift * torch.where(a == a[-1], 0.0, 1.0)
    normal = lift * a.cos() + drag * a.sin()
    # where the normal force acts, behind the quarter chord
    arm = -cm / normal[..., 0]
    share = (a - a[0]) / (right - a[0])
    past = 0.25 + 0.25 * (a - right) / right
    arms = torch.where(a <= right, arm[..., None] * (1 - share) + 0.25 * share, past)
    return tuple(x[..., 1:] for x in (a, lift, drag, -arms * normal))


def _read(cls: type[Polar], path: Path) -> Polar:
    runs: list[list[list[float]]] = [[]]
    header = ""
    for line in path.read_text(errors="replace").splitlines():
        row = _numbers(line)
        if len(row) < 3:
            header = line if "CDp" in line else header
            runs.append([])
        else:
            if runs[-1] and len(runs[-1][-1]) != len(row):
                runs.append([])
            runs[-1].append(row)
    rows = max(runs, key=len)
    if len(rows) < 2:
        raise refusal(f"{path.name}, which holds no rows of angle, cl and cd,", "a polar's file")
    columns = torch.tensor(rows, dtype=torch.float64).T
    picked = (0, 1, 2, 4) if header and len(columns) > 4 else (0, 1, 2, 3)
    degrees, cl, cd, *cm = (columns[k] for k in picked if k < len(columns))
    order = degrees.argsort()
    return cls(torch.deg2rad(degrees[order]), *(x[order] for x in (cl, cd, *cm)))


def _numbers(line: str) -> list[float]:
    """A row of numbers; none of a line that holds anything else."""
    try:
        return [float(word) for word in line.replace(",", " ").split()]
    except ValueError:
        return []


def _from_network(
    cls: type[Polar], aerofoil: Any, reynolds: float, alpha: Value | None, model: str,
    extended: bool, options: dict[str, Any],
) -> Polar:  # fmt: skip
    try:
        import aerosandbox
        import neuralfoil
    except ImportError as error:
        raise ImportError(
            "Polar.neuralfoil needs NeuralFoil: pip install torchbeam[air]"
        ) from error
    if alpha is None:
        degrees = torch.arange(-15.0, 21.0, dtype=torch.float64)
    else:
        degrees = torch.rad2deg(as_tensor(alpha, torch.float64))
    if isinstance(aerofoil, (str, Path)):
        foil = aerosandbox.Airfoil(str(aerofoil))
    else:
        foil = aerosandbox.Airfoil("given", coordinates=torch.as_tensor(aerofoil).numpy())
    result = neuralfoil.get_aero_from_airfoil(
        foil, alpha=degrees.numpy(), Re=float(reynolds), model_size=model, **options
    )
    curves = (torch.as_tensor(result[name], dtype=torch.float64) for name in ("CL", "CD", "CM"))
    polar = cls(torch.deg2rad(degrees), *curves)
    return polar.extended() if extended else polar
