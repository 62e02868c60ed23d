"""Effects: what acts on a beam besides its own elasticity and inertia. Only what a scene names exists.

An effect is a small frozen dataclass with one hook:
    load    `wrench(site, t, inputs)`: force and moment that act on sites of the beam
    strain  `Damping`: stress that follows the strain rate
A load acts on one node (`node` is an index) or along the beam, per unit length (`node` is None). Sites may be nodes or
elements: an effect does not know which form of the beam asks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .beam import Beam
from .checks import Value, as_tensor, axis_last, common_dtype, count, finite, increasing, positive
from .quaternions import hat


@dataclass(frozen=True)
class Input:
    """In place of a load's value: `size` numbers by `name`, given at each step (or call) and held over it."""

    name: str
    size: int

    def __post_init__(self) -> None:
        count("size", self.size)


@dataclass(frozen=True)
class History:
    """A load's value as a function of t: straight lines between samples, the first and the last held outside.

    t       (n,) s, strictly increasing
    values  (..., n, 3)

    Its rate, which the block rate form needs, is the slope of the line. Differentiable in t and in both tensors.
    """

    t: Tensor
    values: Tensor

    def __post_init__(self) -> None:
        dtype, device = common_dtype(self.t, self.values)
        t, values = (as_tensor(v, dtype, device) for v in (self.t, self.values))
        increasing("a History's t", t)
        if values.ndim < 2 or values.shape[-2:] != (len(t), 3):
            raise ValueError(f"a History's values of shape {tuple(values.shape)} were given; (..., {len(t)}, 3) are wanted")
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "values", finite("a History's values", values))

    def __call__(self, t: Tensor) -> Tensor:
        """(..., 3) at the instant t (0-dim)."""
        k = (torch.searchsorted(self.t.detach(), t.detach().to(self.t), right=True) - 1).clamp(0, len(self.t) - 2)
        k = k.reshape(1)  # a tensor all along: no number leaves torch
        a, b = self.t.index_select(0, k)[0], self.t.index_select(0, k + 1)[0]
        before, after = (self.values.index_select(-2, i)[..., 0, :] for i in (k, k + 1))
        return before + ((t.to(self.t) - a) / (b - a)).clamp(0, 1) * (after - before)


Inputs = dict[str, Tensor]
LoadValue = Tensor | np.ndarray | Callable[[Tensor], Tensor] | Input  # an array: plain numbers, of no dtype of their own


@dataclass(frozen=True)
class Site:
    """Where a load acts, seen once per evaluation.

    R     (..., 3, 3) section axes -> frame a
    mass  (..., 6, 6) section mass per length, in section axes; only along the beam
    """

    R: Tensor
    mass: Tensor | None = None

    def turn(self, v: Tensor) -> Tensor:
        """Section axes -> frame a."""
        return (self.R @ v[..., None])[..., 0]


@dataclass(frozen=True, kw_only=True)
class _Load:
    """Force and moment with a value each: a tensor (..., 3), a function t -> (..., 3), an `Input`, or None = absent.

    A dead load keeps its direction in frame a; a follower load is given in section axes and turns with the section.
    """

    force: Value | None = None
    moment: Value | None = None
    follower: bool = False

    hook = "load"

    def __post_init__(self) -> None:
        if self.force is None and self.moment is None:
            raise ValueError(f"{type(self).__name__} with neither force nor moment was given; one of them is wanted")
        for name in ("force", "moment"):
            object.__setattr__(self, name, _value(f"{type(self).__name__}'s {name}", getattr(self, name)))

    @property
    def values(self) -> tuple[LoadValue, ...]:
        return tuple(v for v in (self.force, self.moment) if v is not None)

    def moves(self, beam: Beam) -> bool:
        """Whether the wrench depends on the beam's configuration."""
        return self.follower

    @property
    def conservative(self) -> bool:
        """Whether its work depends on where the beam gets, not on how: a dead force's does, a dead moment's does not."""
        return self.moment is None and not self.follower

    def wrench(self, site: Site, t: Tensor, inputs: Inputs) -> tuple[Tensor | None, Tensor | None]:
        """Force and moment in frame a, N and N m (per metre along the beam); None where absent."""
        values = [None if v is None else self._at_sites(value_at(v, t, inputs, site.R)) for v in (self.force, self.moment)]
        return tuple(site.turn(v) if self.follower and v is not None else v for v in values)

    def spin_tangent(self, site: Site, t: Tensor, inputs: Inputs) -> tuple[Tensor | None, Tensor | None]:
        """d(force)/d(spin) and d(moment)/d(spin), (..., 3, 3): d(R f) = spin x R f."""
        return tuple(None if w is None else -hat(w) for w in self.wrench(site, t, inputs))

    def _at_sites(self, value: Tensor) -> Tensor:
        return value


@dataclass(frozen=True)
class PointLoad(_Load):
    """Force (N) and moment (N m) on one node; nodes count from the root, -1 is the tip."""

    node: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.node, bool) or not isinstance(self.node, int):
            raise ValueError(f"node = {self.node!r} was given; a whole number is wanted")


@dataclass(frozen=True)
class TipLoad(PointLoad):
    """Force (N) and moment (N m) on the last node."""

    node: int = -1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node != -1:
            raise ValueError(f"TipLoad with node = {self.node} was given; PointLoad takes a node")


@dataclass(frozen=True)
class LineLoad(_Load):
    """Force (N/m) and moment (N) per unit length along the whole beam, the same everywhere."""

    node = None

    def _at_sites(self, value: Tensor) -> Tensor:
        return value[..., None, :]


@dataclass(frozen=True)
class Gravity:
    """Uniform acceleration g (..., 3) m/s^2, in inertial axes that coincide with frame a at t = 0."""

    g: Value

    hook = "load"
    node = None
    conservative = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "g", _value("Gravity's g", self.g))

    @property
    def values(self) -> tuple[LoadValue, ...]:
        return (self.g,)

    def moves(self, beam: Beam) -> bool:
        return beam.offset  # the moment of the offset centre of mass turns; the force does not

    def wrench(self, site: Site, t: Tensor, inputs: Inputs) -> tuple[Tensor, Tensor | None]:
        """Per unit length: force R M11 R^T g, moment R M21 R^T g."""
        g = value_at(self.g, t, inputs, site.R)[..., None, :]
        body = (site.R.mT @ g[..., None])
        weight = site.mass[..., :3] @ body
        return tuple(site.turn(w[..., 0]) for w in (weight[..., :3, :], weight[..., 3:, :]))

    def spin_tangent(self, site: Site, t: Tensor, inputs: Inputs) -> tuple[Tensor, Tensor]:
        g = value_at(self.g, t, inputs, site.R)[..., None, :]
        turned = site.mass[..., :3] @ site.R.mT @ hat(g)
        return tuple(site.R @ part - hat(w) for part, w in
                     zip((turned[..., :3, :], turned[..., 3:, :]), self.wrench(site, t, inputs), strict=True))


@dataclass(frozen=True)
class Damping:
    """Stiffness-proportional damping: [F; M] = S^-1 (strain + tau * strain rate).

    tau  (...) s, one value; or (..., 6), one for each strain [gamma1..3, kappa1..3]: then the damping matrix is
         D^1/2 S^-1 D^1/2 with D = diag(tau), which is symmetric and never pumps energy.
    six  whether tau has six values; found from the shape (a last axis of six) unless given.

    Raises ValueError for a negative tau.
    """

    tau: Value
    six: bool | None = None

    hook = "strain"
    values = ()

    def __post_init__(self) -> None:
        tau = plain(self.tau)
        positive("tau", torch.as_tensor(tau), zero=True)
        six = self.six if self.six is not None else tau.ndim > 0 and tau.shape[-1] == 6
        object.__setattr__(self, "tau", axis_last("tau", tau, 6) if six else tau)
        object.__setattr__(self, "six", six)


Effect = Any  # any class with a `hook`


def value_at(value: LoadValue, t: Tensor, inputs: Inputs, like: Tensor) -> Tensor:
    """The load's value (..., 3) at time t; an `Input` is looked up by name.

    Raises ValueError where an input is missing or has the wrong last axis.
    """
    if isinstance(value, Input):
        if value.name not in inputs:
            given = ", ".join(sorted(inputs)) or "none"
            raise ValueError(f"the input {value.name!r} is wanted at each step; given were: {given}")
        return axis_last(f"input {value.name!r}", inputs[value.name], value.size)
    if callable(value):
        value = torch.as_tensor(value(t), dtype=like.dtype, device=like.device)
        return axis_last("a load function's value", value, 3)
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


def plain(value: Value) -> Tensor | np.ndarray:
    """A tensor as it is, a sequence that holds tensors stacked, and plain numbers as an array: they take the dtype of
    what they meet.
    """
    if isinstance(value, Tensor):
        return value
    if isinstance(value, (list, tuple)) and any(isinstance(v, Tensor) for v in value):
        return as_tensor(value, *common_dtype(value))
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{value!r} was given; numbers, a tensor, a function of t or an Input are wanted") from None


def _value(name: str, value: Value | None) -> LoadValue | None:
    if value is None or callable(value):
        return value
    if isinstance(value, Input):
        if value.size != 3:
            raise ValueError(f"{name} with an Input of size {value.size} was given; size 3 is wanted")
        return value
    value = axis_last(name, plain(value), 3)
    finite(name, torch.as_tensor(value))
    return value
