"""Stream: moments, quantiles, probabilities and histograms of samples in constant memory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, overload

import torch
from torch import Tensor

from ..core.arguments import level_of
from ..core.validation import Value, broadcast, converted, finite, refusal
from ..math.distributions import binomial_interval, binomial_ranks, student_quantile
from . import estimate
from .estimate import FEW, Estimate, failures, probabilities, share_half
from .moments import Moments
from .output import Summary
from .samples import reasons_of
from .sketch import Sketch

BINS = 2**12  # of a sketch: one of each number of y in each replicate


@dataclass(frozen=True)
class Part:
    """Summary of one chunk of samples: shape of a y, number of samples, moments
    (None without good ones), a sketch of each number of y, failed samples by reason.
    """

    shape: tuple[int, ...]
    samples: int
    moments: Moments | None
    sketches: list[Sketch]
    reasons: dict[str, int]

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())


def summarised(sentences: Mapping[int, str], chunk: tuple[Tensor, Tensor, Tensor]) -> Part:
    """Summary of a chunk; `sentences` by status."""
    _, y, status = chunk
    good = y[status == 0].double()
    sketches: list[Sketch] = []
    for numbers in good.reshape(len(good), -1).unbind(-1) if len(good) else ():
        sketches.append(Sketch.empty(BINS))
        sketches[-1].add(numbers)
    moments, reasons = Moments.of(good) if len(good) else None, reasons_of(y, status, sentences)
    return Part(tuple(y.shape[1:]), len(y), moments, sketches, reasons)


@dataclass
class Stream(Summary):
    """Summary of a stream of samples: moments and a sketch of each number of y, by replicate, and
    failed samples by reason.

    Attributes:
        names: of theta's columns
        shape: of y of a sample
        moments: of each replicate; None without good samples
        sketches: of each replicate, a sketch for each number of y
        samples: number of samples

    Examples:
        >>> stream = tb.monte_carlo_stream(deflection, laws, 1024, by_name=True)
        >>> stream.samples, stream.mean_interval().estimate.shape
        (1024, torch.Size([]))
    """

    names: tuple[str, ...]
    independent: bool
    shape: tuple[int, ...] | None = None
    moments: list[Moments | None] = field(default_factory=list)
    sketches: list[list[Sketch]] = field(default_factory=list)
    samples: int = 0
    reasons: dict[str, int] = field(default_factory=dict)

    def merge(self, replicate: int, part: Part) -> None:
        """Count samples of one replicate."""
        if self.shape is None:
            self.shape = part.shape
        elif self.shape != part.shape:
            raise ValueError(
                f"a function that gave y (N, ...) of {self.shape} and, from sample {self.samples} "
                f"on, of {part.shape} was given; one kind is wanted"
            )
        while len(self.moments) <= replicate:
            self.moments.append(None)
            self.sketches.append([Sketch.empty(BINS) for _ in range(max(math.prod(self.shape), 1))])
        self.samples += part.samples
        for why, n in part.reasons.items():
            self.reasons[why] = self.reasons.get(why, 0) + n
        if part.moments is not None:
            old = self.moments[replicate]
            self.moments[replicate] = part.moments if old is None else old.merged(part.moments)
            for sketch, other in zip(self.sketches[replicate], part.sketches, strict=True):
                sketch.merge(other)

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())

    @property
    def all(self) -> Moments:
        """Moments of all good samples."""
        return reduce(Moments.merged, self._known())

    @property
    def mean(self) -> Tensor:
        return self.all.mean

    @property
    def deviation(self) -> Tensor:
        """Standard deviation (...), as `Samples.deviation` has it."""
        whole = self.all
        about = estimate.about_their_mean(
            self.independent, len(self.moments), self._groups, whole.n
        )
        return (whole.second / (whole.n - about)).sqrt()

    @property
    def skewness(self) -> Tensor:
        return self.all.skewness

    @property
    def kurtosis(self) -> Tensor:
        return self.all.kurtosis

    @property
    def error(self) -> float:
        """Largest relative error of a value from a sketch."""
        return max(sketch.error for sketch in self._pooled())

    def mean_interval(self, level: float = 0.95) -> Estimate:
        """Mean (...), with Student's interval: of the means of replicates, or of the samples. (For
        a y of 0 and 1 use the exceedance of 0.5, with the interval of a probability.)
        """
        known, whole, level = self._known(), self.all, level_of("level", level)
        if self._groups > 1:
            half = estimate.student_half(torch.stack([moment.mean for moment in known]), level)
        elif whole.n > 1:
            quantile = student_quantile((1 + level) / 2, whole.n - 1)
            half = quantile * whole.deviation / math.sqrt(whole.n)
        else:
            half = whole.mean.abs() + math.inf
        return self._estimate(
            whole.mean, whole.mean - half, whole.mean + half, level, torch.tensor(self._groups == 1)
        )

    @overload
    def quantile(self, levels: Any, interval: None = None) -> Tensor: ...

    @overload
    def quantile(self, levels: Any, interval: float) -> Estimate: ...

    def quantile(self, levels: Any, interval: float | None = None) -> Tensor | Estimate:
        """Quantiles to the relative `error`: (...) of a single level, (levels, ...) of several.
        With `interval` they are an `Estimate`, its interval wider by that error.
        """
        wanted = probabilities(levels)
        several, pooled, n = wanted.reshape(-1), self._pooled(), self._good
        centre = torch.stack([sketch.at_ranks(several * (n - 1)) for sketch in pooled], -1)
        if interval is None:
            return self._shaped(centre, wanted)
        level = level_of("interval", interval)
        ends = []
        groups = self._groups
        few = (n / groups * torch.minimum(several, 1 - several) < FEW) | (groups == 1)
        counted = [
            [rank - 1 for rank in binomial_ranks(q, n, level)] for q in several[few].tolist()
        ]
        counted = torch.tensor(counted, dtype=torch.float64).reshape(-1, 2)
        for j, sketch in enumerate(pooled):
            ranks = torch.stack((several, several), -1) * (n - 1)
            if not few.all():
                half = self._share_error(j, centre[:, j], level, n)[:, None] * n
                ranks = ranks + torch.cat((-half, half), -1)
            ranks[few] = counted
            values = sketch.at_ranks(ranks.flatten().clamp(0, n - 1)).reshape(-1, 2)
            off = values.abs() * sketch.error
            values = torch.stack((values[:, 0] - off[:, 0], values[:, 1] + off[:, 1]), -1)
            values = torch.where(ranks > n - 1, torch.inf, values)
            ends.append(torch.where(ranks < 0, -torch.inf, values))
        low, high = torch.stack(ends, -2).unbind(-1)
        return self._estimate(*(self._shaped(x, wanted) for x in (centre, low, high)), level, few)

    def exceedance(self, x: Value, interval: float = 0.95) -> Estimate:
        """Probability that y > x, for thresholds x that broadcast with y of a sample. If x lies
        inside a bin, half of the bin's samples count, and the interval is wider by them.
        """
        level, n, pooled = level_of("interval", interval), self._good, self._pooled()
        groups = self._groups
        x = finite("x", converted(x, torch.float64))
        shape = broadcast("the thresholds and y of a sample", x.shape, torch.Size(self.shape))
        at_y = torch.arange(max(math.prod(self.shape), 1)).reshape(self.shape)
        numbers = at_y.expand(shape).flatten().tolist()
        rows, fews = [], []
        for j, at in zip(numbers, x.expand(shape).flatten(), strict=True):
            least, most = (v.item() for v in pooled[j].above(at))
            few = groups == 1 or min(least, n - most) < FEW * groups
            if few:
                low = binomial_interval(least, n, level)[0]
                high = binomial_interval(most, n, level)[1]
            else:
                half = self._share_error(j, at, level, n).item()
                low, high = max(least / n - half, 0.0), min(most / n + half, 1.0)
            rows.append(((least + most) / 2 / n, low, high))
            fews.append(few)
        parts = torch.tensor(rows, dtype=torch.float64).reshape(-1, 3).unbind(-1)
        return self._estimate(*(part.reshape(shape) for part in parts), level, torch.tensor(fews))

    def histogram(self, edges: Value) -> Tensor:
        """Shares (..., bins) of the good samples between edges (bins + 1,). A sample at an edge
        lies below it, except at the least edge. An edge inside a bin of the sketch divides the bin
        in halves.
        """
        edges = finite("edges", converted(edges, torch.float64))
        if edges.ndim != 1 or len(edges) < 2 or not (edges.diff() > 0).all():
            raise refusal(
                f"edges {tuple(edges.shape)}", "(bins + 1,) increasing numbers", were=True, are=True
            )
        above = torch.stack([sum(sketch.above(edges)).double() / 2 for sketch in self._pooled()])
        above = torch.where(edges <= self.all.least.reshape(-1, 1), self._good, above)
        return (-above.diff(dim=-1) / self._good).reshape(*self.shape, -1)

    def _share_error(self, j: int, x: Tensor, level: float, n: int) -> Tensor:
        """Half the intervals (...) of P(y > x) by replicates; at least the rule of three."""
        pairs = zip(self.sketches, self.moments, strict=True)
        known = [(sketches[j], moment.n) for sketches, moment in pairs if moment is not None]
        shares = torch.stack([sum(sketch.above(x)).double() / 2 / size for sketch, size in known])
        return share_half(shares, level, n)

    def _known(self) -> list[Moments]:
        known = [moment for moment in self.moments if moment is not None]
        if not known:
            raise ValueError(
                f"all {self.samples} samples failed ({', '.join(self.reasons)}); there is no "
                "statistic of none"
            )
        return known

    @property
    def _good(self) -> int:
        """Good samples of all replicates."""
        return sum(part.n for part in self._known())

    @property
    def _groups(self) -> int:
        """Groups whose scatter tells the error; 1 = samples do."""
        groups = 1 if self.independent else len(self._known())
        return groups if estimate.replicated_well(groups, self._good) else 1

    def _pooled(self) -> list[Sketch]:
        """Sketches of all replicates together, one for each number of y."""
        self._known()
        pooled = [Sketch.empty(BINS * 2) for _ in self.sketches[0]]
        for sketches in self.sketches:
            for whole, sketch in zip(pooled, sketches, strict=True):
                whole.merge(sketch)
        return pooled

    def _shaped(self, rows: Tensor, wanted: Tensor) -> Tensor:
        shaped = rows.reshape(-1, *self.shape)
        return shaped if wanted.ndim else shaped[0]

    def _estimate(
        self, centre: Tensor, low: Tensor, high: Tensor, level: float, counted: Tensor
    ) -> Estimate:
        """counted: whether samples were counted in place of replicates, number by number."""
        method = "counts" if counted.all() else f"{self._groups} replicates"
        method += ", or counts where they are few" if counted.any() and not counted.all() else ""
        reasons = dict(sorted(self.reasons.items(), key=lambda item: -item[1]))
        return Estimate(centre, low, high, level, self._good, method, reasons)

    def __repr__(self) -> str:
        return (
            f"Stream({self.samples} of {', '.join(self.names)} in {len(self.moments)} replicates; "
            f"{failures(self.reasons)}; y {self.shape})"
        )
