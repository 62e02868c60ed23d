"""Actuators: from actions to effects on the beam. Each drives one `torchbeam.Input` of the
scene.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import Tree, inputs_of

from .episodes import Episodes
from .parameters import numbers


@dataclass(frozen=True)
class Actuator:
    """An effect with one `torchbeam.Input`, whose value is linear in some of the actions:
    value = action @ gain + bias.

    Args:
        effect: any effect of `torchbeam` that takes an `Input`
        gain: (actions, size of the input): input at an action of 1, in its own units
        bias: (size of the input): the value at an action of 0; None = zero. A tendon is pulled by 0
            to 10 N under actions from -1 to 1 with gain=[[5.0]], bias=[5.0]

    Raises:
        ValueError: for an effect with no input or several, or a gain or bias of another shape.

    Examples:
        >>> bend = tb.Actuation(curvature=tb.Input("tendons", 3))
        >>> tendons = envs.Actuator(bend, [[0, 5.0, 0], [0, 0, 5.0]])  # two pairs of them
        >>> motor = envs.Actuator(tb.PointLoad(0, moment=tb.Input("torque", 3)), [[0, 0, 1.0]])
        >>> motor.inputs(torch.tensor([[0.5]]))  # N m
        {'torque': tensor([[0.0000, 0.0000, 0.5000]])}
    """

    effect: Any
    gain: Any
    bias: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        inputs = inputs_of(self.effect) if isinstance(self.effect, Tree) else []
        if len(inputs) != 1:
            raise ValueError(
                f"an effect with {len(inputs)} inputs was given to an Actuator; one "
                "`torchbeam.Input` is wanted"
            )
        gain = self.gain
        gain = gain if isinstance(gain, Tensor) else torch.from_numpy(numbers("gain", gain))
        if (
            gain.ndim != 2
            or gain.shape[1] != inputs[0].size
            or not len(gain)
            or not torch.isfinite(gain).all()
        ):
            raise ValueError(
                f"a gain of shape {tuple(gain.shape)} was given for the input {inputs[0].name!r}; "
                f"finite (actions, {inputs[0].size}) is wanted"
            )
        object.__setattr__(self, "gain", gain)
        if self.bias is not None:
            bias = self.bias
            bias = bias if isinstance(bias, Tensor) else torch.from_numpy(numbers("bias", bias))
            bias = bias.to(gain.dtype)
            if bias.shape != gain.shape[1:] or not torch.isfinite(bias).all():
                raise ValueError(
                    f"a bias of shape {tuple(bias.shape)} was given for the input "
                    f"{inputs[0].name!r}; finite ({inputs[0].size},) is wanted"
                )
            object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "input", inputs[0].name)

    @property
    def actions(self) -> int:
        """Number of actions that drive it."""
        return len(self.gain)

    def to(self, like: Tensor) -> Actuator:
        """The same in the dtype and on the device of `like`."""
        bias = None if self.bias is None else self.bias.to(like)
        return replace(self, gain=self.gain.to(like), bias=bias)

    def scaled(self, share: float) -> Actuator:
        """The actuator with a share of its effect."""
        return replace(self, gain=share * self.gain)

    def effects(self, varying: Collection[str] = ()) -> tuple[Any, ...]:
        """Effects that it adds to a scene in which the parameters named in `varying` change with
        the episode.
        """
        return (self.effect,)

    def inputs(self, action: Tensor, now: Episodes | None = None) -> dict[str, Tensor]:
        """name -> (..., size) for actions (..., actions); `now`: where the episodes stand, None in
        statics.
        """
        value = action.to(self.gain) @ self.gain
        return {self.input: value if self.bias is None else value + self.bias}

    def tip_force(self, action: Tensor, now: Episodes) -> Tensor | None:
        """(n, 3) N in frame a, drawn at the tip; None without."""
        return None


@dataclass(frozen=True)
class TipForce(Actuator):
    """A force on the tip, along the rows of gain (actions, 3) N.

    It keeps its direction in frame a; or, `follower`, it turns with the tip, in its section axes. A
    fixed force acts at a point `offset` (a parameter, m) beyond the last node, along the beam.

    Examples:
        >>> force = envs.TipForce(gain=[[0, 0.5, 0], [0, 0, 0.5]])  # N at an action of 1
        >>> force.inputs(torch.tensor([[1.0, -0.5]]))
        {'force': tensor([[ 0.0000,  0.5000, -0.2500]])}
    """

    effect: Any = None
    gain: Any = ()
    follower: bool = False

    def __post_init__(self) -> None:
        if self.effect is None:
            object.__setattr__(
                self, "effect", tb.TipLoad(force=tb.Input("force", 3), follower=self.follower)
            )
        super().__post_init__()

    def effects(self, varying: Collection[str] = ()) -> tuple[Any, ...]:
        return (
            (replace(self.effect, moment=tb.Input("moment", 3)),)
            if "offset" in varying
            else (self.effect,)
        )

    def inputs(self, action: Tensor, now: Episodes | None = None) -> dict[str, Tensor]:
        given = super().inputs(action)
        if now is None or "moment" not in now.plant.scene.inputs:
            return given
        # held over the interval, like the force
        along = now.beam.tip.rotation[..., 0] * now.plant.params["offset"][:, None]
        return {**given, "moment": torch.linalg.cross(along, given[self.input])}

    def tip_force(self, action: Tensor, now: Episodes) -> Tensor:
        force = Actuator.inputs(self, action)[self.input]
        return (now.beam.tip.rotation @ force[..., None])[..., 0] if self.follower else force


def driven(
    actuators: Sequence[Actuator], action: Tensor, now: Episodes | None = None
) -> dict[str, Tensor]:
    """name -> (..., size): the inputs of all actuators under actions (..., a), which they share out
    in their order.
    """
    if len(actuators) == 1:
        return actuators[0].inputs(action, now)
    parts = action.split([each.actions for each in actuators], -1)
    return {
        name: value
        for each, part in zip(actuators, parts, strict=True)
        for name, value in each.inputs(part, now).items()
    }
