"""Selection of what is worth most: criteria of information, greedy choice, exchange, a bound.

Information of independent readings adds up: M = base + sum of the chosen items' (p, p). Criteria
are deviations of quantities G x of the coordinates x, and fall as M grows. Coordinates are scaled
so that all items together know each as well, and each is known a little beforehand (`RIDGE`): among
choices that leave some coordinates open, those win that leave fewer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

CRITERIA = ("D", "A", "c")
RIDGE = 1e-10  # of the information of all items
OPEN = 2.0  # rise of a variance as the ridge falls to a tenth: it is the ridge's
GAIN = 1e-9  # of a logarithm of the criterion, below which an exchange is none
SWAPS = 1000
ROUNDS, HALVINGS = 200, 12  # of the bound
TURNS = 10  # of choosing sensors and runs


@dataclass(frozen=True)
class Criterion:
    """Deviation of quantities, of information M (..., draws, p, p).

    kind  "D": the geometric mean of the axes of their ellipsoid, over the draws too;  "A", "c":
          the root of their mean variance
    G     (draws, q, p) derivatives of the quantities
    """

    kind: str
    G: Tensor

    def spread(self, M: Tensor) -> Tensor:
        """Covariance (..., draws, q, q) of the quantities."""
        ridge = RIDGE * torch.eye(M.shape[-1]).to(M)
        root = torch.linalg.cholesky_ex(M + ridge)[0]
        half = torch.linalg.solve_triangular(root, self.G.mT.expand(*M.shape[:-2], -1, -1),
                                             upper=False)  # fmt: skip
        return half.mT @ half

    def log_deviation(self, M: Tensor) -> Tensor:
        """(...) of it, least where M is best, and convex in M."""
        V = self.spread(M)
        if self.kind == "D":
            return torch.linalg.slogdet(V)[1].mean(-1) / (2 * V.shape[-1])
        return V.diagonal(dim1=-2, dim2=-1).mean((-2, -1)).log() / 2

    def open(self, M: Tensor) -> Tensor:
        """(..., q) bool: quantities that are not determined in some draw."""
        less = M - (0.9 * RIDGE) * torch.eye(M.shape[-1]).to(M)
        few, many = (self.spread(m).diagonal(dim1=-2, dim2=-1) for m in (M, less))
        return (many > OPEN * few).any(-2)

    def deviation(self, M: Tensor) -> Tensor:
        """(...) of it, infinite where a quantity is not determined."""
        return torch.where(self.open(M).any(-1), torch.inf, self.log_deviation(M).exp())


@dataclass(frozen=True)
class Selection:
    """Items to choose from, `count` in all and for no more than `budget`.

    base (draws, p, p), items (I, draws, p, p)  information;  cost (I,);  most (I,) times of each
    """

    criterion: Criterion
    base: Tensor
    items: Tensor
    cost: Tensor
    most: Tensor
    count: float
    budget: float = math.inf

    def information(self, chosen: Sequence[int]) -> Tensor:
        """(draws, p, p)."""
        return self.base + self.items[list(chosen)].sum(0)

    def best(self, exchange: bool) -> list[int]:
        """By numbers: greedy, by what each adds and by what it adds for its cost, the better of
        both; then by exchange, while one item in place of another is better (Fedorov 1972, Theory
        of Optimal Experiments, chapter 3).
        """
        choices = [self.greedy(False)]
        if math.isfinite(self.budget):
            choices.append(self.greedy(True))
        if exchange:
            choices = [self.exchanged(choice) for choice in choices]
        return min(choices, key=lambda choice: self.value(choice).item())

    def value(self, chosen: Sequence[int]) -> Tensor:
        return self.criterion.log_deviation(self.information(chosen))

    def times(self, chosen: Sequence[int]) -> Tensor:
        """(I,) of each."""
        chosen = self.most.new_tensor(list(chosen))
        return torch.bincount(chosen, minlength=len(self.items))

    def allowed(self, chosen: Sequence[int]) -> Tensor:
        """(I,) bool: what may be added."""
        times = self.times(chosen)
        left = self.budget * (1 + 1e-12) - self.cost[list(chosen)].sum()
        return (times < self.most) & (self.cost <= left) & (len(chosen) < self.count)

    def greedy(self, by_cost: bool) -> list[int]:
        """One after the other, each the one that helps most, or most for its cost."""
        chosen: list[int] = []
        while (allowed := self.allowed(chosen)).any():
            M = self.information(chosen)
            gain = self.criterion.log_deviation(M) - self.criterion.log_deviation(M + self.items)
            gain = gain / self.cost if by_cost else gain
            chosen.append(int(torch.where(allowed, gain, -torch.inf).argmax()))
        return chosen

    def exchanged(self, chosen: Sequence[int]) -> list[int]:
        """With one item in place of another, or one more, as long as that is better."""
        chosen = list(chosen)
        for _ in range(SWAPS):
            here, best, better = self.value(chosen).item(), -GAIN, None
            for k in (None, *range(len(chosen))):
                rest = [item for j, item in enumerate(chosen) if j != k]
                value = self.criterion.log_deviation(self.information(rest) + self.items)
                change = torch.where(self.allowed(rest), value - here, torch.inf)
                if (least := change.min().item()) < best:
                    best, better = least, [*rest, int(change.argmin())]
            if better is None:
                break
            chosen = better
        return chosen

    def in_order(self, chosen: Sequence[int]) -> list[int]:
        """The chosen ones, each the one that helps most after those before it."""
        rest, order = list(chosen), []
        while rest:
            value = self.criterion.log_deviation(self.information(order) + self.items[rest])
            order.append(rest.pop(int(value.argmin())))
        return order

    def bound(self, chosen: Sequence[int]) -> float:
        """A logarithm of the criterion that no choice has less of: that of shares of items, which
        is convex, lies above its tangents (Joshi and Boyd 2009, IEEE Trans. Signal Process. 57,
        451); the best of those on a way downhill from what was chosen (Frank and Wolfe 1956).
        """
        f, bound = self.criterion.log_deviation, -math.inf
        share = self.times(chosen).to(self.items)
        steps = 2.0 ** -torch.arange(1.0, HALVINGS + 1).to(share)
        for _ in range(ROUNDS):
            with torch.enable_grad():
                w = share.detach().requires_grad_()
                value = f(self._mixed(w))
                (slope,) = torch.autograd.grad(value, w)
            corner = self._corner(-slope)
            bound = max(bound, (value + slope @ (corner - share)).item())
            on = share + steps[:, None] * (corner - share)
            tried = f(self._mixed(on))
            if tried.min() >= value or value - bound < 1e-3:
                break
            share = on[int(tried.argmin())]
        return min(bound, self.value(chosen).item())

    def _mixed(self, share: Tensor) -> Tensor:
        """Information of shares (..., I)."""
        return self.base + torch.tensordot(share, self.items, 1)

    def _corner(self, gain: Tensor) -> Tensor:
        """Shares (I,) that are worth most by gains (I,) of each, of the budget where there is one,
        else of the count.
        """
        of_budget = math.isfinite(self.budget)
        price = self.cost if of_budget else torch.ones_like(self.cost)
        order = (gain / price).argsort(descending=True)
        whole = self.most.to(gain) * price
        before = whole[order].cumsum(0) - whole[order]
        left = (self.budget if of_budget else self.count) - before
        return torch.zeros_like(gain).index_copy(
            0, order, (left.clamp(min=0).minimum(whole[order]) / price[order])
        )


def choose_both(
    of_sensors: Callable[[Tensor], Selection],
    of_runs: Callable[[Sequence[int]], Selection],
    exchange: bool,
) -> tuple[list[int], Tensor]:
    """Sensors for runs (K,), and runs for sensors, in turn until neither changes; from all runs
    alike, and from each of them alone, the best of what is found.
    """
    none = of_runs([])
    like, runs, K = none.cost, float(none.count), len(none.cost)
    starts = [torch.full_like(like, runs / K), *(runs * torch.eye(K).to(like) if K > 1 else ())]
    least, best = math.inf, None
    for weight in starts:
        for _ in range(TURNS):
            chosen = of_sensors(weight).best(exchange)
            selection = of_runs(chosen)
            before, weight = weight, selection.times(selection.best(exchange)).to(like)
            if torch.equal(before, weight):
                break
        value = of_sensors(weight).value(chosen).item()
        if value < least - GAIN:
            least, best = value, (chosen, weight)
    return best
