"""Readings: data of one measurement beside the model's values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Readings:
    """Data and model of one measurement.

    experiment, labels  names;  times (times,) s or None;  data, y, sigma  of the data's shape, y with offsets and drifts; sigma
    None where it was not given
    """

    experiment: str | None
    labels: tuple[str, ...]
    times: Tensor | None
    data: Tensor
    y: Tensor
    sigma: Tensor | None

    def channels(self) -> Iterator[tuple[str, Tensor, Tensor]]:
        """Name, data (times,) and model of each channel."""
        few = [v.reshape(*v.shape[:1], -1) if v.ndim else v.reshape(1, 1) for v in (self.data, self.y)]
        for k in range(few[0].shape[1]):
            label = self.labels[k] if k < len(self.labels) else str(k)
            yield " ".join(filter(None, (self.experiment, label))), few[0][:, k], few[1][:, k]
