"""Base of laws with memory of a joint's coordinate q: the angle of a hinge, the travel of a slider.

A law resists by a load M, a moment or a force, that depends on how q has gone. In a step q goes
straight from `before` to `after`, and the law's load is a mean for which M (after - before) is what
it stores and loses, to rounding; it never loses less than nothing. In an equilibrium M is the load
at `after`, come to straight from `before`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.declared import own, parameter
from ..core.validation import Value, concrete, refusal, shown
from .coordinate_law import OwnLaw


@dataclass(frozen=True)
class HystereticLaw(OwnLaw):
    """Base of laws with memory: first the hysteretic variable, then the energy J that the law has
    lost since the start, then its own numbers. The slope of what has not moved is that of small
    vibrations.
    """

    memory = 2

    def stored(self, coordinate: Tensor, memory: Tensor) -> Tensor:
        """(...) J that it gives back, of a coordinate and what is remembered there."""
        raise NotImplementedError


def share(name: str, value: Value) -> Any:
    """A check of a field: (...) from 0 to 1."""
    held = parameter(name, value)
    if concrete(torch.as_tensor(held) > 1).any():
        raise refusal(f"{name} = {shown(value)}", "a number from 0 to 1")
    return own(held)
