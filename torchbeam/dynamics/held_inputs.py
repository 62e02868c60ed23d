"""Inputs of one step of a method, whatever solves it is made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..scene.effects import Inputs, inputs_at
from .method import Method

GivenInputs = dict[str, Any] | Callable[[float], dict[str, Any]]  # held over a step, or functions of the share that has passed


class HeldInputs:
    """Inputs by name (..., size): values that are held over the step, or a function of the share of it that has passed."""

    def __init__(self, given: Inputs | Callable[[float], Inputs]) -> None:
        self.given = given
        self._known: dict[float, Inputs] = {}

    def __call__(self, share: float) -> Inputs:
        if not self.vary:
            return self.given
        if share not in self._known:
            self._known[share] = self.given(share)
        return self._known[share]

    @property
    def vary(self) -> bool:
        return callable(self.given)

    def map(self, change: Callable[[Any], Inputs]) -> HeldInputs:
        """With `change` of what is given at any share."""
        return HeldInputs((lambda share: change(self(share))) if self.vary else change(self.given))

    def part(self, first: float, size: float) -> HeldInputs:
        """Of a part of the step that begins at the share `first` and is a share `size` of it."""
        return HeldInputs(lambda share: self(first + share * size)) if self.vary else self


def given_from(inputs: dict[str, Any], begin: Tensor, length: Tensor, like: Tensor, interval: int) -> GivenInputs:
    """What a step from `begin` on is given of `inputs`, see `inputs_at`."""
    if any(callable(value) for value in inputs.values()):
        return lambda share: inputs_at(inputs, begin + share * length, like, interval)
    return inputs_at(inputs, begin, like, interval)


def changes_within(inputs: dict[str, Any], method: Method) -> bool:
    """Whether the solves of one step have different inputs."""
    return method.SOLVES_A_STEP > 1 and any(callable(value) for value in inputs.values())


def together(steps: list[HeldInputs], instants: list[float], shape: torch.Size | None) -> Inputs:
    """Those of steps, each at these instants of it, (steps x instants, ..., size), with the samples' `shape`; or those
    of all, where nothing changes, (..., size).
    """
    if len(steps) == 1 and not steps[0].vary:
        return steps[0].given
    rows: list[Inputs] = []
    for one in steps:
        rows += [one(share) for share in instants] if one.vary else [one.given] * len(instants)

    def stacked(name: str) -> Tensor:
        return torch.stack([row[name].expand(*shape, -1) for row in rows])

    return {name: stacked(name) for name in rows[0]}
