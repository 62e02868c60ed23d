"""Readings: data of one measurement beside the model's values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Readings:
    """Data and model of one measurement.

    experiment, labels  names;  times (times,) s or None;  data, y, deviation, sigma  of the data's
                        shape: y with offsets and
    drifts, the deviation that y has from that of the parameters (NaN where data are missing); sigma
    None where it was not given
    """

    experiment: str | None
    labels: tuple[str, ...]
    times: Tensor | None
    data: Tensor
    y: Tensor
    sigma: Tensor | None
    deviation: Tensor | None = None

    def channels(self) -> Iterator[tuple[str, Tensor, Tensor]]:
        """Name, data (times,) and model of each channel."""
        yield from zip(self.names, self.columns(self.data), self.columns(self.y), strict=True)

    @property
    def names(self) -> list[str]:
        """Of the channels."""
        count = len(self.columns(self.data))
        labels = [*self.labels[:count], *map(str, range(len(self.labels), count))]
        return [" ".join(filter(None, (self.experiment, label))) for label in labels]

    @staticmethod
    def columns(values: Tensor) -> tuple[Tensor, ...]:
        """(times,) of each channel."""
        return (values.reshape(len(values), -1) if values.ndim else values.reshape(1, 1)).unbind(-1)
