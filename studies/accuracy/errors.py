"""Errors of space and of time apart: what a mesh is off by at equal steps, and what a step is off
by on one mesh.

The error of a setting is about the sum of the two, so that mesh and step can be balanced without
trying all pairs; and where they would cancel in a pair, as they do in some, that is not taken for
accuracy.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .motions import Motion
from .references import difference
from .settings import MESHES, STEPS, TOLERANCES, Setting

# linear elements on which steps are compared; fast waves matter
MESH = {"smooth": 16, "damped": 16, "sudden": 48}
COMMON = 40  # instants that runs by different steps have in common
EQUAL = 400  # midpoint steps by which meshes are compared
LIMIT = (16, 32)  # elements of order 2 whose extrapolation they are compared with
LEAST = 2e-7  # errors that are not looked into


class Of(NamedTuple):
    """Of a mesh: elements, error, the number of its nodes. Of a step: steps or rtol, error, CPU s
    per node and four more.
    """

    fineness: float
    error: float
    cost: float


class Errors(NamedTuple):
    """By element and by method."""

    space: dict[str, list[Of]]
    time: dict[str, list[Of]]

    def pair(self, element: str, method: str, wanted: float) -> tuple[Setting, float] | None:
        """The cheapest mesh and step whose errors add up to no more than is wanted, and its CPU s
        as they are expected; None where there is none.
        """
        pairs = [
            (step.cost * (mesh.cost + 4), mesh, step)
            for mesh in self.space[element]
            for step in self.time[method]
            if mesh.error + step.error <= wanted
        ]
        if not pairs:
            return None
        cost, mesh, step = min(pairs, key=lambda pair: pair[0])
        return Setting(element, method, int(mesh.fineness), step.fineness), cost


def measure(
    motion: Motion, seconds: float, elements: Sequence[str], methods: Sequence[str]
) -> Errors:
    """Of a motion, in the plane that it stays in; at most about so many CPU seconds."""
    with torch.no_grad(), warnings.catch_warnings():
        # a step that is too long is an error of inf
        warnings.simplefilter("ignore", RuntimeWarning)
        each = seconds / (len(elements) + len(methods) + 1)
        coarse, fine = (_tip(motion, "order 2", count) for count in LIMIT)
        return Errors(
            _space(motion, elements, each, fine + (fine - coarse) / 15),
            _time(motion, methods, each),
        )


def _tip(motion: Motion, element: str, count: int) -> Tensor:
    return Setting(element, "midpoint", count, EQUAL).run(motion, flat=True).tip.position


def _error(tip: Tensor, limit: Tensor) -> float:
    error = difference(tip, limit)
    return math.inf if math.isnan(error) else error


def _space(
    motion: Motion, elements: Sequence[str], seconds: float, limit: Tensor
) -> dict[str, list[Of]]:
    by_elements: dict[str, list[Of]] = {}
    for element in elements:
        end, by_elements[element] = time.process_time() + seconds, []
        for count in MESHES[element]:
            error = _error(_tip(motion, element, count), limit)
            by_elements[element].append(Of(count, error, Setting(element, "", count, 0).nodes()))
            if error < LEAST or time.process_time() > end:
                break
    return by_elements


def _time(motion: Motion, methods: Sequence[str], seconds: float) -> dict[str, list[Of]]:
    mesh = MESH[motion.kind]
    limit, end = None, time.process_time() + seconds
    for steps in STEPS[STEPS.index(800) :: 2]:
        begun = time.process_time()
        tip = (
            Setting("linear", "midpoint4", mesh, steps).run(motion, COMMON, flat=True).tip.position
        )
        before = limit
        limit, now = tip, time.process_time()
        if (before is not None and difference(tip, before) < LEAST) or 3 * now - 2 * begun > end:
            break
    by_steps: dict[str, list[Of]] = {}
    for method in methods:
        end, by_steps[method] = time.process_time() + seconds, []
        for fineness in TOLERANCES if method == "adaptive" else STEPS:
            setting = Setting("linear", method, mesh, fineness)
            count, begun = math.gcd(setting.instants(), COMMON), time.process_time()
            sol = setting.run(motion, count, flat=True)
            tip = sol.tip.position
            spent = time.process_time() - begun
            error = math.inf if sol.status.any() else _error(tip, limit[:: COMMON // count])
            by_steps[method].append(Of(fineness, error, spent / (mesh + 4)))
            if error < LEAST or time.process_time() + 2 * spent > end:
                break
    return by_steps
