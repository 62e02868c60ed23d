"""Settings: an element, a method, and how fine both are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from torch import Tensor

import torchbeam as tb

from .motions import INTERVALS, Motion

METHODS = "midpoint", "midpoint4", "generalized_alpha", "adaptive"
FORMS = "nodal, linked", "minimal", "block_rate"
EXPLICIT = "dopri5", "dopri8", "bosh3", "rk4"
BASE = "linear", "midpoint"  # what the others are compared with
TARGETS = 0.05, 0.01, 1e-3, 1e-4, 1e-6
MESHES = {
    "linear": (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192),
    "linked": (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192),
    "order 2": (2, 3, 4, 6, 8, 12, 16, 24, 32, 48),
}
# of a motion: multiples of LOSS
STEPS = (10, 20, 30, 40, 60, 80, 100, 150, *(n * 2**k for k in range(12) for n in (200, 300)))
TOLERANCES = tuple(m * 10.0**-k for k in range(1, 8) for m in (3, 1))
OUTPUTS = 120  # instants of a run, at most


@dataclass(frozen=True)
class Setting:
    """What a motion is made by: `fineness` is the number of steps or, of adaptive and explicit
    ones, rtol.
    """

    element: str
    method: str
    elements: int
    fineness: float

    def nodes(self) -> int:
        return self.elements * (2 if self.element == "order 2" else 1)

    def options(self, motion: Motion) -> dict[str, Any]:
        """Of `simulate`."""
        if self.method == "adaptive":
            return dict(rtol=self.fineness)
        return dict(method=self.method, step=motion.duration / self.fineness)

    def instants(self) -> int:
        """Output intervals: into which steps and the reference's instants fit."""
        if self.method == "adaptive":
            return OUTPUTS
        return max(
            d for d in range(1, OUTPUTS + 1) if math.gcd(int(self.fineness), INTERVALS) % d == 0
        )

    def run(
        self, motion: Motion, count: int | None = None, by: Tensor | None = None, flat: bool = False
    ) -> tb.Solution:
        """The motion, with so many output intervals (None = `instants`); by, flat: see
        `Motion.scene`.
        """
        return tb.simulate(
            motion.scene(self.element, self.elements, by, flat),
            motion.instants(count or self.instants()),
            **self.options(motion),
        )

    def fineness_text(self) -> str:
        return (
            f"rtol {self.fineness:.0e}".replace("e-0", "e-")
            if self.method == "adaptive"
            else f"{self.fineness:g} steps"
        )
