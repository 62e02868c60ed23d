"""Actuation: eigenstrain, the strain and curvature of the unloaded beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import listed, whole
from ...core.declared import one_of
from ...core.leaves import leaf, option
from ...core.validation import Value, refusal
from ...math.shapes import stacked
from .effect import Effect
from .values import Along, Inputs, LoadValue, PerElement, line_value, value_at


def _of_elements(name: str, value: Any) -> Any:
    value = line_value(name, value)
    if isinstance(value, Along):
        raise ValueError(
            "Actuation with a function Along the beam was given; PerElement gives each element "
            "its own"
        )
    return value


def _chosen(name: str, elements: Any) -> Any:
    """Numbers of elements, or a slice of them."""
    if isinstance(elements, slice):
        return elements
    numbers = tuple(whole("an element", element) for element in listed(elements))
    if not numbers:
        raise refusal("Actuation of no elements", "the numbers of some, or None for all,", are=True)
    return numbers


@dataclass(frozen=True)
class Actuation(Effect):
    """Intrinsic curvature and strain: the shape of the unloaded beam under piezo patches, tendons
    or heat.

    [F; M] = S^-1 (strain - intrinsic).

    Args:
        curvature: (..., 3) 1/m, twist and bending about y and z, frame B: numbers, a function of t,
            an `Input`, or `PerElement` (..., N, 3)
        strain: (..., 3) likewise: stretch, shear along y and z
        elements: which elements: None = all, a range, a slice, or their numbers from the root
        on: name of a beam of a structure; None = all

    Raises:
        ValueError: if neither is given, or an element does not exist.

    Examples:
        >>> bent = tb.Scene(
        ...     beam, [tb.Actuation(curvature=(0, -1.0, 0))]
        ... )  # 1/m, piezo patches or tendons
        >>> tb.equilibrium(bent).tip.position  # an arc of radius 1 m
        tensor([0.8437, 0.0000, 0.4609])
    """

    curvature: Value | None = leaf(1, default=None, check=_of_elements)
    strain: Value | None = leaf(1, default=None, check=_of_elements)
    elements: range | slice | Sequence[int] | None = option(_chosen, default=None)
    on: str | None = field(default=None, kw_only=True)

    kind = "eigenstrain"

    def __post_init__(self) -> None:
        one_of(self, "curvature", "strain")
        super().__post_init__()

    @property
    def by_place(self) -> bool:
        return self.elements is not None or any(
            isinstance(value, PerElement) for value in (self.curvature, self.strain)
        )

    def eigenstrain(self, t: Tensor, inputs: Inputs, like: Tensor, count: int) -> Tensor:
        """[gamma; kappa] (..., N or 1, 6) of the unloaded beam at time t; `count` = N, dtype and
        device of `like`.
        """
        parts = [
            like.new_zeros(1, 3) if v is None else self._value(v, t, inputs, like, count)
            for v in (self.strain, self.curvature)
        ]
        both = stacked(*parts, axis=-1)
        if self.elements is None:
            return both
        part = isinstance(self.elements, slice)
        at = torch.arange(count)[self.elements] if part else torch.tensor(self.elements)
        if at.numel() == 0 or (at < -count).any() or (at >= count).any():
            raise ValueError(
                f"elements = {self.elements!r} was given for a beam of {count}; numbers from 0 to "
                f"{count - 1} are wanted"
            )
        here = torch.zeros(count, 1, dtype=like.dtype, device=like.device)
        here[at] = 1
        return here * both

    def _value(
        self, value: LoadValue, t: Tensor, inputs: Inputs, like: Tensor, count: int
    ) -> Tensor:
        if isinstance(value, PerElement):
            return value(like.new_empty(count), t, inputs, count)
        return value_at(value, t, inputs, like)[..., None, :]
