"""Law: how an error falls with the fineness of a mesh or of the steps, from some of each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

LEAST_ORDER = 0.5  # a law that falls slower is not used to predict what finer ones give


@dataclass
class Law:
    """Errors by fineness (elements, or steps), and between and beyond these by powers.

    rate    order of the error where the solution is smooth, which no prediction exceeds
    errors  fineness -> error
    """

    rate: float
    errors: dict[float, float] = field(default_factory=dict)

    def order(self) -> float | None:
        """The observed one, between the two finest; None of fewer."""
        if len(self.errors) < 2:
            return None
        (n, e), (m, f) = sorted(self.errors.items())[-2:]
        if not (0 < f < math.inf and 0 < e < math.inf):
            return math.nan
        return math.log(e / f) / math.log(m / n)

    def predicted(self, fineness: float) -> float:
        """The error at a fineness: by straight lines between logarithms, beyond the finest by the
        observed order, at most `rate`, below the coarsest by `rate`; inf where nothing is known.
        """
        points = sorted((n, e) for n, e in self.errors.items() if e < math.inf)
        if not points or any(n >= fineness and e == math.inf for n, e in self.errors.items()):
            return math.inf
        (first, at_first), (last, at_last) = points[0], points[-1]
        if fineness >= last:
            return at_last * (last / fineness) ** self.trusted()
        if fineness <= first:
            return at_first * (first / fineness) ** self.rate
        (n, e), (m, f) = next(
            (a, b) for a, b in itertools.pairwise(points) if a[0] <= fineness <= b[0]
        )
        if min(e, f) <= 0:
            return max(e, f)
        share = math.log(fineness / n) / math.log(m / n)
        return math.exp((1 - share) * math.log(e) + share * math.log(f))

    def trusted(self) -> float:
        """The order that predictions beyond the finest have: the observed one between `LEAST_ORDER`
        and `rate`; of one point 2 at most.
        """
        order = self.order()
        if order is None:
            return min(self.rate, 2.0)
        return self.rate if math.isnan(order) else min(max(order, LEAST_ORDER), self.rate)

    def scale(self, ratio: float) -> None:
        """All errors times a number."""
        self.errors = {n: e * ratio for n, e in self.errors.items()}


def remaining(difference: float, order: float) -> float:
    """The error of the coarser of two levels, one twice as fine, that differ so much: d / (1 -
    2^-p).
    """
    return difference / (1 - 2.0**-order)


def observed_order(changes: Sequence[float]) -> float | None:
    """The order that the last three of nested levels show, each twice as fine as the one before,
    which differ by `changes`; None of fewer levels, or where nothing changes.
    """
    if len(changes) < 2 or not (0 < changes[-1] < math.inf and 0 < changes[-2] < math.inf):
        return None
    return math.log2(changes[-2] / changes[-1])
