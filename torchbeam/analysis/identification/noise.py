"""Noise that is found with the parameters: one deviation for all data, or one for each channel; the
correlation from reading to reading; the weights of a loss.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

SHARED = (
    "measurements in {units} share one deviation, which none of them has, and stated intervals are "
    "wrong: sigma of each, or more readings, are wanted"
)
NOISES = ("common", "channel")
LEAST = 2  # readings of a channel whose noise is to be found


@dataclass(frozen=True)
class Noise:
    """Which data have a noise whose size is found with the parameters.

    channel  (all numbers,) of the data, measured or not: number of the channel that each belongs
             to, -1 where sigma is known
    names    of the channels;  fitted (channels,) numbers that models take from their data, see
             `Measurement`
    """

    channel: Tensor
    names: tuple[str, ...] = ()
    fitted: tuple[float, ...] = ()

    @classmethod
    def known(cls, like: Tensor) -> Noise:
        """None is to be found, of data `like` (all numbers,)."""
        return cls(torch.full(like.shape, -1, device=like.device))

    @classmethod
    def common(cls, like: Tensor, fitted: float) -> Noise:
        """One factor of all sigma."""
        return cls(
            torch.zeros(like.shape, dtype=torch.long, device=like.device), ("data",), (fitted,)
        )

    @classmethod
    def by_channel(cls, experiments: Sequence[Any]) -> tuple[tuple[Any, ...], Noise]:
        """Experiments whose measurements without sigma have a first one, the scatter of each
        channel's data; and the channels of these. Raises ValueError for one of too few readings.
        """
        names: set[str] = set()

        def name(e: Any, m: Any, label: str) -> str:
            full = " ".join(filter(None, (e.name, label))) or "data"
            full = full if full not in names else f"{full} ({len(names)})"
            names.add(full)
            return full

        sized, noise, readings = cls._by(experiments, name)
        for channel, count, lost in zip(noise.names, readings, noise.fitted, strict=True):
            if count - lost < LEAST:
                raise _too_few(channel, count)
        return sized, noise

    @classmethod
    def by_unit(
        cls, experiments: Sequence[Any], parameters: int
    ) -> tuple[Sequence[Any], Noise | None]:
        """As `by_channel`, with a deviation for each unit, of sensors without sigma of which all
        know theirs and some differ. Without these, or where a unit has too few readings beside so
        many parameters to know its noise by, the noise is common.
        """
        every = [m for e in experiments for m in e.measurements]
        units = {unit_of(m) for m in every}
        if None in units or len(units) < 2 or any(m.sigma is not None for m in every):
            return experiments, None
        sized, noise, readings = cls._by(experiments, lambda e, m, label: unit_of(m))
        rest = (n - lost - parameters for n, lost in zip(readings, noise.fitted, strict=True))
        return (experiments, None) if min(rest) < LEAST else (sized, noise)

    @classmethod
    def _by(
        cls, experiments: Sequence[Any], name_of: Callable[[Any, Any, str], Any]
    ) -> tuple[tuple[Any, ...], Noise, list[int]]:
        """By names of channels: experiments with a first sigma, channels, readings of each."""
        numbers, order = [], {}
        squares, fitted, readings = (Counter[Any]() for _ in range(3))
        for e in experiments:
            for m in e.measurements:
                columns = m.values.reshape(-1, len(m.labels))
                here = torch.full(columns.shape, -1, device=columns.device)
                for k, label in enumerate(m.labels):
                    seen = columns[~columns[:, k].isnan(), k]
                    if m.sigma is not None or not len(seen):
                        continue
                    name = name_of(e, m, label)
                    here[:, k] = order.setdefault(name, len(order))
                    fitted[name] += m.fitted / len(m.labels)
                    readings[name] += len(seen)
                    scatter = (seen - seen.mean()).square().sum().item()
                    scatter = scatter or len(seen) * (seen.abs().max().item() or 1.0) ** 2
                    squares[name] += scatter
                numbers.append(here.flatten())
        noise = cls(torch.cat(numbers), tuple(order), tuple(fitted.values()))
        first = [math.sqrt(squares[name] / readings[name]) for name in order]
        like = dict(dtype=torch.float64, device=numbers[0].device)
        sigma = noise.each(torch.tensor(first, **like))
        rest, sized = iter(sigma.split([len(n) for n in numbers])), []
        for e in experiments:
            each = [(m, next(rest).to(m.values).reshape(m.values.shape)) for m in e.measurements]
            known = tuple(m if m.sigma is not None else replace(m, sigma=s) for m, s in each)
            sized.append(replace(e, measurements=known))
        return tuple(sized), noise, list(readings.values())

    def sums(self, values: Tensor, known: Tensor) -> Tensor:
        """(..., channels) of values (..., T) of the data that were measured."""
        belongs = torch.nn.functional.one_hot(self.channel[known] + 1, len(self.names) + 1)[:, 1:]
        return values @ belongs.to(values)

    def each(self, values: Tensor) -> Tensor:
        """(..., all numbers) of values (..., channels); of data whose sigma is known, 1."""
        # -1 is the last
        return torch.nn.functional.pad(values, (0, 1), value=1.0)[..., self.channel]

    def redundancy(self, J: Tensor, covariance: Tensor, known: Tensor) -> Tensor:
        """(channels,) readings less the numbers that parameters and models take from them: trace of
        what projects data (T,) on residuals, by J (T, p) and the covariance (p, p) of the
        parameters over weighted data.
        """
        leverage = ((J @ covariance) * J).sum(-1)
        return self.sums(1 - leverage, known) - leverage.new_tensor(self.fitted)

    def refuse(self, redundancy: Tensor, known: Tensor) -> None:
        """Raise ValueError where a channel's readings follow the parameters and leave no noise."""
        for c in (redundancy < 1).nonzero()[:, 0].tolist():
            raise _too_few(
                self.names[c], int((self.channel[known] == c).sum()), redundancy[c].item()
            )


def unit_of(m: Any) -> str | None:
    """Of what a measurement's sensor reads; None = not known."""
    unit = getattr(m.sensor, "unit", None)
    return f"{unit}/s".replace("/s/s", "/s^2") if unit and m.rate else unit


def _too_few(name: str, readings: int, free: float | None = None) -> ValueError:
    left = "" if free is None else f", of which the parameters leave {max(free, 0.0):.1f} free"
    return ValueError(
        f"noise='channel' was given with {name!r} of {readings} readings{left}; the sigma of that "
        "is wanted, or more of them"
    )
