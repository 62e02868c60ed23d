"""Comparison of models by the same data: evidence, and prediction of what was left out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.arguments import choice, count
from ...core.summary import aligned
from ...core.validation import refusal, shown
from ...math.dense import positive_inverse
from .blocks import correlation_of, series_of
from .fit import Fit
from .problem import FitProblem

KINDS = ("prediction", "evidence")
BLOCKS = 10  # of times, of each experiment
FEWEST = 4  # experiments that are a block each
FORGOTTEN = 0.05  # correlation beyond a gap
ALONE = 1e-10  # of what is known of a parameter, that other blocks tell at least
ERRORS, ODDS = 2.0, 3.0  # differences that count: standard errors; ln 20, about, of the evidence
HEAD = {"prediction": "ln density of blocks left out", "evidence": "ln evidence"}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of `tb.compare`, the best model first.

    Args:
        names: of the models;  parameters (models,): their number
        by: "prediction" or "evidence"
        value: (models,) log density of the readings left out, or of all data, in their own units:
            only differences count
        difference, error: (models,) value of the best less its own, and the standard error by the
            scatter of blocks; evidence has no error: 0
        rms: (models,) of the errors of prediction over the noise's deviation; NaN for evidence
        each: (models, blocks) the terms of `value`
        said: sentences: models that the data cannot distinguish

    Examples:
        >>> x = torch.linspace(0, 1, 40)
        >>> y = 1 + 2 * x + 0.1 * torch.randn(40, generator=torch.Generator().manual_seed(0))
        >>> data = tb.Measurement(y, 0.1, times=x)
        >>> level = tb.identify(lambda p: p["a"][:, None].expand(-1, 40), data, {"a": 1.0})
        >>> line = tb.identify(lambda p: p["a"][:, None] + p["b"][:, None] * x, data,
        ...                    {"a": 1.0, "b": 0.0})
        >>> tb.compare({"level": level, "line": line}).names[0]
        'line'
    """

    names: tuple[str, ...]
    by: str
    parameters: tuple[int, ...]
    value: Tensor
    difference: Tensor
    error: Tensor
    rms: Tensor
    each: Tensor
    said: tuple[str, ...]

    def summary(self) -> str:
        """Table of the models, with models that the data cannot distinguish."""
        head = ("model", "parameters", HEAD[self.by], "less than the best", "+-", "RMS error")
        columns = self.value, self.difference, self.error, self.rms
        rows = [
            (name, f"{p}", *("" if math.isnan(v) else f"{v:.4g}" for v in row))
            for name, p, row in zip(self.names, self.parameters, torch.stack(columns, -1).tolist(),
                                    strict=True)
        ]  # fmt: skip
        used = 6 if self.by == "prediction" else 4
        return "\n".join([*aligned([one[:used] for one in (head, *rows)], range(1, used)), "",
                          *self.said])  # fmt: skip

    def __repr__(self) -> str:
        rows = zip(self.names[1:], self.difference[1:].tolist(), self.error[1:].tolist(),
                   strict=True)  # fmt: skip
        less = ", ".join(f"{name} {d:.3g} +- {e:.2g} less" for name, d, e in rows)
        return f"Comparison(by {self.by}: {self.names[0]} best, {less})"


def compare(
    fits: Mapping[str, Fit],
    *,
    by: str = "prediction",
    blocks: int | None = None,
    gap: int | None = None,
) -> Comparison:
    """Models compared by their fits to the same data.

    Args:
        fits: name -> `Fit` of `identify`
        by: "prediction": each block of readings is predicted from the others; the log densities of
            its data are summed (Vehtari, Gelman and Gabry 2017, Statistics and Computing 27, 1413).
            The parameters leave each fit by a Gauss-Newton step. The model is then evaluated once
            for each block, as a batch. This is exact if readings are linear in the coordinates of
            the search. "evidence": the density of all data, with parameters integrated out by
            Laplace's approximation at the fit (MacKay 1992, Neural Computation 4, 415). Every
            parameter needs a prior, and the noise a sigma. Offsets, drifts and hum have flat priors
            in the unit of the data, and must be the same in all models. Deviations that were
            estimated by channel have a flat prior of the logarithm
        blocks: number of blocks of times in each experiment. None = each experiment is a block if
            there are four or more; else ten blocks of times, or of poses without times
        gap: number of readings on either side of a block that do not predict it. None = the length
            of the residuals' correlation, the shortest of all models, at most a block. Poses and
            experiments have 0

    Raises:
        ValueError: for fits of other data, or from files, and for a block that alone determines a
            parameter. For evidence with parameters without priors or at bounds, or with noise that
            is not normal with a known sigma.

    Examples:
        >>> x = torch.linspace(0, 1, 40)
        >>> y = 1 + 2 * x + 0.1 * torch.randn(40, generator=torch.Generator().manual_seed(0))
        >>> data = tb.Measurement(y, 0.1, times=x)
        >>> level = tb.identify(lambda p: p["a"][:, None].expand(-1, 40), data, {"a": 1.0})
        >>> line = tb.identify(lambda p: p["a"][:, None] + p["b"][:, None] * x, data,
        ...                    {"a": 1.0, "b": 0.0})
        >>> print(tb.compare({"level": level, "line": line}).said[0])
        'line' is the best
    """
    choice("by", by, KINDS)
    names, models = _checked(fits)
    if by == "evidence":
        if len({fit.names[fit.problem.parameters.model :] for fit in models}) > 1:
            raise ValueError(
                "fits with other offsets, drifts or hum each were given to compare by evidence, "
                "which takes these as flat; the same in all, or by='prediction', are wanted"
            )
        each = torch.stack([_evidence(n, f) for n, f in zip(names, models, strict=True)])[:, None]
        rms = torch.full_like(each[:, 0], torch.nan)
    else:
        number = None if blocks is None else count("blocks", blocks, least=2)
        wide = None if gap is None else count("gap", gap, least=0)
        memory = min(_memory(fit) for fit in models) if wide is None else 0
        parts = [_left_out(n, f, number, wide, memory) for n, f in zip(names, models, strict=True)]
        each, rms = (torch.stack(part) for part in zip(*parts, strict=True))
    value = each.sum(-1)
    order = value.argsort(descending=True)
    less = each[order[0]] - each[order]
    error = less.shape[1] ** 0.5 * less.std(-1) if less.shape[1] > 1 else torch.zeros_like(value)
    names, sizes = ([of[k] for k in order.tolist()] for of in (names, [len(f.x) for f in models]))
    said = _said(names, less.sum(-1).tolist(), error.tolist(), by)
    # fmt: off
    return Comparison(tuple(names), by, tuple(sizes), value[order], less.sum(-1), error, rms[order],
                      each[order], (said,))
    # fmt: on


def _checked(fits: Mapping[str, Fit]) -> tuple[list[str], list[Fit]]:
    """Names and fits, of the same data."""
    good = isinstance(fits, Mapping) and len(fits) > 1
    if not good or not all(isinstance(fit, Fit) for fit in fits.values()):
        raise refusal(f"fits = {shown(fits)}", "two or more, name -> tb.Fit,", were=True, are=True)
    data = []
    for name, fit in fits.items():
        if fit.problem is None:
            raise refusal(
                f"the fit {name!r} from a file, which has no model,", "one of tb.identify"
            )
        data.append(torch.cat([r.data.flatten() for r in fit.readings]))
    for name, row in zip(fits, data, strict=True):
        if row.shape != data[0].shape or not torch.equal(row.nan_to_num(), data[0].nan_to_num()):
            raise ValueError(
                f"the fit {name!r} was given, whose data are others than those of "
                f"{next(iter(fits))!r}; fits of the same data are wanted"
            )
    return [*map(str, fits)], [*fits.values()]


def _said(names: list[str], less: list[float], error: list[float], by: str) -> str:
    alike = [
        f"{name!r} ({d:.2g}{f' +- {e:.2g}' if by == 'prediction' else ''} less)"
        for name, d, e in zip(names[1:], less[1:], error[1:], strict=True)
        if d < (ERRORS * e if by == "prediction" else ODDS)
    ]
    return (
        f"{names[0]!r} is the best, but {' and '.join(alike)} cannot be told from it"
        if alike
        else f"{names[0]!r} is the best"
    )


def _evidence(name: str, fit: Fit) -> Tensor:
    """() logarithm of the density of the data."""
    problem, x = fit.problem, fit.x[None]
    free = [e.name for e in problem.parameters.entries if e.prior is None]
    if not problem.parameters.by_name:
        free = [*problem.parameters.names[: problem.parameters.model]]
    if free:
        raise ValueError(
            f"evidence of the fit {name!r} was asked for, whose parameter {free[0]!r} has no "
            "prior; tb.Parameter(prior=...) is wanted, or by='prediction'"
        )
    if not problem.independent.all() or not problem.sigma_given:
        raise ValueError(
            f"evidence of the fit {name!r} was asked for, whose noise is no normal one of a known "
            "size; sigma, with noise 'white' or 'ar1', is wanted, or by='prediction'"
        )
    if fit.held.any() or fit.open.any():
        k = int((fit.held | fit.open).int().argmax())
        raise ValueError(
            f"evidence of the fit {name!r} was asked for, whose parameter {fit.names[k]!r} is "
            f"{'at its bound' if fit.held[k] else 'not told'}; an inner maximum is wanted"
        )
    with torch.no_grad():
        r = problem.residuals(x, torch.zeros(1, dtype=torch.long, device=x.device))[0]
    phi, _, bend = (part[0] for part in problem.prior(x))
    _, log_det = positive_inverse(fit.jacobian.mT @ fit.jacobian + torch.diag(bend))
    sizes = (2 * torch.pi / (2 * fit.redundancy)).log().sum() / 2 if problem.noise.names else 0
    log_likelihood = (_log_unit(problem) - r.square() / 2).sum()
    return log_likelihood - phi + len(fit.x) * math.log(2 * math.pi) / 2 - log_det / 2 + sizes


def _log_unit(problem: FitProblem) -> Tensor:
    """(T,) logarithm of the density of each reading where its weighted residual is 0."""
    white = problem.white
    return white.weight.log() - (1 - white.carried.square()).log() / 2 - math.log(2 * math.pi) / 2


def _memory(fit: Fit) -> int:
    """Readings until residuals have forgotten; 0 of poses."""
    problem, longest = fit.problem, 0
    off = torch.cat([(q.y - q.data).flatten() for q in fit.readings])
    r = off[problem.known[: len(off)]]
    for e, m, rows in problem.rows():
        if e.measured and m.times is not None:
            a = correlation_of(r, [series_of(m, rows)[1]])
            if a > FORGOTTEN:
                longest = max(longest, math.ceil(math.log(FORGOTTEN) / math.log(min(a, 0.99))))
    return longest


def _left_out(
    name: str, fit: Fit, blocks: int | None, gap: int | None, memory: int
) -> tuple[Tensor, Tensor]:
    """Logarithm of the density of each block (blocks,), predicted by the others, and the RMS () of
    the errors over the noise's deviation.
    """
    problem, x, J = fit.problem, fit.x[None], fit.jacobian
    if (problem.loss != 0).any():
        raise refusal(f"the fit {name!r} with a loss that is no square", "one of squares")
    with torch.no_grad():
        first = torch.zeros(1, dtype=torch.long, device=x.device)
        r, bend = problem.residuals(x, first)[0], problem.prior(x)[2][0]
        free = ~(fit.held | fit.open)
        J = J[:, free]
        A = J.mT @ J + torch.diag(bend[free])
        size = A.diagonal().rsqrt()
        masks, inverses = [*_blocks(problem, blocks, gap, memory)], []
        moved = x.repeat(len(masks), 1)
        for k, (_, out) in enumerate(masks):
            rest = A - J[out].mT @ J[out]
            known = torch.linalg.eigvalsh(size[:, None] * rest * size)
            if (known < ALONE).any():
                raise ValueError(
                    f"blocks of which one tells a parameter of the fit {name!r} alone were given; "
                    "more of them, or less of a gap, are wanted"
                )
            inverses.append(torch.linalg.inv(rest))
            moved[k, free] = moved[k, free] + inverses[-1] @ (J[out].mT @ r[out])
        moved = moved.clamp(*problem.parameters.bounds(moved))
        predicted = problem.residuals(moved, first.expand(len(moved)))
        s, values, squares, unit = fit.scale or 1.0, [], 0.0, _log_unit(problem)
        for (inside, _), C, e, at in zip(masks, inverses, predicted, moved, strict=True):
            J_in, linear = J[inside], r[inside] + J[inside] @ (at - x[0])[free]
            e = torch.where(torch.isfinite(e[inside]).all(), e[inside], linear) / s
            more = torch.eye(len(C)).to(C) + C @ (J_in.mT @ J_in)
            pull = J_in.mT @ e
            quadratic = e @ e - pull @ torch.linalg.solve(more, C @ pull)
            log_unit = unit[inside].sum() - len(e) * math.log(s)
            values.append(log_unit - (quadratic + torch.linalg.slogdet(more)[1]) / 2)
            squares = squares + e @ e
        count_ = sum(int(inside.sum()) for inside, _ in masks)
        return torch.stack(values), (squares / count_).sqrt()


def _blocks(
    problem: FitProblem, blocks: int | None, gap: int | None, memory: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Readings (T,) bool of each block, and those that are left out for it."""
    measured = [e for e in problem.experiments if e.measured]
    none = torch.zeros(len(problem.target[0]), dtype=torch.bool, device=problem.known.device)
    for e in measured:
        series = [series_of(m, rows) for owner, m, rows in problem.rows() if owner is e]
        instants = torch.cat([t for t, _, _ in series]).unique()
        whole = blocks is None and len(measured) >= FEWEST
        parts = 1 if whole else min(blocks or BLOCKS, len(instants))
        if gap is not None:
            wide = gap
        else:
            wide = min(memory, len(instants) // parts) if all(o for *_, o in series) else 0
        for k in range(parts):
            first, last = (-(-len(instants) * j // parts) for j in (k, k + 1))
            masks = none.clone(), none.clone()
            for t, rows, _ in series:
                place = torch.searchsorted(instants, t)
                for mask, more in zip(masks, (0, wide), strict=True):
                    inside = rows[(first - more <= place) & (place < last + more)]
                    mask[inside[inside >= 0]] = True
            if masks[0].any():
                yield masks
