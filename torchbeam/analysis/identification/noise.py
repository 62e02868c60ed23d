"""Noise that is found with the parameters: one deviation for all data, or one for each channel; the
correlation from reading to reading; the weights of a loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

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
        numbers, fitted, sizes = [], {}, []
        for e in experiments:
            with_sigma = []
            for m in e.measurements:
                columns = m.values.reshape(-1, len(m.labels))
                here = torch.full(columns.shape, -1, device=columns.device)
                sigma = torch.ones_like(columns[0])
                for k, label in enumerate(m.labels):
                    seen = columns[~columns[:, k].isnan(), k]
                    if m.sigma is not None or not len(seen):
                        continue
                    name = " ".join(filter(None, (e.name, label))) or "data"
                    name = name if name not in fitted else f"{name} ({len(fitted)})"
                    lost = m.fitted / len(m.labels)
                    if len(seen) - lost < LEAST:
                        raise _too_few(name, len(seen))
                    here[:, k], fitted[name] = len(fitted), lost
                    scatter = (seen - seen.mean()).square().mean().sqrt().item()
                    sigma[k] = scatter or seen.abs().max().item() or 1.0
                numbers.append(here.flatten())
                first = (
                    sigma.expand_as(columns).reshape(m.values.shape) if m.sigma is None else m.sigma
                )
                with_sigma.append(replace(m, sigma=first))
            sizes.append(replace(e, measurements=tuple(with_sigma)))
        return tuple(sizes), cls(torch.cat(numbers), tuple(fitted), tuple(fitted.values()))

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


def _too_few(name: str, readings: int, free: float | None = None) -> ValueError:
    left = "" if free is None else f", of which the parameters leave {max(free, 0.0):.1f} free"
    return ValueError(
        f"noise='channel' was given with {name!r} of {readings} readings{left}; the sigma of that "
        "is wanted, or more of them"
    )
