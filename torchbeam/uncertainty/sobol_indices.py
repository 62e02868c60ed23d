"""Sobol indices: shares of the variance by parameter, with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..core.arguments import boolean, level_of
from ..core.files import path_of
from .chunks import usual_chunk
from .designs import Exchanged, Sobol
from .estimate import student_half
from .evaluation import Evaluation, Function, one_kind, points_of, progress_of, settings
from .joint_law import JointLaw
from .laws import Law
from .monte_carlo import chunk_of, folder_of
from .progress import Report
from .samples import reasons_of


@dataclass(frozen=True)
class SobolIndices:
    """Shares of p laws in the variance of y (...).

    Attributes:
        first: (p, ...) S_i = Var(E(y | x_i))/Var(y): the share that disappears if x_i is known
        total: (p, ...) T_i = E(Var(y | all but x_i))/Var(y): the share that remains if all others
            are known
        low, high: (2, p, ...) intervals of first, low[0] to high[0], and of total, low[1] to
            high[1]
        level: of the intervals
        variance: (...) of y
        evaluations: number of evaluations of the function
        failed: number of groups left out because an evaluation failed, by reason in `reasons`

    Examples:
        >>> indices = tb.sobol_indices(deflection, laws, 256, by_name=True)
        >>> indices.names, indices.first.sum() > 0.9  # shares of the variance
        (('EI', 'P'), tensor(True))
    """

    names: tuple[str, ...]
    first: Tensor
    total: Tensor
    low: Tensor
    high: Tensor
    level: float
    variance: Tensor
    evaluations: int
    failed: int
    reasons: Mapping[str, int]

    def __repr__(self) -> str:
        if self.first.ndim > 1:
            return (
                f"SobolIndices({len(self.names)} laws; y {tuple(self.first.shape[1:])}; "
                f"{self.evaluations} evaluations)"
            )
        columns = (self.first, self.low[0], self.high[0], self.total, self.low[1], self.high[1])
        numbers = zip(self.names, *(x.tolist() for x in columns), strict=True)
        rows = [
            f"{name} first {a:.3f} ({b:.3f} to {c:.3f}), total {d:.3f} ({e:.3f} to {f:.3f})"
            for name, a, b, c, d, e, f in numbers
        ]
        return (
            f"SobolIndices({'; '.join(rows)}; {self.evaluations} evaluations, {self.failed} "
            "groups failed)"
        )


def sobol_indices(
    function: Function,
    laws: Mapping[str, Law],
    n: int,
    *,
    replicates: int = 16,
    interval: float = 0.95,
    seed: int = 0,
    chunk: int | None = None,
    executor: Executor | None = None,
    out: str | Path | None = None,
    dtype: torch.dtype | None = None,
    version: str | int | None = None,
    by_name: bool = False,
    progress: Report | bool | None = None,
    correlation: None = None,
) -> SobolIndices:
    """First and total Sobol indices of a function of independent random parameters.

    Args:
        n: number of points of each of the two samples A and B, which the replicates share: best a
            power of two times their number. The function is evaluated n (p + 2) times for p random
            laws; a `RandomField` is a single law
        replicates: number of independent Sobol sequences, whose scatter gives the intervals
            (Student's, of jackknife values)
        function, laws, seed, chunk, executor, out, dtype, version, by_name, progress: as
            `monte_carlo` has them

    y_A and y_B are the values at A and B, with the variance V together. y_i are the values at A
    with parameter i from B. Then
        first = mean((y_B - mean)(y_i - y_A))/V        (Saltelli et al. 2010)
        total = mean((y_A - y_i)^2)/(2 V)              (Jansen 1999)

    A group of p + 2 evaluations with a failure is left out. Indices of a constant y are NaN.
    Intervals are infinite if only a single replicate has good groups.

    Raises:
        ValueError: as `monte_carlo`, and where all groups failed. For a `correlation`: indices do
            not divide the variance of correlated parameters.

    Examples:
        >>> indices = tb.sobol_indices(deflection, laws, 256, by_name=True)
        >>> dict(zip(indices.names, indices.total > 0.1))
        {'EI': tensor(True), 'P': tensor(True)}
    """
    if correlation is not None:
        raise ValueError(
            "correlation was given to sobol_indices, whose shares of the variance are those of "
            "independent parameters; laws of independent ones are wanted, of which the function "
            "makes the others"
        )
    joint = JointLaw.of(laws)
    boolean("by_name", by_name)
    level = level_of("interval", interval)
    out = None if out is None else path_of("out", out)
    usual, chunk = chunk is None, 1 if chunk is None else chunk
    n, seed, chunk, dtype = settings(function, n, seed, chunk, executor, dtype, version)
    points = points_of(n, replicates, fewest=2, least=2)
    random = joint.random()
    names = tuple(random)
    owner = torch.tensor([k for k, size in enumerate(random.values()) for _ in range(size)])
    parts = owner == torch.arange(len(names))[:, None]
    plan = Exchanged(Sobol(2 * joint.dimension, seed, points), parts)
    size = len(names) + 2
    chunk = (chunk_of(out) or usual_chunk(n * size)) if usual else chunk
    label = dict(seed=seed, chunk=chunk, dtype=str(dtype), **plan.label)
    folder = folder_of(out, function, joint, version, **label)
    work = Evaluation(function, joint, plan, dtype, chunk, by_name, executor, folder, n * size)
    chunks = list(work.chunks(0, n * size, progress_of(progress, n * size)))
    one_kind((k * chunk, part) for k, part in enumerate(chunks))
    y, status = (torch.cat(part) for part in [*zip(*chunks, strict=True)][1:])
    return _of_groups(names, y, status, n, replicates, level)


def _of_groups(
    names: tuple[str, ...], y: Tensor, status: Tensor, n: int, replicates: int, level: float
) -> SobolIndices:
    """Of y (n (p + 2), ...) in groups of p + 2 one after the other, of replicates likewise."""
    size = len(names) + 2
    good = (status == 0).reshape(n, size).all(-1)
    reasons = reasons_of(y, status, {})
    if not good.any():
        raise ValueError(
            f"all {n} groups have samples that failed ({', '.join(reasons)}); there are no "
            "indices of none"
        )
    values = y.double().reshape(n, size, *y.shape[1:])
    pairs = zip(values.chunk(replicates), good.chunk(replicates), strict=True)
    groups = [group[ok] for group, ok in pairs if ok.any()]
    indices = _indices(torch.cat(groups))  # (2, p, ...)
    half = _half(groups, indices, level)
    variance, evaluations, failed = _variance(values[good]), n * size, int((~good).sum())
    ends = indices - half, indices + half
    return SobolIndices(names, *indices, *ends, level, variance, evaluations, failed, reasons)


def _half(groups: list[Tensor], indices: Tensor, level: float) -> Tensor:
    """Half the interval (2, p, ...) of the indices found in all groups of replicates, by the
    jackknife; infinite where groups are good in one replicate alone.
    """
    R = len(groups)
    if R == 1:
        return indices.abs() + torch.inf
    without = torch.stack([_indices(torch.cat(groups[:k] + groups[k + 1 :])) for k in range(R)])
    return student_half(R * indices - (R - 1) * without, level)


def _indices(y: Tensor) -> Tensor:
    """First and total indices (2, p, ...) of groups y (n, p + 2, ...)."""
    variance = _variance(y)
    A, B, exchanged = y[:, :1], y[:, 1:2], y[:, 2:]
    centre = y[:, :2].mean((0, 1))
    first = ((B - centre) * (exchanged - A)).mean(0) / variance
    total = (A - exchanged).square().mean(0) / (2 * variance)
    return torch.stack((first, total))


def _variance(y: Tensor) -> Tensor:
    """Variance (...) of A and B together, of Sobol sequences: over their number."""
    return y[:, :2].flatten(0, 1).var(0, correction=0)
