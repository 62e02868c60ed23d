"""Wind as a function of place and time: mean wind with shear, gusts, and their sums."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.declared import parameter, real_numbers
from ...core.functions_of_time import at_time, taken
from ...core.leaves import Tree, leaf
from ...core.validation import Value, concrete, refusal
from .load_point import LoadPoint, at_instant
from .values import Input, Inputs, load_value, value_at

EVEN = 106.68  # m, 350 ft: of the gradient at which a gust has its reference velocity (CS 25.341)


def tensor(value: Any) -> Any:
    """Plain numbers as a tensor; what stands for a tensor as it is."""
    stands = callable(value) or isinstance(value, (Tensor, Input))
    return value if stands else torch.as_tensor(value)


def vector(name: str, value: Any) -> Tensor:
    """(..., 3) finite numbers as a tensor."""
    return tensor(real_numbers(name, value, 3))


def direction(name: str, value: Any) -> Tensor:
    """The same of length 1; ValueError where it has none."""
    value = vector(name, value)
    if not concrete(value != 0).any(-1).all():
        raise refusal(f"{name} of length 0", "a direction")
    return value / value.square().sum(-1, keepdim=True).sqrt()


def positive(name: str, value: Any) -> Tensor:
    """(...) positive numbers as a tensor."""
    return tensor(parameter(name, value, zero=False))


def _mean(name: str, value: Any) -> Any:
    return tensor(load_value(name, value))


def at_each(value: Tensor) -> Tensor:
    """(...) as (..., 1) of sites."""
    return value[..., None]


def along(axis: Tensor, position: Tensor) -> Tensor:
    """Component (..., sites) of positions (..., sites, 3) along a vector (..., 3)."""
    return (position * axis[..., None, :]).sum(-1)


def in_frame(velocity: Callable[[Tensor, Tensor], Tensor], point: LoadPoint, t: Tensor) -> Tensor:
    """A wind's velocity (..., sites, 3) m/s, frame a, at a point; the function in inertial axes."""
    axes, place = point.axes, point.position
    if axes is not None:
        axes = axes[..., None, :, :]
        place = (axes.mT @ place[..., None])[..., 0]
    air = at_time(lambda now: taken("a wind's velocity", velocity(place, now), place, 3), t, 2)
    return air if axes is None else (axes @ air[..., None])[..., 0]


class WindField(Tree):
    """Base of winds: a velocity of the air that depends on place and time. Two of them are added by
    `+`.

    An effect takes it as `wind=` or `flow=`. Place and velocity are in inertial axes that coincide
    with frame a at t = 0, the place from the origin of frame a.

    Examples:
        >>> @dataclass(frozen=True)
        ... class Vortex(extend.WindField):  # about the z axis
        ...     spin: extend.Value = extend.leaf(0)  # rad/s
        ...
        ...     def velocity(self, position, t):
        ...         x, y, z = position.unbind(-1)
        ...         return self.spin[..., None, None] * torch.stack((-y, x, 0 * z), -1)
        >>> Vortex(torch.tensor(2.0)).velocity(torch.tensor([[1.0, 0, 0]]), torch.tensor(0.0))
        tensor([[-0., 2., 0.]])
    """

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        """Velocity (..., sites, 3) m/s of the air at position (..., sites, 3) m and t (0-dim) s."""
        raise NotImplementedError

    def resolved(self, t: Tensor, inputs: Inputs, like: Tensor) -> WindField:
        """The same with numbers in the place of functions of t and of inputs; itself where there
        are none.
        """
        return at_instant(self, t, inputs, like)

    def __str__(self) -> str:
        return self.called

    def __add__(self, other: Any) -> WindField:
        return WindSum(self, other) if isinstance(other, WindField) else NotImplemented

    def __radd__(self, other: Any) -> WindField:
        """What `sum` begins with is no wind."""
        return self if isinstance(other, int) and other == 0 else NotImplemented


@dataclass(frozen=True, eq=False)
class WindSum(WindField):
    """Sum of two winds."""

    first: WindField = leaf(1)
    second: WindField = leaf(1)

    def __str__(self) -> str:
        return f"{self.first} + {self.second}"

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        return self.first.velocity(position, t) + self.second.velocity(position, t)


@dataclass(frozen=True, eq=False)
class Wind(WindField):
    """Mean wind, uniform or with a shear profile over the height z above ground.

    With the `exponent` p the profile is the power law, with the `roughness` length z0 the
    logarithmic one. Both are 1 at the `height` h of the origin, and 0 at the ground:

        V = mean (z/h)^p        V = mean log(z/z0)/log(h/z0)        z = h + up . position

    Args:
        mean: (..., 3) m/s at the origin, or a function of t, or an Input
        exponent: (...) p; 0.2 over land (IEC 61400-1)
        roughness: (...) z0, m; 0.03 over grass
        height: (...) h, m, of the origin above ground; needed with a profile
        up: (..., 3) of any length

    Raises:
        ValueError: for both profiles, one without a height, a height not above the roughness.

    Examples:
        >>> wind = tb.Wind((10.0, 0, 0), exponent=0.2, height=90.0)
        >>> wind.velocity(torch.tensor([[0.0, 0, 0], [0, 0, 60.0]]), torch.tensor(0.0))[:, 0]
        tensor([10.0000, 11.0757])
    """

    mean: Value | Callable[[Tensor], Tensor] | Input = leaf(1, check=_mean)
    exponent: Value | None = leaf(0, default=None, kw_only=True, check=positive)
    roughness: Value | None = leaf(0, default=None, kw_only=True, check=positive)
    height: Value | None = leaf(0, default=None, kw_only=True, check=positive)
    up: Value = leaf(1, default=(0.0, 0.0, 1.0), kw_only=True, check=direction)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent is not None and self.roughness is not None:
            raise refusal("Wind with an exponent and a roughness", "one of them")
        if self.sheared != (self.height is not None):
            lacks = "a height" if self.height is None else "an exponent or a roughness"
            raise refusal(f"Wind without {lacks}", "a profile and its height")
        if self.roughness is not None and concrete(self.height <= self.roughness).any():
            raise refusal("Wind with a height within the roughness", "a height above it")

    @property
    def sheared(self) -> bool:
        return self.exponent is not None or self.roughness is not None

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        mean = value_at(self.mean, t, {}, position)[..., None, :]
        if not self.sheared:
            return mean + torch.zeros_like(position)
        h = at_each(self.height)
        z = h + along(self.up, position)
        least = torch.zeros_like(z) if self.roughness is None else at_each(self.roughness) + 0 * z
        z_above = torch.where(z > least, z, h)
        if self.roughness is None:
            profile = (z_above / h) ** at_each(self.exponent)
        else:
            profile = torch.log(z_above / least) / torch.log(h / least)
        return mean * torch.where(z > least, profile, torch.zeros_like(z))[..., None]


@dataclass(frozen=True, eq=False)
class Gust(WindField):
    """A discrete gust, "1 - cosine", that travels or comes everywhere at once.

        V = peak/2 (1 - cos(pi s/gradient)),    0 < s < 2 gradient
        s = speed (t - start) - direction . position

    (EASA CS 25.341(a), FAR 25.341(a).)

    Args:
        peak: (..., 3) m/s in the middle of the gust
        gradient: (...) H, m, from its front to its middle
        speed: (...) m/s by which it travels; in a wind tunnel, or seen from a vehicle, the airspeed
        direction: (..., 3) in which it travels, of any length; None: it is the same everywhere
        start: (...) s, when its front is at the origin

    Raises:
        ValueError: for a gradient or a speed that is not positive, a direction of length 0.

    Examples:
        >>> gust = tb.Gust((0, 0, 5.0), gradient=20.0, speed=50.0)
        >>> gust.velocity(torch.zeros(1, 3), torch.tensor(0.4))  # its middle
        tensor([[0., 0., 5.]])
    """

    peak: Value = leaf(1, check=vector)
    gradient: Value = leaf(0, check=positive)
    speed: Value = leaf(0, kw_only=True, check=positive)
    direction: Value | None = leaf(1, default=None, kw_only=True, check=direction)
    start: Value = leaf(0, default=0.0, kw_only=True, check=lambda n, v: tensor(real_numbers(n, v)))

    @classmethod
    def certification(
        cls, reference: Value, gradient: Value, *, up: Value = (0.0, 0.0, 1.0),
        alleviation: Value = 1.0, **more: Any,
    ) -> Gust:  # fmt: skip
        """The design gust of CS 25.341(a): its peak is `alleviation` F_g times `reference` U_ref
        (...) m/s times (gradient/106.68 m)^(1/6), along `up`; more: arguments of `Gust`.

        Examples:
            >>> tb.Gust.certification(17.07, 106.68, speed=200.0).peak
            tensor([ 0.0000,  0.0000, 17.0700])
        """
        H, reference = positive("a Gust's gradient", gradient), positive("U_ref", reference)
        size = reference * positive("a Gust's alleviation", alleviation) * (H / EVEN) ** (1 / 6)
        return cls(size[..., None] * direction("a Gust's up", up), H, **more)

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        H = at_each(self.gradient)
        s = at_each(self.speed) * (t - at_each(self.start))
        if self.direction is not None:
            s = s - along(self.direction, position)
        turns = (s / H).clamp(0, 2) * math.pi
        share = (1 - torch.cos(turns)) / 2
        return share[..., None] * self.peak[..., None, :] + torch.zeros_like(position)
