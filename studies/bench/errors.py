"""Errors of ten fixed settings against published answers. They are the same on every machine, but
for rounding: what makes answers worse is found beside what makes them dearer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from ..common_case import Case, motion
from ..verification.motion import frequencies
from ..verification.statics import heavy

# the common dynamic case: space, elements, of which kind, and how it is simulated
MOTIONS: tuple[tuple[str, int, str, dict[str, Any]], ...] = (
    ("plane", 4, "linear", {"step": 0.01}),
    ("plane", 4, "linked", {"step": 0.01}),
    ("plane", 4, "order 2", {"step": 0.005}),
    ("plane", 8, "linked", {"step": 0.02, "method": "midpoint4"}),
    ("plane", 8, "linear", {"step": 0.005, "method": "generalized_alpha"}),
    ("plane", 8, "linear", {"step": 0.005, "conserve": True}),
    ("plane", 8, "linear", {"step": None, "rtol": 0.01}),
    ("3D", 4, "linear", {"step": 0.01}),
)
STATICS: dict[str, Callable[[], tuple[Tensor, Tensor]]] = {
    "heavy elastica, 8 linear": partial(heavy, 8),
    "frequencies, 8 linear": partial(frequencies, True, 8),
}


def errors() -> dict[str, float]:
    """By name; relative, RMS: of the tip's path over 2 s, of equilibria, of frequencies."""
    case, by_name = Case.load(), {}
    for space, elements, element, options in MOTIONS:
        said = ", ".join(f"{name} {value}" for name, value in options.items() if value)
        solution = motion(case, space, elements, element=element, every=2, **options)
        by_name[f"{space}, {elements} {element}, {said}"] = case.error(solution)
    for name, answers in STATICS.items():
        value, published = answers()
        by_name[name] = ((value - published).norm() / published.norm()).item()
    return by_name
