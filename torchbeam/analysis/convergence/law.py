"""Law of errors: how one falls with the fineness of a mesh or of the steps, from some of each."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

LEAST_ORDER = 0.5  # a law that falls slower counts as one of this order, which is hardly one


@dataclass
class ErrorLaw:
    """Errors by fineness (elements, or steps), and between and beyond these by powers.

    rate      order of the error where the solution is smooth, which no prediction exceeds
    expected  order while none was observed
    changes   by levels twice as fine: fineness -> change
    """

    rate: float
    expected: float
    changes: dict[float, float] = field(default_factory=dict)

    def order(self) -> float | None:
        """The observed one, between the two finest; None of fewer, nan where nothing changes."""
        if len(self.changes) < 2:
            return None
        (n, d), (m, f) = sorted(self.changes.items())[-2:]
        return math.log(d / f) / math.log(m / n) if min(d, f) > 0 else math.nan

    def error(self, fineness: float) -> float:
        """What the change from a fineness tells, by an order of 2 at most, so that it is not told
        too small where the order is less than it was; by 1 where none was observed.
        """
        order = self.order()
        observed = order is not None and not math.isnan(order)
        return remaining(self.changes[fineness], _cautious(order if observed else 1.0))

    def predicted(self, fineness: float) -> float:
        """The error at a fineness: by straight lines between logarithms, beyond the finest by the
        observed order, at most `rate`, below the coarsest by the expected one; inf where nothing is
        known.
        """
        if fineness in self.changes:
            return self.error(fineness)
        points = sorted(self.changes.items())
        if not points:
            return math.inf
        return remaining(self._change(points, fineness), _cautious(self.trusted()))

    def _change(self, points: list[tuple[float, float]], fineness: float) -> float:
        (first, at_first), (last, at_last) = points[0], points[-1]
        if fineness >= last:
            return at_last * (last / fineness) ** self.trusted()
        if fineness <= first:
            return at_first * (first / fineness) ** self.expected
        (n, d), (m, f) = next(
            (a, b) for a, b in itertools.pairwise(points) if a[0] <= fineness <= b[0]
        )
        if min(d, f) <= 0:
            return max(d, f)
        share = math.log(fineness / n) / math.log(m / n)
        return math.exp((1 - share) * math.log(d) + share * math.log(f))

    def trusted(self) -> float:
        """The order that predictions beyond the finest have: the observed one between `LEAST_ORDER`
        and `rate`, or the expected one.
        """
        order = self.order()
        if order is None or math.isnan(order):
            return self.expected
        return min(max(order, LEAST_ORDER), self.rate)


def _cautious(order: float) -> float:
    return min(max(order, LEAST_ORDER), 2.0)


def remaining(difference: float, order: float) -> float:
    """Error of the coarser of two levels that differ so much, one twice as fine: d / (1 - 2^-p)."""
    return difference / (1 - 2.0**-order)
