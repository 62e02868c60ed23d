"""Dynamic stall of Beddoes and Leishman, in an incompressible form."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from ...core.leaves import Tree, branch, leaf, with_values
from ...core.validation import Value, refusal, shown
from ...math.concrete import is_vmapped
from ...math.hat_functions import hats
from ...math.shapes import broadcast_shapes
from .polar import Polar, at_sites, looked_up, pieces_through
from .wind import positive

NEAR = math.radians(1.0)  # of the angle without lift: there the slope of lift is not asked for
ATTACHED = math.radians(3.0)  # from it: there the arm of the lift is not asked for
ARMS = 16  # parts of the degree of attachment in the table of arms
LEAST = 1e-4  # of a degree of attachment, below which its root is replaced by a parabola


@dataclass(frozen=True, eq=False)
class DynamicStall(Tree):
    """A polar with dynamic stall: the states x and 1 - y at each node of a `StripAir`, behind lags.

    a is the angle at three quarters of the chord, delayed by the wake (`lags`). b is the semichord,
    V the speed, p the pitch rate, f(a) the degree of attachment of the steady polar. Then:

        x' = V/b (c (a - a0) + pi b p/V - x)/pressure          lift that lags behind the pressure
        y' = V/b (f(x/c + a0) - y)/separation                  degree of attachment
        cl = c (a - a0) y + cl_s(a) (1 - y)
        cd = cd(a) + (cd(a) - cd(a0)) ((f^(1/2) - y^(1/2))/2 - (f - y)/4)
        cm = cm(a) + cl (arm(y) - arm(f))

    From the steady polar, after Kirchhoff: c the largest cl/(a - a0), f = (2 (cl/c(a - a0))^(1/2)
    - 1)^2, 0 beyond where it first is, cl_s = (cl - c (a - a0) f)/(1 - f), and arm(f) of
    (cm - cm(a0))/cl at positive angles (Hansen, Gaunaa and Madsen 2004, Risoe-R-1354, equations 12
    to 34). At rest it is the polar itself, and with attached flow the lags alone are left.
    A motion begins with attached flow: begin one in deep stall from `tb.equilibrium`, whose states
    are settled.

    Args:
        polar: a steady `Polar`; best up to half a turn (`Polar.extended`)
        pressure, separation: (...) semichords of travel, T_p and T_f

    Raises:
        ValueError: for times that are not positive, a polar whose lift does not rise through 0, or
            that torch.vmap maps over.

    Examples:
        >>> flat = tb.Polar((-0.4, -0.2, 0.0, 0.2, 0.4), (-1.0, -1.2, 0, 1.2, 1.0), (0.2,) * 5)
        >>> air = tb.StripAir(0.1, polar=tb.DynamicStall(flat), wind=(0, -10.0, 1.0))
        >>> air.internal  # at each node: two lags of the wake, two of the stall
        4
    """

    polar: Polar = branch()
    pressure: Value = leaf(
        lambda stall: int(stall.by_site), default=1.7, kw_only=True, check=positive
    )
    separation: Value = leaf(
        lambda stall: int(stall.by_site), default=3.0, kw_only=True, check=positive
    )
    by_site: bool = field(default=False, init=False)  # whether it has a row for each site
    _alpha: Tensor = leaf(lambda stall: 1 + stall.by_site, init=False)
    _pieces: Tensor = leaf(lambda stall: 2 + stall.several, init=False)
    _numbers: Tensor = leaf(lambda stall: 1 + stall.several, init=False)
    _arms: Tensor = leaf(lambda stall: 1 + stall.several, init=False)

    internal = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        polar = self.polar
        if not isinstance(polar, Polar):
            raise refusal(f"{shown(polar)} as a steady polar", "a Polar")
        a, a0 = polar.alpha, polar.zero_lift[..., None]
        far = (a - a0).abs() > NEAR
        a_away = torch.where(far, a - a0, 1.0)
        slope = torch.where(far, polar.cl / a_away, 0.0).amax(-1, keepdim=True)
        share = torch.where(far, polar.cl / (slope * a_away), 1.0).clamp(0, 1)
        root = torch.where(share > 0.25, share, 0.25).sqrt()
        f = (2 * root - 1) ** 2
        f = f * _up_to_first_zero(f, a > a0)
        whole = 1 - f < 1e-3
        rest = polar.cl - slope * (a - a0) * f
        separated = torch.where(whole, polar.cl / 2, rest / torch.where(whole, 1.0, 1 - f))
        curves = (polar.cl, polar.cd, polar.cm, f, separated)
        curves = torch.stack(torch.broadcast_tensors(*curves), -1)
        pieces = pieces_through(a, curves)
        at_zero = _line(a, torch.stack(torch.broadcast_tensors(polar.cd, polar.cm), -1), a0)
        numbers = torch.cat((slope, a0 + 0 * slope, at_zero[..., :1] + 0 * slope), -1)
        arms = _arms(a, f, (polar.cm - at_zero[..., 1:]) / torch.where(far, polar.cl, 1.0), a0)
        vars(self).update(_alpha=a, _pieces=pieces, _numbers=numbers, _arms=arms)

    @property
    def several(self) -> bool:
        """Whether aerofoils differ along the beam."""
        return self.by_site or self.polar.s is not None

    @property
    def s(self) -> Tensor | None:
        return None if self.polar is None else self.polar.s

    def __str__(self) -> str:
        return f"DynamicStall of {self.polar}"

    def at_sites(self, s: Tensor) -> DynamicStall:
        """With a row for each of the sites with the arc lengths s (..., sites) m."""
        if self.s is None:
            return self
        alpha, pieces = at_sites(self._alpha, self._pieces, self.s, s)
        weights = hats(s, self.s)
        values = dict(
            _alpha=alpha, _pieces=pieces, _numbers=weights @ self._numbers,
            _arms=weights @ self._arms,
        )  # fmt: skip
        for name in ("pressure", "separation"):
            value = getattr(self, name)
            values[name] = value[..., None].expand(*value.shape, s.shape[-1])
        return with_values(self, polar=None, by_site=True, **values)

    def __call__(self, angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """cl, cd and cm (..., sites) of the steady polar at the angles (..., sites) rad."""
        return self._at(angle)[..., :3].unbind(-1)

    def dynamic(self, angle: Tensor, states: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The same with the states (..., sites, 2)."""
        cl, cd, cm, f, separated = self._at(angle).unbind(-1)
        slope, zero, drag = map(self._each, self._numbers.unbind(-1))
        y = 1 - states[..., 1]
        lift = cl + (y - f) * (slope * (angle - zero) - separated)
        more = (_root(f) - _root(y)) / 2 - (f - y) / 4
        return lift, cd + (cd - drag) * more, cm + lift * (self._arm(y) - self._arm(f))

    def rates(self, states: Tensor, angle: Tensor, turn: Tensor) -> Tensor:
        """Rates (..., sites, 2) of the states, a semichord of travel; turn (..., sites): b p/V."""
        x, apart = states.unbind(-1)
        x_rate = (self._pressed(angle, turn) - x) / self._each(self.pressure)
        rate = (1 - self._attached(x) - apart) / self._each(self.separation)
        return torch.stack((x_rate, rate), -1)

    def advanced(self, states: Tensor, angle: Tensor, turn: Tensor, half: Tensor) -> Tensor:
        """The states in the middle of a step of which half (..., sites) is in semichords."""
        x, apart = states.unbind(-1)
        h, k = (half / self._each(x) for x in (self.pressure, self.separation))
        x = (x + h * self._pressed(angle, turn)) / (1 + h)
        return torch.stack((x, (apart + k * (1 - self._attached(x))) / (1 + k)), -1)

    def _at(self, angle: Tensor) -> Tensor:
        return looked_up(self._alpha, self._pieces, angle)

    def _each(self, x: Tensor) -> Tensor:
        """A number of the aerofoil, (..., sites or 1)."""
        return x if self.by_site else x[..., None]

    def _pressed(self, angle: Tensor, turn: Tensor) -> Tensor:
        slope, zero = map(self._each, self._numbers[..., :2].unbind(-1))
        return slope * (angle - zero) + math.pi * turn

    def _attached(self, x: Tensor) -> Tensor:
        """Degree of attachment by the lift that lags."""
        slope, zero = map(self._each, self._numbers[..., :2].unbind(-1))
        return self._at(x / slope + zero)[..., 3]

    def _arm(self, f: Tensor) -> Tensor:
        """Share of the chord by which the lift acts ahead, linear in the table."""
        none, one = torch.zeros_like(f), torch.ones_like(f)
        place = ARMS * torch.minimum(torch.maximum(f, none), one)
        k = place.detach().long().clamp(0, ARMS - 1)  # of NaN, too
        arms = self._arms if self.by_site else self._arms[..., None, :]
        arms = arms.expand(*broadcast_shapes(arms.shape[:-1], f.shape), ARMS + 1)
        at = k[..., None].expand(*arms.shape[:-1], 1)
        left, right = (torch.gather(arms, -1, at + n)[..., 0] for n in (0, 1))
        return left + (place - k) * (right - left)


def _root(f: Tensor) -> Tensor:
    """f^(1/2), a parabola near 0, where its slope has no bound."""
    share = f.clamp(min=0) / LEAST
    small = share < 1
    near = math.sqrt(LEAST) / 2 * share * (3 - share)
    return torch.where(small, near, torch.where(small, 1.0, f).sqrt())


def _up_to_first_zero(f: Tensor, above: Tensor) -> Tensor:
    """1 up to where f (..., n) first is 0 on either side of where `above` begins, 0 beyond."""
    held = (f > 0).to(f)
    up = torch.where(above, held, 1.0).cumprod(-1)
    down = torch.where(above, 1.0, held).flip(-1).cumprod(-1).flip(-1)
    return up * down


def _line(x: Tensor, y: Tensor, at: Tensor) -> Tensor:
    """(..., k) of y (..., n, k) at places `at` (..., 1) among x (n,), by lines."""
    return (hats(at[..., 0], x)[..., None] * y).sum(-2)


def _arms(a: Tensor, f: Tensor, arm: Tensor, a0: Tensor) -> Tensor:
    """arm (..., n) at equal parts of f (..., n) from 0 to 1, (..., ARMS + 1): of positive angles up
    to the first at which f is 0.
    """
    if is_vmapped(f):
        raise refusal("DynamicStall of a polar within torch.vmap", "a batch of polars")
    rows = []
    shape = broadcast_shapes(f.shape, arm.shape)
    both = zip(f.expand(shape).reshape(-1, len(a)), arm.expand(shape).reshape(-1, len(a)),
               a0.expand(*shape[:-1], 1).reshape(-1), strict=True)  # fmt: skip
    parts = torch.linspace(0, 1, ARMS + 1, dtype=f.dtype, device=f.device)
    for one_f, one_arm, zero in both:
        some = (a > zero + ATTACHED).nonzero()[:, 0]
        ends = (one_f[some] <= 0).nonzero()
        some = some[: int(ends[0]) + 1] if len(ends) else some
        falling = one_f[some].detach().cummin(0).values
        keep = torch.cat((falling.new_ones(1, dtype=torch.bool), falling.diff() < -1e-9))
        x, y = one_f[some][keep].flip(0), one_arm[some][keep].flip(0)
        if len(x) < 2:
            rows.append(y[:1].expand(ARMS + 1))
        else:
            rows.append((hats(parts, x) * y).sum(-1))
    return torch.stack(rows).reshape(*shape[:-1], ARMS + 1)
