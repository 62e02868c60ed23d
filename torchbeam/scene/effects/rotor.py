"""Rotors: blade-element momentum theory, and the wind that a rotor induces by it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.arguments import boolean, count, function
from ...core.leaves import leaf
from ...core.validation import (
    Value,
    as_tensor,
    broadcast,
    common_dtype,
    concrete,
    increasing,
    positive,
    refusal,
)
from ...math.quaternions import cross
from .drag import norm
from .polar import Polar
from .wind import WindField, along, direction, hats

HALVINGS = 60  # of the interval that an inflow angle lies in
LEAST = 1e-6  # rad, of an inflow angle
GLAUERT = 2 / 3  # of kappa: a = 0.4, above which momentum theory gives way to Buhl's line


class Elements(NamedTuple):
    """What the blade elements of a rotor do, each (..., n).

    axial: share a of the wind by which it is slowed at the blades
    swirl: share a' of the rotor's speed there by which the air turns against it
    inflow rad: angle of the air against the rotor's plane
    angle rad: angle of attack
    loss: Prandtl's factor of tip and hub
    normal N/m: force of a blade along the wind, per metre of radius
    tangential N/m: in the plane, in the sense of rotation
    """

    axial: Tensor
    swirl: Tensor
    inflow: Tensor
    angle: Tensor
    loss: Tensor
    normal: Tensor
    tangential: Tensor


@dataclass(frozen=True, eq=False)
class Induction(WindField):
    """Wind that a rotor induces in its plane, by the radius about its axis through the origin.

        V = -axial(r) axis - swirl(r) axis x e_r

    Args:
        r: (n,) m, strictly increasing
        axial, swirl: (..., n) m/s, linear in r, constant beyond
        axis: (..., 3) along the wind, of any length; the rotor turns about it, right-handed

    Add it to the wind that comes: `StripAir(..., wind=tb.Wind((0, 0, 10)) + rotor.induction)`. The
    air that the rotor meets in its plane turns against it by `swirl`. It is that of a steady rotor:
    it does not change with the blades' motion.

    Examples:
        >>> slowed = tb.Induction((0.0, 50.0), (3.0, 3.0), (0.5, 0.0), axis=(0, 0, 1.0))
        >>> slowed.velocity(torch.tensor([[25.0, 0, 0]]), torch.tensor(0.0))
        tensor([[ 0.0000, -0.2500, -3.0000]])
    """

    r: Tensor = leaf(1)
    axial: Tensor = leaf(1)
    swirl: Tensor = leaf(1)
    axis: Value = leaf(1, default=(1.0, 0.0, 0.0), kw_only=True, check=direction)

    def __post_init__(self) -> None:
        super().__post_init__()
        dtype, device = common_dtype(self.r, self.axial, self.swirl)
        r = increasing("an Induction's r", as_tensor(self.r, dtype, device))
        both = {name: as_tensor(getattr(self, name), dtype, device) for name in ("axial", "swirl")}
        for name, value in both.items():
            if value.shape[-1:] != r.shape:
                raise refusal(
                    f"an Induction's {name} of shape {tuple(value.shape)}", f"(..., {len(r)})"
                )
        vars(self).update(r=r, **both)

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        axis = self.axis[..., None, :]
        out = position - along(self.axis, position)[..., None] * axis
        r = norm(out)
        e = out / torch.where(r > 0, r, torch.ones_like(r))
        shares = hats(r[..., 0], self.r)
        slow, turn = ((shares * x[..., None, :]).sum(-1) for x in (self.axial, self.swirl))
        return -slow[..., None] * axis - turn[..., None] * cross(axis, e)


@dataclass(frozen=True, eq=False)
class RotorState:
    """A rotor in steady wind, see `blade_element_momentum`: r (n,) m of its elements, what these
    do, and of all blades the thrust (...) N along the wind and the torque (...) N m in the sense of
    rotation; `induction` is the wind that it induces.
    """

    r: Tensor
    elements: Elements
    thrust: Tensor
    torque: Tensor
    induction: Induction


def blade_element_momentum(
    wind: Value, spin: Value, r: Value, chord: Value, twist: Value,
    polar: Polar | Callable[[Tensor], tuple[Tensor, Tensor, Tensor]], *, blades: int = 3,
    hub: Value, tip: Value, axis: Value = (1.0, 0.0, 0.0), density: Value = 1.225,
    losses: bool = True,
) -> RotorState:  # fmt: skip
    """A rotor in steady axial wind by blade-element momentum theory.

        tan(phi) = (1 - a) wind/((1 + a') spin r),   angle = phi - twist
        a = k/(1 + k),      k = blades chord c_n/(8 pi r F sin^2 phi),   c_n = cl cos + cd sin
        a' = k'/(1 - k'),   k' = blades chord c_t/(8 pi r F sin cos),    c_t = cl sin - cd cos
        F = (2/pi)^2 acos(e^-f) acos(e^-g),   f = blades (tip - r)/(2 r sin phi),
        g = blades (r - hub)/(2 hub sin phi)

    Above a = 0.4 the thrust follows Buhl's line in place of momentum (Glauert 1935; Prandtl 1919;
    Buhl 2005, NREL/TP-500-36834). The inflow angle phi is the root of one equation between 0 and a
    right angle (Ning 2014, Wind Energy 17, 1327).

    Args:
        wind: (...) m/s along the axis
        spin: (...) rad/s
        r: (n,) m, strictly increasing, between hub and tip
        chord: (n,) m or (..., n)
        twist: (n,) or (..., n) rad, from the rotor's plane, of the nose into the wind negative
        polar: a `Polar`, of several aerofoils by the length from the hub on, or a function of the
            angle (..., n) that gives cl, cd and cm; a propeller's is mirrored, cl(a) = -cl(-a)
        blades: their number
        hub, tip: m, radii where the blades begin and end
        axis: (3,) along the wind, for the induction
        density: (...) kg/m^3
        losses: whether those of tip and hub count

    Differentiable in all numbers but hub and tip. Elements without a root have NaN.

    Raises:
        ValueError: for radii that do not lie between hub and tip.

    Examples:
        >>> foil = tb.Polar((-0.5, 0.5), cl=(-3.0, 3.0), cd=(0.01, 0.01))
        >>> r = torch.linspace(5.0, 49.0, 12)
        >>> rotor = tb.blade_element_momentum(
        ...     10.0, 1.4, r, 5 - 0.07 * r, torch.atan(4.8 / r) - 0.1, foil, hub=2.0, tip=50.0
        ... )
        >>> 0.4 < rotor.torque * 1.4 / (0.5 * 1.225 * torch.pi * 50.0**2 * 10.0**3) < 16 / 27
        tensor(True)
    """
    polar = _polar(polar)
    losses, blades = boolean("losses", losses), count("blades", blades)
    V, spin, r, chord, twist, density, hub, tip = (
        as_tensor(x, *common_dtype(wind, spin, r, chord, twist, density, hub, tip))
        for x in (wind, spin, r, chord, twist, density, hub, tip)
    )
    increasing("radii r", r)
    for name, x in (("hub", hub), ("tip", tip)):
        positive(name, x)
        if x.ndim:
            raise refusal(f"{name} of shape {tuple(x.shape)}", "one number")
    for name, x in (("chord", chord), ("twist", twist)):
        if x.shape[-1:] != r.shape:
            raise refusal(f"{name} of shape {tuple(x.shape)}", f"(..., {len(r)})")
    if concrete((r[0] < hub) | (r[-1] > tip)).any():
        raise refusal("radii r beyond hub and tip", "radii between them", were=True, are=True)
    V, spin, density = (x[..., None] for x in (V, spin, density))
    ends = ((tip - r) / r, (r - hub) / hub) if losses else ()
    annuli = _Annuli(V, spin * r, chord, twist, density, r, blades, ends, polar(r - hub))
    broadcast("a rotor's numbers", *(x.shape[:-1] for x in (V, spin, chord, twist, density)))
    elements = annuli.at(_root(annuli.residual, V / annuli.speed * chord * twist))
    thrust, torque = (
        blades * torch.trapezoid(_with_ends(x), torch.cat((hub[None], r, tip[None])), dim=-1)
        for x in (elements.normal, elements.tangential * r)
    )
    induction = Induction(r, elements.axial * V, elements.swirl * annuli.speed, axis=axis)
    return RotorState(r, elements, thrust, torque, induction)


def _polar(polar: Any) -> Callable[[Tensor], Callable[[Tensor], Any]]:
    """What gives the polar at lengths (n,) m from the hub on."""
    if hasattr(polar, "at_sites"):
        return polar.at_sites
    polar = function("polar", polar, "angle")
    return lambda s: polar


class _Annuli(NamedTuple):
    """Numbers (..., n) of the elements. ends: how far tip and hub are, over the smaller of both
    radii; none without losses.
    """

    wind: Tensor
    speed: Tensor
    chord: Tensor
    twist: Tensor
    density: Tensor
    r: Tensor
    blades: int
    ends: tuple[Tensor, ...]
    polar: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]

    def at(self, phi: Tensor) -> Elements:
        """At inflow angles (..., n), by the momentum of their annuli."""
        sin, cos, loss = phi.sin(), phi.cos(), torch.ones_like(phi)
        for end in self.ends:
            decay = torch.exp(-self.blades / 2 * end / sin.abs())
            loss = loss * torch.acos(decay.clamp(max=1 - 1e-12)) * (2 / math.pi)
        angle = phi - self.twist
        cl, cd, _ = self.polar(angle)
        normal, tangential = cl * cos + cd * sin, cl * sin - cd * cos
        solidity = self.blades * self.chord / (8 * math.pi * self.r * loss * sin)
        k, turned = solidity * normal / sin, solidity * tangential / cos
        a, swirl = _axial(k, loss), turned / (1 - turned)
        square = ((1 - a) * self.wind) ** 2 + ((1 + swirl) * self.speed) ** 2
        pressure = self.density / 2 * self.chord * square
        return Elements(a, swirl, phi, angle, loss, pressure * normal, pressure * tangential)

    def residual(self, phi: Tensor) -> Tensor:
        x = self.at(phi)
        return phi.sin() / (1 - x.axial) - self.wind / self.speed * phi.cos() / (1 + x.swirl)


def _axial(k: Tensor, loss: Tensor) -> Tensor:
    """a by momentum, beyond `GLAUERT` by Buhl's line (Buhl 2005, equation 18)."""
    heavy = k > GLAUERT
    k_heavy = torch.where(heavy, k, 1.0)
    one, two, three = (
        2 * loss * k_heavy - x for x in (10 / 9 - loss, loss * (4 / 3 - loss), 25 / 9 - 2 * loss)
    )
    three = torch.where(three.abs() < 1e-9, 1e-9, three)
    return torch.where(heavy, (one - two.clamp(min=1e-12).sqrt()) / three, k / (1 + k))


def _root(residual: Callable[[Tensor], Tensor], like: Tensor) -> Tensor:
    """Inflow angles between 0 and a right angle where a residual is 0, by halving, with the
    derivative of the root; NaN where there is none.
    """
    with torch.no_grad():
        low, high = torch.full_like(like, LEAST), torch.full_like(like, math.pi / 2 - LEAST)
        sign = residual(low).sign()
        rooted = sign * residual(high).sign() < 0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            same = residual(middle).sign() == sign
            low, high = torch.where(same, middle, low), torch.where(same, high, middle)
        phi = torch.where(rooted, (low + high) / 2, torch.nan)
    # one step of Newton's method, recorded: the derivative by all that the residual knows
    at = phi.detach().requires_grad_()
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(residual(at).sum(), at)
    return phi - residual(phi) / slope.detach()


def _with_ends(x: Tensor) -> Tensor:
    """Loads (..., n) with those at hub and tip, where there are none."""
    none = torch.zeros_like(x[..., :1])
    return torch.cat((none, x, none), -1)
