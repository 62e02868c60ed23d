"""Samples of a function of random parameters, and what they say, with errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, overload

import torch
from torch import Tensor

from ..core.arguments import boolean, level_of
from ..core.arguments import function as checked_function
from ..core.missing_name import Named, by_word
from ..core.status import STATUS
from ..core.validation import Value, broadcast, converted, finite, refusal, shown
from . import estimate
from .estimate import Estimate, Statistic, failures, probabilities
from .output import Tables

FAILED = 1  # status of a sample whose y is not finite
REFUSED = -1  # of one that the function refuses
NOT_FINITE = "y is not finite"


@dataclass(frozen=True)
class Samples(Named, Tables):
    """Samples of a Monte Carlo run: theta (n, p), with columns by `names`, y (n, ...), and status
    (n,), 0 = good. Statistics use the good samples, and tell how many failed, and why.

    Args:
        replicates: number of independent designs of equal size, in which the samples stand one
            after the other
        independent: whether samples are independent (plain sampling). Samples of a Sobol sequence
            are not. A single replicate of them has intervals as if they were, usually too wide
        sentences: by status: the reason of failure

    Examples:
        >>> samples = tb.monte_carlo(deflection, laws, 256, replicates=16, by_name=True)
        >>> q = samples.quantile(0.95, interval=0.9)
        >>> q.low < q.estimate < q.high
        tensor(True)
    """

    names: tuple[str, ...]
    theta: Tensor
    y: Tensor
    status: Tensor
    replicates: int = 1
    independent: bool = False
    sentences: Mapping[int, str] = field(default_factory=dict)

    _elsewhere = by_word(
        {
            "deviation": "sd sigma std stddev var variance",
            "mean_interval": "ci confidenceinterval",
            "quantile": "median percentile",
            "theta": "input parameter x",
            "y": "output result sample value",
        }
    )

    def __len__(self) -> int:
        return len(self.y)

    @property
    def good(self) -> Tensor:
        """y of the good samples."""
        return self.y[self.status == 0]

    @property
    def replicate(self) -> Tensor:
        """Number (n,) of the replicate that a sample belongs to."""
        return torch.arange(len(self)) // max(len(self) // self.replicates, 1)

    @property
    def failed(self) -> int:
        """Number of samples that failed."""
        return int((self.status != 0).sum())

    @property
    def reasons(self) -> dict[str, int]:
        """Failed samples by reason, the most frequent first."""
        return reasons_of(self.y, self.status, self.sentences)

    @property
    def mean(self) -> Tensor:
        return self._numbers().mean(0)

    @property
    def deviation(self) -> Tensor:
        """Standard deviation (...): over n - 1 for n independent samples; over n for a Sobol
        sequence, whose mean hardly differs from the law's.
        """
        return self._deviation(self._numbers())

    @overload
    def quantile(self, levels: Any, interval: None = None) -> Tensor: ...

    @overload
    def quantile(self, levels: Any, interval: float) -> Estimate: ...

    def quantile(self, levels: Any, interval: float | None = None) -> Tensor | Estimate:
        """Quantiles: (...) of a single level, (levels, ...) of several. With `interval`, a
        confidence level, they are an `Estimate`: from replicates, or else between order statistics
        (binomial).
        """
        wanted = probabilities(levels)
        several = wanted.reshape(-1)
        if interval is None:
            quantiles = estimate.quantile_of_sorted(self._numbers().sort(0).values, several)
            return quantiles if wanted.ndim else quantiles[0]
        quantiles = estimate.quantile(
            self._groups(), several, level_of("interval", interval), self.reasons
        )
        return quantiles if wanted.ndim else quantiles[0]

    def mean_interval(self, level: float = 0.95) -> Estimate:
        """Mean (...), with Student's interval: of the means of replicates, or of the samples. Of a
        y of yes and no that of a probability.
        """
        if self.y.dtype == torch.bool:
            return self.exceedance(0.5, level_of("level", level))
        return estimate.mean(self._groups(), level_of("level", level), self.reasons)

    def deviation_interval(self, level: float = 0.95) -> Estimate:
        """Standard deviation (...), as `deviation` has it, with its interval."""
        return self.statistic(self._deviation, level)

    def statistic(self, function: Statistic, level: float = 0.95) -> Estimate:
        """Any statistic, function of samples (n, ...), with its interval: from its scatter among
        replicates, or else by bootstrap.
        """
        level, groups = level_of("level", level), self._groups()
        checked_function("function", function)
        if sum(len(y) > 1 for y in groups) > 1:
            return estimate.replicated(groups, function, level, self.reasons, fewest=2)
        return estimate.bootstrap(torch.cat(groups), function, level, self.reasons)

    def exceedance(
        self, x: Any, interval: float = 0.95, *, failed_exceed: bool | None = None
    ) -> Estimate:
        """Probability that y > x, for thresholds x that broadcast with one sample's y.

        Args:
            failed_exceed: None: good samples count; True or False: failed samples count as
                exceeding, or not
        """
        x = finite("x", converted(x, self.y.dtype if self.y.is_floating_point() else torch.float64))
        broadcast("the thresholds and y of a sample", x.shape, self.y.shape[1:])
        values = self.y.reshape(
            len(self), *[1] * max(x.ndim - (self.y.ndim - 1), 0), *self.y.shape[1:]
        )
        above, good = values > x, self.status == 0
        if failed_exceed is not None:
            boolean("failed_exceed", failed_exceed)
            above = torch.where(
                good.reshape(-1, *[1] * (above.ndim - 1)), above, bool(failed_exceed)
            )
            good = good | True
        return estimate.probability(
            self._groups(above, good), level_of("interval", interval), self.reasons
        )

    def bands(self, level: float = 0.9, interval: float = 0.95) -> Estimate:
        """Bands of histories (3, ...): at each instant the (1 - level)/2 quantile, the median and
        the (1 + level)/2 quantile. Each has an interval, which holds instant by instant.
        """
        level = level_of("level", level)
        return self.quantile(((1 - level) / 2, 0.5, (1 + level) / 2), interval)

    def convergence(self, reference: Value | None = None) -> tuple[Tensor, Tensor]:
        """Numbers of samples (K,), doubling, and the error (K, ...) of their means: the RMS
        distance from the `reference`, or from the mean of all samples. The RMS is over replicates,
        or over 16 parts of independent samples. Good samples count.
        """
        groups = self._groups()
        if len(groups) == 1 and not self.independent:
            raise ValueError(
                "the convergence of one Sobol sequence was asked for; replicates are wanted"
            )
        groups = groups if len(groups) > 1 else list(groups[0].chunk(16))
        if len(groups) == 1:
            raise ValueError("the convergence of one good sample was asked for; several are wanted")
        least = min(map(len, groups))
        n = torch.tensor([2**k for k in range(least.bit_length())])
        sums = torch.stack([y[:least].cumsum(0)[n - 1] for y in groups])
        means = sums / n.reshape(-1, *[1] * (sums.ndim - 2))
        centre, wanted = torch.cat(groups).mean(0), self.y.shape[1:]
        if reference is not None:
            centre = finite("reference", converted(reference, torch.float64))
        if broadcast("the reference and y of a sample", centre.shape, wanted) != wanted:
            raise ValueError(
                f"a reference {tuple(centre.shape)} was given for a y {tuple(wanted)}; "
                "one for each number is wanted"
            )
        freedom = len(groups) - (reference is None)
        return n, ((means - centre).square().sum(0) / freedom).sqrt()

    def _groups(self, y: Tensor | None = None, good: Tensor | None = None) -> list[Tensor]:
        """Good samples by replicate, or all together where replicates do not tell the error."""
        y = self.y.double() if y is None else y
        good = self.status == 0 if good is None else good
        parts = zip(y.chunk(self.replicates), good.chunk(self.replicates), strict=True)
        groups = [part[chosen] for part, chosen in parts]
        whole = self._filled(torch.cat(groups))
        groups = [group for group in groups if len(group)]
        return groups if estimate.replicated_well(len(groups), len(whole)) else [whole]

    def _deviation(self, y: Tensor) -> Tensor:
        about = estimate.about_their_mean(
            self.independent, self.replicates, len(self._groups()), len(y)
        )
        return y.std(0, correction=about)

    def _numbers(self) -> Tensor:
        """y of the good samples, at least one, in floating point."""
        y = self._filled(self.good)
        return y if y.is_floating_point() else y.double()

    def _filled(self, y: Tensor) -> Tensor:
        if not len(y):
            raise ValueError(
                f"all {len(self)} samples failed ({', '.join(self.reasons)}); there is no "
                "statistic of none"
            )
        return y

    def __repr__(self) -> str:
        times = f" in {self.replicates} replicates" if self.replicates > 1 else ""
        return (
            f"Samples({len(self.y)} of {', '.join(self.names)}{times}; {failures(self.reasons)}; "
            f"y {tuple(self.y.shape[1:])})"
        )


def checked_sentences(sentences: Any) -> dict[int, str]:
    """Sentences by status; ValueError for what are none."""
    if sentences is None:
        return {}
    if not isinstance(sentences, Mapping) or not all(
        isinstance(code, int) and isinstance(sentences[code], str) for code in sentences
    ):
        raise refusal(f"sentences = {shown(sentences)}", "a dict, status -> text,", were=True)
    return dict(sentences)


def reasons_of(y: Tensor, status: Tensor, sentences: Mapping[int, str]) -> dict[str, int]:
    """Failed samples by reason: by status, those whose y is not finite first of all. A status with
    no sentence of the user may be the user's own, or torchbeam's.
    """
    if not (status != 0).any():
        return {}
    known = {k: f"status {k} (torchbeam's: {why})" for k, why in STATUS.items()}
    known |= {REFUSED: "the function refused it by a ValueError", **sentences}
    finite_ = torch.isfinite(y).reshape(len(y), -1).all(-1)
    counts = {NOT_FINITE: int(((status == FAILED) & ~finite_).sum())}
    for code in status[(status != 0) & ((status != FAILED) | finite_)].unique().tolist():
        why = known.get(code, f"status {code}")
        counts[why] = counts.get(why, 0) + int(
            ((status == code) & ((status != FAILED) | finite_)).sum()
        )
    return dict(sorted(((why, n) for why, n in counts.items() if n), key=lambda item: -item[1]))
