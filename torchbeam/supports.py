"""How a beam is held and carried: supports of nodes, motion of the clamp, motion of frame a."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .checks import Value, axis_last, finite

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
    """Motion of the clamp in frame a: functions t -> (..., 3); `Accelerogram` is one, of a shaker or an earthquake.

    displacement  of node 0 from its place in the beam, m
    rotation      of node 0 from its axes in the beam: a rotation vector, rad, frame a
    """

    displacement: Motion | None = None
    rotation: Motion | None = None

    def __post_init__(self) -> None:
        for name in ("displacement", "rotation"):
            _motion(self, name)


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


def _motion(owner: Any, name: str) -> None:
    value = getattr(owner, name)
    if value is not None and not callable(value):
        value = torch.as_tensor(value, dtype=None if isinstance(value, Tensor) else torch.float64)  # the beam's, when used
        object.__setattr__(owner, name, finite(name, axis_last(name, value, 3)))
