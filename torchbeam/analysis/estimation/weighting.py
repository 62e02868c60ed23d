"""Weighting: how much each reading counts, by how far it is from what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import choice, quantile
from ...math.shapes import stacked
from ...math.square_root import Conditioned, conditioned
from ..identification.losses import HUBER, STUDENT

ROUNDS = 20  # in which weights, or what stands at a bound, are found
SETTLED = 1e-4  # of a weight: a change that is none
FARTHEST = 1e9  # of its noise: an error that says no more than a larger one
AGAIN = 5  # readings in a row that are left out; those that follow count
LEFT_OUT = 3.0  # expected deviations: as what an error far beyond the gate is judged


def huber(u: Tensor) -> Tensor:
    """Weights of squares, by readings' deviations; `student` likewise."""
    return HUBER / u.abs().clamp(min=HUBER)


def student(u: Tensor) -> Tensor:
    return (STUDENT + 1) / (STUDENT + u.square())


def log_huber(u: Tensor) -> Tensor:
    """Log density over that of a normal law at 0; `log_student` likewise."""
    normal, tails = math.erf(HUBER / 2**0.5), math.exp(-(HUBER**2) / 2) * 2 / HUBER
    corner = u.abs().clamp(max=HUBER)
    return corner * (corner / 2 - u.abs()) - math.log(normal + tails / (2 * math.pi) ** 0.5)


def log_student(u: Tensor) -> Tensor:
    peak = math.gamma((STUDENT + 1) / 2) / math.gamma(STUDENT / 2) * (2 / STUDENT) ** 0.5
    return math.log(peak) - (STUDENT + 1) / 2 * (u.square() / STUDENT).log1p()


LOSSES: dict[str, Callable[[Tensor], Tensor]] = {"huber": huber, "student": student}
LOG_DENSITIES = {huber: log_huber, student: log_student}


class Beyond(NamedTuple):
    """Of readings that a gate leaves out, (...): how many, as which sum of squares of expected
    deviations they are judged, and their log density at the gate.
    """

    count: Tensor
    squares: Tensor
    log_density: Tensor


@dataclass(frozen=True)
class Weighting:
    """Weights (..., m) of squares of readings' errors.

    loss   their weights by residuals over noise; None = 1 (squares)
    reach  expected deviations of an error, beyond which a reading is left out
    noise  (m,) deviation of each reading
    """

    loss: Callable[[Tensor], Tensor] | None
    reach: float
    noise: Tensor

    @classmethod
    def of(cls, loss: str | None, gate: float | None, noise: Tensor) -> Weighting:
        """Raises ValueError for another loss, and for a gate that is no probability."""
        law = None if loss is None else LOSSES[choice("loss", loss, tuple(LOSSES))]
        return cls(law, math.inf if gate is None else quantile("gate", gate), noise)

    def __call__(self, sources: Tensor, error: Tensor, missed: Tensor) -> Tensor:
        """0 where a reading is left out or missing (NaN), from sources (..., s, m) of unit variance
        of what was expected, and what is `clipped`, (..., m).

        A loss weighs the residuals after the update, as does iteratively reweighted least squares
        of the readings and what was expected (Karlgaard and Schaub 2007, J. Guidance 30, 885).
        """
        seen = self.within_gate(sources, error, missed)
        weight = seen.to(error)
        if self.loss is None:
            return weight
        e = torch.where(seen, error, 0.0)
        sources = torch.where(seen[..., None, :], sources, 0.0)
        known, share = sources.mT @ sources, torch.ones_like(weight)
        for _ in range(ROUNDS):
            own = self.noise.square() / share
            S = known + torch.diag_embed(own)
            residual = own * torch.linalg.solve_ex(S, e[..., None])[0][..., 0]
            after = self.loss(residual / self.noise)
            moves = ((after - share).abs() > SETTLED * after).any(-1, keepdim=True)
            if not moves.any():
                break
            share = torch.where(moves, after, share)  # of those that are settled no more
        return weight * share

    def clipped(self, sources: Tensor, error: Tensor, missed: Tensor) -> tuple[Tensor, Tensor]:
        """Errors (..., m): at the gate where so many readings before, missed (..., m), were beyond
        it in a row that the estimate is wrong, not they; for a loss no farther than one that says
        nothing. And how many are beyond it now.

        A gate without recovery keeps a wrong estimate for ever (Berman 2014, IEEE/ION PLANS, 1008).
        Here errors are saturated (Fang, Haile and Wang 2019, arXiv:1904.00335).
        """
        if self.loss is None and self.reach == math.inf:
            return error, missed
        gate = self.reach * self.deviation(sources)
        far = self.noise * (math.inf if self.loss is None else FARTHEST)
        beyond, limit = error.abs() > gate, gate.where(missed >= AGAIN, far)
        missed = (missed + 1).where(beyond, 0.0).where(~torch.isnan(error), missed)
        return error.minimum(limit).maximum(-limit), missed

    def within_gate(self, sources: Tensor, error: Tensor, missed: Tensor) -> Tensor:
        """(..., m) bool: whether a reading, as it is `clipped`, is neither missing nor left out."""
        read = ~torch.isnan(error)
        if self.reach == math.inf:
            return read
        return read & ((missed > AGAIN) | (error.abs() <= self.reach * self.deviation(sources)))

    def deviation(self, sources: Tensor) -> Tensor:
        """(..., m) of errors that are expected."""
        return (sources.square().sum(-2) + self.noise.square()).sqrt()

    def beyond(self, sources: Tensor, error: Tensor, missed: Tensor, weight: Tensor) -> Beyond:
        """What weights say of readings that are left out, and of those that count at the gate."""
        c, none = self.reach, error.new_zeros(error.shape[:-1])
        if c == math.inf:
            return Beyond(none, none, none)
        spread = self.deviation(sources)
        read = ~torch.isnan(error)
        left, at = read & (weight == 0), read & (missed > AGAIN)
        if not (left | at).any():
            return Beyond(none, none, none)
        each = -(c**2) / 2 - (spread * math.sqrt(2 * math.pi)).log()
        # mean square of normal errors beyond the gate; faults are no more of a doubt than LEFT_OUT
        square = 1 + c * math.sqrt(2 / math.pi) * math.exp(-(c**2) / 2) / math.erfc(c / 2**0.5)
        square, count = min(square, LEFT_OUT**2), left.sum(-1).to(error)
        squares = square * count + max(square - c**2, 0.0) * at.sum(-1)
        return Beyond(count, squares, torch.where(left, each, 0.0).sum(-1))

    def log_density(self, learnt: Conditioned, weight: Tensor) -> Tensor:
        """(...) of the readings of these weights that count; with a loss by Laplace's approximation
        about what they said (Tierney and Kadane 1986, JASA 81, 82).
        """
        seen = weight > 0
        normal = learnt.log_density(seen.sum(-1).to(weight))
        if self.loss is None:
            return normal
        own = torch.linalg.solve_triangular(learnt.own, learnt.unit[..., None], upper=True)[..., 0]
        share = torch.where(seen, weight, 1.0)
        u = torch.where(seen, self.noise * own / share, 0.0)
        more = LOG_DENSITIES[self.loss](u) + (share * u.square() - share.log()) / 2
        return normal + torch.where(seen, more, 0.0).sum(-1)

    def conditioned(
        self, by_x: Tensor, sources: Tensor, error: Tensor, weight: Tensor
    ) -> tuple[Tensor, Conditioned]:
        """What readings of errors (..., m) and weights (..., m) say of the rest of sources (..., s,
        m + n); and by_x (..., size, m + n), without readings of no weight.
        """
        seen = weight > 0
        rest = sources.shape[-1] - error.shape[-1]
        kept = pad(seen, (0, rest), value=True)[..., None, :]
        own = torch.where(seen, self.noise / weight**0.5, 1.0)
        whole = stacked(torch.where(kept, sources, 0.0), pad(torch.diag_embed(own), (0, rest)))
        return torch.where(kept, by_x, 0.0), conditioned(whole, torch.where(seen, error, 0.0))
