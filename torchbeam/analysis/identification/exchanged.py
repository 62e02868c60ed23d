"""Exchanged channels, signs and units: data that fit the model better with two markers or channels
in each other's place, or as a multiple of themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...sensors import Sensor
from .hints import series
from .problem import FitProblem
from .readings import Readings

FACTOR = 1.5  # of the misfit, by which an exchange is better
ALIKE = 0.2  # of the distance of their offsets, which an exchange leaves at most to make them alike
FEWEST = 3  # readings in a row
TRIED = 4  # pairs
# factors of data that are read with another sign or in another unit
MULTIPLES = {
    -1.0: "another sign",
    9.80665: "g for m/s^2",
    1 / 9.80665: "m/s^2 for g",
    1000.0: "m for mm, kg for g",
    1e-3: "mm for m, g for kg",
}
NOISE = 25.0  # variances of the noise, that are at stake at least


@dataclass(frozen=True)
class Channels:
    """What may have been exchanged with its like: a marker, or a single channel.

    like  what its like has too: experiment, measurement, shape, unit;  times (T,) or None
    rows  (T, c) of its readings among the data, -1 of what is missing
    """

    name: str
    like: tuple[Any, ...]
    times: Tensor | None
    rows: Tensor

    def fits(self, other: Channels) -> bool:
        a, b = self.times, other.times
        same = a is b or (a is not None and b is not None and torch.equal(a, b))
        return self.like == other.like and same


def exchange_hints(
    problem: FitProblem, r: Tensor, J: Tensor, C: Tensor, scale: float, theta: Tensor
) -> list[str]:
    """A sentence about the two whose exchange, all along or over a part of the record, would make
    the misfit smallest: with the parameters where one step of Gauss and Newton takes them then,
    without an evaluation. Offsets of each channel take most of an exchange up, so that the misfit
    is a little smaller only; but those of two markers of the same cameras, which are far apart,
    become alike by it.

    r (T,), J (T, p) weighted, C (p, p) covariance over the weighted noise, of `scale`; theta (p,)
    """
    if not all(torch.isfinite(part).all() for part in (r, J, C)):
        return []
    data, best = problem.white.inverse(problem.target[0]), ((True, 1 / FACTOR**2), "")
    N, pull, squares = J.mT @ J, J.mT @ r, r.square().sum()
    for a, b, stretch in _likeliest(problem, r, J, C, data):
        there = (a.rows >= 0) & (b.rows >= 0)
        zeros = [_offsets(problem, c) for c in (a, b)]
        for part in (slice(0, len(there)), stretch):
            first, two = (c.rows[part][there[part]] for c in (a, b))
            if part.stop - part.start < min(FEWEST, len(there)) or not len(first):
                continue
            change = torch.zeros_like(data)
            change[first], change[two] = data[first] - data[two], data[two] - data[first]
            change = problem.white(change)
            by = J.mT @ change
            step, more = C @ by, change @ (2 * r + change)
            left = squares + more - 2 * step @ (pull + by) + step @ N @ step
            share, fall = (left / squares).item(), by @ step - more  # of squares and priors
            whole = part.stop - part.start == len(there)
            alike = whole and share < 1 and _alike(*zeros, theta, theta - step)
            if fall > NOISE * scale**2 and (not alike, share) < best[0]:
                best = (not alike, share), _sentence(a, b, part, share, alike)
    return [best[1]] * bool(best[1])


def multiple_doubts(
    problem: FitProblem, r: Tensor, J: Tensor, C: Tensor, scale: float
) -> list[str]:
    """A sentence about the channel, or all data, of which a multiple fits best, by a step as in
    `exchange_hints`. Of multiples below 1 the model's readings grow instead of the data's, so that
    no misfit falls as all numbers get smaller.
    """
    if not all(torch.isfinite(part).all() for part in (r, J, C)):
        return []
    alone, squares = problem.white.inverse(problem.target[0]), r.square().sum()
    prior, best = torch.linalg.pinv(C, hermitian=True) - J.mT @ J, (1 / FACTOR**2, "")
    channels = [
        (repr(name) if name else "the record", rows) for _, name, rows, _ in series(problem)
    ]
    all_ = [("the record", torch.cat([rows for _, rows in channels]))] * (len(channels) > 1)
    channels.sort(key=lambda channel: -r[channel[1]].square().sum().item())
    for name, rows in (*channels[:TRIED], *all_):
        some = torch.zeros_like(alone, dtype=torch.bool)
        some[rows] = True
        for factor, what in MULTIPLES.items():
            off, by = r, J
            if abs(factor) < 1:
                y = problem.white.inverse(r + problem.target[0])
                off = r + problem.white(torch.where(some, (1 / factor - 1) * y, 0.0))
                by = torch.where(some[:, None], J / factor, J)
            else:
                off = r + problem.white(torch.where(some, (1 - factor) * alone, 0.0))
            pull = by.mT @ off
            step = torch.linalg.pinv(prior + by.mT @ by, hermitian=True) @ pull
            left = (off - by @ step).square().sum()
            share = (left / squares).item()
            if squares - left > NOISE * scale**2 and share < best[0]:
                said = f"{name} fits {factor:.4g} times its readings ({what}?)"
                best = share, f"{said}: the misfit would be {share**0.5:.2g} of what it is"
    return [best[1]] * bool(best[1])


def _offsets(problem: FitProblem, channels: Channels) -> list[int]:
    """Places among the parameters of a marker's offsets, one for each of its numbers; none of what
    has not each, or is one number alone.
    """
    nuisance, (experiment, *_) = problem.nuisance, channels.like
    prefix = "offset of " if experiment is None else f"{experiment}.offset of "
    offset = torch.tensor([n.startswith(prefix) for n in nuisance.names], dtype=torch.bool)
    if channels.rows.shape[1] < 2 or not offset.any():
        return []
    rows, places = nuisance.rows[:, problem.known][offset], nuisance.place[offset].tolist()
    found = []
    for column in channels.rows.unbind(1):
        there = column[column >= 0]
        if len(there) and (own := rows[:, there[0]].nonzero()[:, 0]).numel():
            found.append(places[int(own[0])])
    return found if len(found) == channels.rows.shape[1] else []


def _alike(one: list[int], two: list[int], before: Tensor, after: Tensor) -> bool:
    """Whether two markers' offsets are alike after, as they were not before."""
    if not one or not two:
        return False
    apart = [torch.linalg.vector_norm(theta[one] - theta[two]) for theta in (before, after)]
    return bool(apart[1] < ALIKE * apart[0])


def _likeliest(
    problem: FitProblem, r: Tensor, J: Tensor, C: Tensor, data: Tensor
) -> Iterator[tuple[Channels, Channels, slice]]:
    """Pairs whose exchange makes the squares fall most, as noise were independent: all along, with
    the parameters following; or over readings in a row, with these as they are.
    """
    r, J, weight = problem.white.alone(r), problem.white.alone(J.mT).mT, problem.white.weight
    for group in _groups(problem):
        rows = torch.stack([c.rows for c in group])
        there, d, w, off, by = rows >= 0, data[rows], weight[rows], r[rows], J[rows]
        pairs = []
        for i in range(len(group) - 1):
            rest = slice(i + 1, None)
            apart = torch.where(there[i] & there[rest], d[i] - d[rest], 0)
            a, b = w[i] * apart, -w[rest] * apart
            gain = -(a * (2 * off[i] + a) + b * (2 * off[rest] + b)).sum(-1)
            moved = torch.einsum("ntc,tcp->np", a, by[i]) + torch.einsum(
                "ntc,ntcp->np", b, by[rest]
            )
            whole = gain.sum(-1) + ((moved @ C) * moved).sum(-1)
            sums = torch.nn.functional.pad(gain.cumsum(-1), (1, 0))
            least, where = sums.cummin(-1)
            rise, last = (sums - least).max(-1)
            first = where.gather(-1, last[:, None])[:, 0]
            few = min(TRIED, len(whole))
            for k in {k for part in (whole, rise) for k in part.topk(few).indices.tolist()}:
                ends = (part[k].item() for part in (whole, rise, first, last))
                pairs.append((*ends, group[i], group[i + 1 + k]))
        for by_what in (0, 1):
            for *_, first, last, a, b in sorted(pairs, key=lambda of: -of[by_what])[:TRIED]:
                yield a, b, slice(first, last)


def _groups(problem: FitProblem) -> list[list[Channels]]:
    """Channels that may be exchanged with each other."""
    groups: list[list[Channels]] = []
    for channels in _channels(problem):
        own = next((group for group in groups if group[0].fits(channels)), None)
        if own is None:
            groups.append(own := [])
        own.append(channels)
    return groups


def _sentence(a: Channels, b: Channels, part: slice, share: float, alike: bool) -> str:
    where, so = "", ", and their offsets alike" * alike
    if part.stop - part.start < len(a.rows):
        ends = part.start, part.stop - 1
        where = f" from reading {ends[0]} to {ends[1]}"
        if a.times is not None:
            where = " from {:.4g} to {:.4g} s".format(*a.times[list(ends)].tolist())
    return (
        f"{a.name!r} and {b.name!r} seem to be exchanged{where}: with the data of each in the "
        f"other's place the misfit would be {max(share, 0.0) ** 0.5:.2g} of what it is{so}"
    )


def _channels(problem: FitProblem) -> Iterator[Channels]:
    """Whole measurements, rows of their second axis, and single channels, of each measurement."""
    for k, (e, m, rows) in enumerate(problem.rows()):
        if not e.measured or not rows.ndim:
            continue
        columns = rows.reshape(len(rows), -1)
        sensor = m.sensor if isinstance(m.sensor, Sensor) else None
        name = m.name or (sensor.name if sensor else f"measurement {k}")
        name = " ".join(filter(None, (e.name, name)))
        unit = sensor.unit if sensor else ""
        yield Channels(name, (e.name, columns.shape, unit), m.times, columns)
        if rows.ndim > 2:
            for j, column in enumerate(rows.unbind(1)):
                yield Channels(f"{name} {j}", (e.name, k, "row"), m.times, column.flatten(1))
        if columns.shape[1] > 1:
            names = Readings(e.name, m.labels, None, m.values, m.values, None).names
            for label, column in zip(names, columns.unbind(1), strict=True):
                yield Channels(label, (e.name, k, "one"), m.times, column[:, None])
