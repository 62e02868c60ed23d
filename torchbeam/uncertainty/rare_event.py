"""Rare events of 1e-3 to 1e-9: subset simulation, or importance sampling at design points."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, count, level_of, number
from ..core.memory import check_memory
from ..core.warning import warn
from ..math.distributions import normal_probability
from .design_point import DesignPoints, all_design_points, design_points
from .estimate import Ends
from .evaluation import Evaluation, Function, settings
from .importance_sampling import ImportanceRuns, by_sides, importance_sampling
from .joint_law import Correlation, JointLaw
from .laws import Law
from .limit_state import LimitState
from .subset_simulation import SHARE, subset_simulation

METHODS = ("subset", "importance")
AGAIN = 5  # times that samples are drawn, as long as they lead to further design points
# share of the probability that may come from samples that design points do not lead to
BEYOND = 0.05
ENOUGH = 500  # samples of a run of subset simulation


@dataclass(frozen=True)
class RareEvent:
    """Probability of y > threshold, and its interval from `low` to `high` at `level`. Where samples
    failed, it reaches from what holds if none of them is the event to what holds if all are.

    Attributes:
        probability: with failed samples as no event; with failed_exceed=True as the event
        method: "subset" or "importance"
        evaluations: number of evaluations of the function
        failed: number of failed ones, by reason in `reasons`
        thresholds: (levels,) intermediate thresholds of subset simulation, the mean of its runs
        points: (k, p) theta at the design points, the likeliest first
        beta: (k,) their distances from the medians in normal scores
        form: first-order probability Phi(-beta) of the likeliest point, for importance sampling

    Examples:
        >>> event = tb.rare_event(deflection, laws, 2.0, 256, method="importance", by_name=True)
        >>> event.low < event.probability < event.high
        True
    """

    names: tuple[str, ...]
    probability: float
    low: float
    high: float
    level: float
    method: str
    evaluations: int
    reasons: Mapping[str, int]
    thresholds: Tensor | None = None
    points: Tensor | None = None
    beta: Tensor | None = None
    form: float | None = None

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())

    def __repr__(self) -> str:
        method = (
            f"{len(self.thresholds)} thresholds on the way"
            if self.points is None
            else f"{len(self.points)} design points, FORM {self.form:.3g}"
        )
        return (
            f"RareEvent({self.probability:.3g}, {self.low:.3g} to {self.high:.3g} at "
            f"{100 * self.level:g} %; {self.method}, {method}; {self.evaluations} evaluations, "
            f"{self.failed} failed)"
        )


def rare_event(
    function: Function,
    laws: Mapping[str, Law],
    threshold: float,
    n: int,
    *,
    method: str = "subset",
    interval: float = 0.95,
    replicates: int | None = None,
    correlation: Correlation | None = None,
    starts: int = 32,
    seed: int = 0,
    chunk: int = 1024,
    executor: Executor | None = None,
    dtype: torch.dtype | None = None,
    by_name: bool = False,
    failed_exceed: bool | None = None,
) -> RareEvent:
    """Probability that a function of random parameters exceeds a threshold.

    Args:
        function: as in `monte_carlo`, with y (N,): a number for each sample
        n: number of samples: of each level of subset simulation, all runs together; or of
            importance sampling
        method: "subset": subset simulation (Au and Beck 2001), for any function. It takes about n
            (1 + 0.9 levels) evaluations, with a level for each factor of ten. Use 500 or more
            samples a run: with 100 the estimate is too large by a fifth at 1e-4, and by a third at
            1e-6. "importance": importance sampling around design points, which gradients find
            (FORM). It takes fewer evaluations, but needs a smooth y and few regions of failure; it
            misses a region to which no start leads. Samples that are likelier by the laws than
            around any point are starts too. If they lead to no point, a warning names their share
        replicates: number of independent runs, whose scatter gives the interval: by default 10 for
            subset simulation, 16 for importance sampling
        starts: number of starts of the search for design points: the medians, and random pairs z,
            -z. The same number follows again, up to four times, while only a single start leads to
            a point
        laws, correlation, seed, chunk, executor, dtype, by_name: as in `monte_carlo`; gradients are
            computed in this process
        failed_exceed: True or False: failed samples are the event, or are not. None: an interval of
            both, and a warning. Subset simulation then runs twice. Importance sampling sees what
            fails around design points; n more samples of the laws themselves tell what fails
            elsewhere, also with True. If none of them fails, that may still be 3.7/n at 95 %, and
            the interval reaches so far

    Raises:
        ValueError: as `monte_carlo`, for a y of several numbers, and where no sample or start leads
            to the threshold. For a y with the same value in a tenth of the samples on the way
            ("subset"), or a law with steps, `Empirical` ("importance").

    Examples:
        >>> event = tb.rare_event(deflection, laws, 2.0, 256, method="importance", by_name=True)
        >>> event.probability < 1e-6  # that it exceeds 2
        True
    """
    joint, threshold = JointLaw.of(laws, correlation), number("threshold", threshold)
    level = level_of("interval", interval)
    boolean("by_name", by_name)
    boolean("failed_exceed", False if failed_exceed is None else failed_exceed)
    choice("method", method, METHODS)
    n, seed, chunk, dtype = settings(function, n, seed, chunk, executor, dtype, None)
    joint.random()  # there is one
    check_memory(f"n = {n} samples", 8 * n * joint.dimension, "fewer are wanted")
    work = Evaluation(function, joint, None, dtype, chunk, by_name, executor, total=n)
    limit = LimitState(work, threshold)
    usual = 10 if method == "subset" else 16
    runs = count("replicates", usual if replicates is None else replicates, 2)

    def event(ends: Ends, **more: Any) -> RareEvent:
        counted = limit.evaluations, dict(limit.failures)
        return RareEvent(joint.names, *ends, level, method, *counted, **more)

    if method == "subset":
        ends, thresholds = _by_subset(limit, n, runs, seed, level, failed_exceed)
        return event(ends, thresholds=thresholds)
    ends, points = _by_importance(limit, n, runs, starts, seed, level, failed_exceed)
    form = normal_probability(-points.beta[0]).item()
    return event(ends, points=joint.of_score(points.z), beta=points.beta, form=form)


def _with_failed(
    limit: LimitState,
    failed_exceed: bool | None,
    safe: Ends,
    unsafe: Callable[[], Ends],
    note: str = "",
) -> Ends:
    """Probability and its interval, which holds whether failed samples are the event or not, unless
    that is known. note: how that is known of all.
    """
    if failed_exceed is not None or not limit.failures:
        return safe
    probability, _, high = unsafe()
    lost, of = sum(limit.failures.values()), limit.evaluations
    reasons = ", ".join(limit.failures)
    warn(
        f"{lost} of {of} evaluations failed ({reasons}): the probability is {safe[0]:.3g} if none "
        f"of these is the event, and {probability:.3g} (up to {high:.3g}{note}) if all are; the "
        "interval holds both, and failed_exceed=True or False decides"
    )
    return safe[0], safe[1], max(safe[2], high)


def _by_subset(
    limit: LimitState, n: int, runs: int, seed: int, level: float, failed_exceed: bool | None
) -> tuple[Ends, Tensor]:
    """Probability with its interval, and mean thresholds (levels,) of the runs. Warns where these
    have few samples.
    """
    each = _samples_of_run(n, runs)
    simulated = partial(subset_simulation, limit, each, runs, seed)
    estimates = simulated(math.inf if failed_exceed else -math.inf)
    ends = estimates.interval(level)
    thresholds = estimates.thresholds.nanmean(-1)
    thresholds = thresholds[~thresholds.isnan()]
    if len(thresholds) and each < ENOUGH:
        warn(
            f"{runs} runs of {each} samples a level were asked for: the probability may be too "
            f"large by a third; n = {ENOUGH * runs} or fewer `replicates` are wanted"
        )
    exceeding = lambda: simulated(math.inf).interval(level)  # noqa: E731
    return _with_failed(limit, failed_exceed, ends, exceeding), thresholds


def _samples_of_run(n: int, runs: int) -> int:
    """Of each level of a run of subset simulation; ValueError where they are too few."""
    least, chains = round(5 / SHARE), round(1 / SHARE)
    each = n // runs // chains * chains
    if each < least:
        raise ValueError(
            f"n = {n} was given for {runs} runs of subset simulation; at least {least * runs} are "
            "wanted"
        )
    return each


def _by_importance(
    limit: LimitState,
    n: int,
    runs: int,
    starts: int,
    seed: int,
    level: float,
    failed_exceed: bool | None,
) -> tuple[Ends, DesignPoints]:
    """Probability with its interval, and the design points."""
    estimates, points = _around_points(limit, n, runs, starts, seed)
    if failed_exceed is None and not limit.failures:
        failed_exceed = points.usual  # either is right, and this one takes no more samples
    ends_if = partial(by_sides, limit, estimates, points, n, seed, level)
    note = f"; {n} plain samples tell what fails away from the design points"
    ends = ends_if(bool(failed_exceed))
    return _with_failed(limit, failed_exceed, ends, partial(ends_if, True), note), points


def _around_points(
    limit: LimitState, n: int, runs: int, starts: int, seed: int
) -> tuple[ImportanceRuns, DesignPoints]:
    """Probabilities by samples around design points, and these. Raises ValueError for too few
    samples, and laws that no gradient leads along.
    """
    if n < 2 * runs:
        raise ValueError(
            f"n = {n} was given for {runs} replicates of importance sampling; at least "
            f"{2 * runs} are wanted"
        )
    if stepped := limit.work.joint.in_steps:
        raise ValueError(
            f"the law of {stepped[0]!r}, whose values are steps, was given for design points, to "
            'which gradients lead; continuous laws are wanted, or method="subset"'
        )
    starts = count("starts", starts)
    with _silent(limit):
        points = all_design_points(limit, starts, seed)
    for again in range(AGAIN):
        estimates = importance_sampling(limit, points, n, runs, seed + again)
        if not len(estimates.beyond):
            break
        with _silent(limit):
            more = design_points(limit, torch.cat((points.z, estimates.beyond[:starts])))
        if len(more.z) == len(points.z):
            break
        points = more
    if estimates.share > BEYOND:
        warn(
            f"{100 * estimates.share:.0f} % of the probability come from "
            f"{len(estimates.beyond)} samples that are far from all {len(points.z)} design points: "
            "regions of failure are curved, or more than were found, and the interval may be "
            'wrong; more `starts` are wanted, or method="subset"'
        )
    return estimates, points


@contextmanager
def _silent(limit: LimitState) -> Iterator[None]:
    """No warning of the function: most of what a search for design points evaluates is far from
    the answer, and does not enter it.
    """
    told = limit.work.told[:]
    with warnings.catch_warnings():
        for category in (RuntimeWarning, UserWarning):
            warnings.simplefilter("ignore", category)
        yield
    limit.work.told[:] = told
