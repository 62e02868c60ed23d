"""The common dynamic case: what other programs are compared on, and its published trajectory."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchbeam as tb

from .harness import data

SPACES = {"3D": None, "plane": "xy"}
KINDS = ("linear", "linked", "order 2")  # of elements; linked: linear ones, by `Beam.linked`
STRIP = dict(EA=4e4, GA=1.4835e4, GJ=0.769, EI=1.0, mass=0.2, inertia=5e-6)


class Case(NamedTuple):
    """The common dynamic case: a clamped beam along x, a dead transverse force of 1 N on its tip,
    suddenly at t = 0.

    t (time,) s, tip (time, 3) m: converged in space and time by two independent codes; not exact
    below 2e-4 relative.
    """

    t: Tensor
    tip: Tensor

    @classmethod
    def load(cls, dtype: torch.dtype = torch.float64) -> Case:
        known = data("dynamic_step_load")
        return cls(*(torch.tensor(known[x], dtype=dtype) for x in ("t", "tip")))

    def scene(
        self,
        elements: int,
        plane: str | None = None,
        EI: Tensor | float = 1.0,
        force: Any = (0.0, 1.0, 0.0),
        element: str = "linear",
    ) -> tb.Scene:
        """element: one of `KINDS`."""
        number = self.t.new_tensor
        section = tb.Section.from_stiffness(
            **{
                **{name: number(value) for name, value in STRIP.items()},
                "EI": torch.as_tensor(EI, dtype=self.t.dtype),
            }
        )
        return tb.Scene(
            straight(number(1.0), elements, section, element),
            [tb.TipLoad(force=force)],
            plane=plane,
        )

    def error(self, solution: tb.Solution) -> float:
        """RMS |tip - reference| / RMS |reference - reference(0)| at the solution's instants, which
        are the reference's.
        """
        at = torch.searchsorted(self.t, solution.t - 1e-9)
        tip = solution.tip.position.detach()
        return difference(tip.reshape(len(tip), -1, 3)[:, 0], self.tip[at], self.tip[0])


def difference(path: Tensor, reference: Tensor, start: Tensor | None = None) -> float:
    """RMS |path - reference| / RMS |reference - its start|, (time, ..., 3) each; start (..., 3),
    None = the first of the reference.
    """
    moved = reference - (reference[0] if start is None else start)
    return ((path - reference).square().sum() / moved.square().sum()).sqrt().item()


def straight(length: Tensor, elements: int, section: tb.Section, element: str) -> tb.Beam:
    """A beam of an element of `KINDS`."""
    beam = tb.Beam.straight(length, elements, section, order=2 if element == "order 2" else 1)
    return beam.linked() if element == "linked" else beam


def motion(
    case: Case,
    space: str,
    elements: int,
    step: float,
    every: int | None = None,
    element: str = KINDS[0],
    **options: Any,
) -> tb.Solution:
    """The whole 2 s, at batch 1; every: how many of the reference's instants lie between two of the
    solution's.
    """
    with torch.no_grad():
        t = case.t[:: every or max(1, round(step / 0.01))]
        return tb.simulate(
            case.scene(elements, SPACES[space], element=element), t, step=step, **options
        )
