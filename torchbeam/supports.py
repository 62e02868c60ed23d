"""How a beam is held and carried: supports of nodes, motion of the clamp, motion of frame a."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .checks import Value, as_tensor, axis_last, common_dtype, finite, increasing

AXES = "xyz"
Motion = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Frame:
    """Prescribed motion of frame a, in its own axes: values (..., 3) or functions t -> (..., 3).

    velocity          v of the origin, m/s
    angular_velocity  omega, rad/s
    """

    velocity: Value | Motion | None = None
    angular_velocity: Value | Motion | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "angular_velocity"):
            _motion(self, name)


@dataclass(frozen=True)
class RootMotion:
    """Motion of the clamp in frame a: functions t -> (..., 3).

    displacement  of node 0 from its place in the beam, m
    rotation      of node 0 from its axes in the beam: a rotation vector, rad, frame a
    """

    displacement: Motion | None = None
    rotation: Motion | None = None

    def __post_init__(self) -> None:
        for name in ("displacement", "rotation"):
            _motion(self, name)

    @classmethod
    def shaken(cls, t: Value, acceleration: Value) -> RootMotion:
        """The clamp of a shaker or in an earthquake: at rest at t[0], then with the recorded acceleration.

        t             (n,) s, strictly increasing
        acceleration  (..., n, 3) m/s^2, frame a: straight lines between the samples, integrated twice exactly; zero outside
        """
        return cls(displacement=Record(t, acceleration))


@dataclass(frozen=True)
class Record:
    """A displacement (..., 3) m as a function of t whose second derivative is a sampled acceleration, see `RootMotion.shaken`.

    t (n,) s;  acceleration, velocity, displacement (..., n, 3) at the samples
    """

    t: Tensor
    acceleration: Tensor

    def __post_init__(self) -> None:
        dtype, device = common_dtype(self.t, self.acceleration)
        t, a = (as_tensor(v, dtype, device) for v in (self.t, self.acceleration))
        increasing("a record's t", t)
        if a.ndim < 2 or a.shape[-2:] != (len(t), 3):
            raise ValueError(f"an acceleration of shape {tuple(a.shape)} was given; (..., {len(t)}, 3) is wanted")
        finite("a record's acceleration", a)
        h = t.diff()[:, None]
        first, last = a[..., :-1, :], a[..., 1:, :]
        velocity = _running_sum(h * (first + last) / 2)
        displacement = _running_sum(h * velocity[..., :-1, :] + h**2 * (2 * first + last) / 6)
        for name, value in dict(t=t, acceleration=a, velocity=velocity, displacement=displacement).items():
            object.__setattr__(self, name, value)

    def __call__(self, t: Tensor) -> Tensor:
        """(..., 3) at the instant t (0-dim)."""
        last = len(self.t) - 1
        k = (torch.searchsorted(self.t.detach(), t.detach().to(self.t), right=True) - 1).clamp(0, last - 1).reshape(1)
        a, b = (self.t.index_select(0, i)[0] for i in (k, k + 1))
        here, there = (self.acceleration.index_select(-2, i)[..., 0, :] for i in (k, k + 1))
        v, u = (x.index_select(-2, k)[..., 0, :] for x in (self.velocity, self.displacement))
        s = torch.minimum(t.to(self.t), b) - a
        s = s.clamp(min=0)
        beyond = (t.to(self.t) - self.t[-1]).clamp(min=0)  # the record is over: constant velocity
        return u + s * v + s**2 * here / 2 + s**3 / (b - a) * (there - here) / 6 + beyond * self.velocity[..., -1, :]


@dataclass(frozen=True)
class Support:
    """What of a node is prescribed.

    node          counts from the root, -1 is the tip
    position      the components in frame a that are held: "xyz" all, "yz" a slide along x, "" none
    rotation      "xyz" all; two letters: a hinge about the third axis of frame a; "": a pin
    displacement  function t -> (..., 3) m: motion of the held components, frame a. None = they stay where the beam has them
    turn          function t -> (..., 3) rad: rotation vector from the node's axes in the beam, frame a; wants rotation="xyz"

    Raises ValueError for other letters, a rotation about which one axis is held, or a motion of what is not held.
    """

    node: int
    position: str = AXES
    rotation: str = AXES
    displacement: Motion | None = None
    turn: Motion | None = None

    def __post_init__(self) -> None:
        if isinstance(self.node, bool) or not isinstance(self.node, int):
            raise ValueError(f"node = {self.node!r} was given; a whole number is wanted")
        for name in ("position", "rotation"):
            letters = getattr(self, name)
            if not isinstance(letters, str) or set(letters) - set(AXES) or len(set(letters)) != len(letters):
                raise ValueError(f"{name} = {letters!r} was given; some of the letters x, y and z are wanted, or none")
        if len(self.rotation) == 1:
            raise ValueError(f"rotation = {self.rotation!r} was given; all three components are held, two (a hinge about the "
                             "third) or none")
        for name in ("displacement", "turn"):
            _motion(self, name)
        if self.displacement is not None and not self.position:
            raise ValueError("a displacement of a node whose position is free was given; held components are wanted")
        if self.turn is not None and len(self.rotation) < 3:
            raise ValueError(f"turn with rotation = {self.rotation!r} was given; rotation = 'xyz' is wanted")

    @property
    def held(self) -> tuple[bool, ...]:
        """Position x y z, rotation x y z."""
        return tuple(axis in letters for letters in (self.position, self.rotation) for axis in AXES)

    @property
    def clamp(self) -> bool:
        return all(self.held)

    @property
    def moves(self) -> bool:
        return self.displacement is not None or self.turn is not None


def _running_sum(steps: Tensor) -> Tensor:
    return torch.cat((torch.zeros_like(steps[..., :1, :]), steps.cumsum(-2)), -2)


def _motion(owner: Any, name: str) -> None:
    value = getattr(owner, name)
    if value is not None and not callable(value):
        value = torch.as_tensor(value, dtype=None if isinstance(value, Tensor) else torch.get_default_dtype())
        object.__setattr__(owner, name, finite(name, axis_last(name, value, 3)))
