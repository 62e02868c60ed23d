"""Hints: what looks wrong in data and fit, in sentences."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from .noise import SHARED, unit_of
from .problem import FitProblem
from .readings import Readings
from .residuals import FEWEST, Residuals, ResidualTest

# factor between two units, factor by which a start in the right unit may be off, whether that is
# asked of fits alone that have not converged, examples
UNITS = (
    (1000.0, 5.0, False, "mm for m, MPa for Pa, g for kg", "m for mm, Pa for MPa, kg for g"),
    (180 / math.pi, 2.0, True, "degrees for rad", "rad for degrees"),
    (9.80665, 2.0, True, "m/s^2 for g", "g for m/s^2"),
)
FAR = 10.0  # times the model's at the start: data of another kind
OPPOSITE = -0.5  # correlation of data with a model at its start
KNOWN = 0.1  # of a parameter's size, to which it is known with the others where they are
SHOWN = 0.1  # of a direction: smaller parts are not named
ALARM = 0.01  # of the fits of models that are right, in which any test may find something


def unit_hints(
    readings: Sequence[Readings], offset: Sequence[bool], converged: bool
) -> tuple[str, ...]:
    """Channels whose data are about a thousand times the model's at the start, or a thousandth; of
    a fit that has not converged, degrees for rad and g for m/s^2 too, and another sign. Of those
    with an `offset` what is beside their mean. First pairs, each with the size of the other's.
    """
    said, off = [], []
    for reading, shifted in zip(readings, offset, strict=True):
        for label, data, y in reading.channels():
            known = ~(data.isnan() | y.isnan())
            both = [v[known] - shifted * v[known].mean() for v in (data, y)]
            size, first = (v.square().mean().sqrt().item() for v in both)
            if not size or not first or not math.isfinite(first):
                continue
            what, ratio = f"{label!r}" if label else "the data", size / first
            if not 1 / FAR < ratio < FAR:
                off.append((what, size, first))
            alike = ((both[0] * both[1]).mean() / size / first).item()
            if not converged and alike < OPPOSITE:
                said.append(
                    f"{what}: the data go against the model's at the start (correlation "
                    f"{alike:.2f}); is their sign another?"
                )
            for unit, near, doubtful, larger, smaller in UNITS:
                if doubtful and converged:
                    continue
                if unit / near < ratio < unit * near:
                    said.append(
                        f"{what}: the RMS of the data, {size:.3g}, is {ratio:.3g} times the "
                        f"model's at the start {first:.3g}; is a unit off by {unit:.4g} ({larger})?"
                    )
                elif unit / near < 1 / ratio < unit * near:
                    said.append(
                        f"{what}: the RMS of the model at the start, {first:.3g}, is "
                        f"{1 / ratio:.3g} times the data's, {size:.3g}; is a unit off by "
                        f"{unit:.4g} ({smaller})?"
                    )
    exchanged = [
        f"{a} and {b} seem to be exchanged: the data of each have the size of the other's model at "
        "the start"
        for (a, *of_a), (b, *of_b) in itertools.combinations(off, 2)
        if all(0.5 < x / y < 2 for x, y in ((of_a[0], of_b[1]), (of_b[0], of_a[1])))
    ]
    return (*exchanged, *said)


def noise_hints(freedom: int, sigma_given: bool) -> tuple[str, ...]:
    """A noise that nothing tells."""
    if sigma_given or freedom >= 1:
        return ()
    return (
        "there are as many parameters as data, and no sigma: the noise is not known, and stated "
        "deviations and intervals say nothing",
    )


def misfit_hints(problem: FitProblem, r: Tensor, J: Tensor, C: Tensor) -> tuple[str, ...]:
    """Residuals that are no noise of the size that was stated: more squares than sigma says, of all
    data and of each channel; residuals that are alike from reading to reading; a line in their
    periodogram; outliers, of residuals that are not alike. All these tests together find something
    in one of a hundred fits of models that are right, or in fewer (Bonferroni). Where sigma is not
    known squares say nothing; noise that counts by blocks may be of any size and alike.

    r, J, C  weighted residuals (T,), their derivatives (T, p), covariance (p, p) of the parameters
             over the weighted noise
    """
    free = [m for e, m in problem.measurements if e.measured and m.sigma is None]
    units = {unit_of(m) or "" for m in free} if not problem.sigma_given else set()
    shared = [SHARED.format(units=" and ".join(sorted(units)))] * (len(units) > 1 > ("" in units))
    if not all(torch.isfinite(part).all() for part in (r, J, C)):
        return tuple(shared)
    channel = problem.noise.channel[problem.known]  # -1: sigma is known
    every = problem.measured & (channel < 0) & problem.independent
    whole = Residuals("", None, r[every], J[every], C, True)
    channels = [
        Residuals(name, times, r[rows], J[rows], C, channel[rows[0]].item() < 0)
        for _, name, rows, times in series(problem)
        if problem.independent[rows[0]] and _is_noisy(r[rows], problem.target[0][rows])
    ]
    parts = channels if len(channels) > 1 else []
    sizes, each = (
        [rest.excess() for rest in some if rest.known and rest.left > 0.99]
        for some in ([whole], parts)
    )
    long = [rest for rest in channels if rest.left >= FEWEST]
    alike, lines = [rest.correlation() for rest in long], [rest.line() for rest in long]
    far = [rest.outliers() for rest in channels]
    level = ALARM / max(len(sizes) + len(each) + len(alike) + len(lines) + len(far), 1)
    smooth = {a.name for a in alike if a.probability < level}
    far = [a for a in far if a.name not in smooth]
    said = [
        f"the misfit{of} is {a.size:.3g} times what sigma says ({chance}): noise is larger, or the "
        "model or its mesh does not explain the data"
        for kind in (sizes, each)
        for a, of, chance in _least(kind, level)
    ]
    said += [
        f"residuals{of} of neighbouring readings are alike (correlation {a.size:.2f}, {chance}): "
        "the model misses something that is no noise"
        for a, of, chance in _least(alike, level)
    ]
    said += [
        f"residuals{of} have a line {a.at}, {a.size:.3g} times what noise has there ({chance}): "
        "the model misses a vibration, or what drives or damps it"
        for a, of, chance in _least(lines, level)
    ]
    said = [f"{sentence}, and stated intervals are too narrow" for sentence in said]
    said += [
        f"readings{of} are further off than normal noise: {a.at}, by up to {a.size:.3g} deviations "
        f"of the others ({chance}): outliers move the fit, which loss='student' or 'huber' "
        "gives less weight"
        for a, of, chance in _least(far, level)
    ]
    return (*shared, *said)


def series(problem: FitProblem) -> Iterator[tuple[str | None, str, Tensor, Tensor | None]]:
    """Experiment, name, rows (n,) of the data in the order of their times, and these, of each
    channel.
    """
    for e, m, rows in problem.rows():
        readings = Readings(e.name, m.labels, m.times, m.values, rows, None)
        for name, _, column in readings.channels() if e.measured else ():
            order = torch.arange(len(column), device=column.device)
            order = order if m.times is None else m.times.argsort()
            there = order[column[order] >= 0]
            if len(there):
                times = None if m.times is None else m.times[there]
                yield e.name, name, column[there], times


def _is_noisy(r: Tensor, data: Tensor) -> bool:
    """Whether residuals (n,) are more than the rounding of what gives them."""
    return (r.square().sum() > torch.finfo(r.dtype).eps * data.square().sum()).item()


def _least(tests: Sequence[ResidualTest], level: float) -> Iterator[tuple[ResidualTest, str, str]]:
    """The least probable test below a level: of which channel and how many more, how probable."""
    below = sorted(
        (a for a in tests if a.probability < level), key=lambda a: (a.probability, -abs(a.size))
    )
    for a in below[:1]:
        more = f" and {len(below) - 1} more channel{'s' * (len(below) > 2)}" * (len(below) > 1)
        of = f" of {a.name!r}" if a.name else ""
        yield a, of + more, f"by chance {max(a.probability, 1e-300):.0e}"


def bound_hints(names: Sequence[str], theta: Tensor, held: Tensor) -> tuple[str, ...]:
    """Parameters theta (p,) that a bound holds, `held` (p,) bool."""
    return tuple(
        f"{name} is at its bound, {value:.4g}, and the misfit falls beyond it: its interval is "
        "one-sided, and those of others take it as it is"
        for name, value, at in zip(names, theta.tolist(), held.tolist(), strict=True)
        if at
    )


def tangled_hints(
    names: Sequence[str], size: Tensor, alone: Tensor, covariance: Tensor
) -> tuple[str, ...]:
    """Parameters that data tell together and, within the noise, not one by one: each would be known
    well with the others where they are, and has a deviation above its own size.

    size (p,) of changes that matter;  alone (p,) deviations with the others where they are;
    covariance (p, p) of all together, zeros of those that are not in question
    """
    deviation = covariance.diagonal().sqrt()
    some = ((alone < KNOWN * size) & (deviation > size)).nonzero()[:, 0]
    if len(some) < 2:
        return ()
    unit = size[some]
    direction = torch.linalg.eigh(covariance[some][:, some] / unit / unit[:, None])[1][:, -1]
    parts = (direction.abs() > SHOWN).nonzero()[:, 0].tolist()
    if len(parts) < 2:
        return ()
    shares = (100 * direction * direction[parts[0]].sign()).tolist()
    together = ", ".join(f"{names[some[k]]} {shares[k]:+.0f} %" for k in parts)
    most = (deviation / size)[some].max().item()
    return (
        f"the data hardly tell {len(parts)} parameters apart, which change together: {together}; "
        f"deviations are up to {most:.2g} times their sizes, where each alone would be known to "
        f"{100 * (alone / size)[some].max().item():.2g} %; one that is known, or has a prior, is "
        "wanted",
    )
