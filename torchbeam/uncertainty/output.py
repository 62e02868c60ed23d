"""Output of samples: tables for pandas and xarray, summaries as CSV and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import number
from ..core.files import csv_text, file_of, folder, write
from ..core.validation import refusal, shown

LEVELS = (0.01, 0.05, 0.5, 0.95, 0.99)
COLUMNS = ("quantity", "y", "estimate", "low", "high", "level")


class Summary:
    """Summaries by the statistics of `Samples` and `Stream`: a base class of both."""

    def summary(
        self: Any,
        levels: Sequence[float] = LEVELS,
        interval: float = 0.95,
        thresholds: Sequence[float] = (),
    ) -> dict[str, Any]:
        """Numbers and texts, for JSON: rows of quantity, y, estimate, low, high, level for mean,
        deviation (not of a stream), quantiles and probabilities of y > threshold, of each number of
        y; numbers of samples, of failed ones by reason.
        """
        summary = {"mean": self.mean_interval(interval)}
        if hasattr(self, "deviation_interval"):
            summary["deviation"] = self.deviation_interval(interval)
        rows = []
        for name, estimate in summary.items():
            rows += _rows(name, estimate, interval)
        levels, thresholds = (
            _several(name, values)
            for name, values in (("levels", levels), ("thresholds", thresholds))
        )
        quantiles = self.quantile(levels, interval)
        for k, level in enumerate(levels):
            rows += _rows(f"quantile {level:g}", [part[k] for part in quantiles], interval)
        for threshold in thresholds:
            rows += _rows(f"P(y > {threshold:g})", self.exceedance(threshold, interval), interval)
        return {
            "samples": quantiles.samples + quantiles.failed,
            "failed": quantiles.failed,
            "reasons": dict(quantiles.reasons),
            "names": list(self.names),
            "method": summary["mean"].method,
            "statistics": rows,
        }

    def write_summary(
        self,
        path: str | Path,
        levels: Sequence[float] = LEVELS,
        interval: float = 0.95,
        thresholds: Sequence[float] = (),
    ) -> Path:
        """The summary in a file: .json, or .csv for its rows alone. ValueError for another ending;
        files.NotWritten.
        """
        path = file_of("path", path, ".json", ".csv")
        folder(path.parent)
        write_found(path, self.summary(levels, interval, thresholds))
        return path


class Tables(Summary):
    """Tables of `Samples`: a base class of these."""

    def to_pandas(self: Any) -> Any:
        """A pandas.DataFrame, a row for each sample: theta by name, y or y[...], status and
        replicate (extra `uq`).
        """
        pandas = _imported("pandas")
        _apart(self, _labels(self.y.shape[1:]))
        y = self.y.reshape(len(self), -1)
        return pandas.DataFrame(
            {
                **dict(zip(self.names, self.theta.numpy().T, strict=True)),
                **dict(zip(_labels(self.y.shape[1:]), y.numpy().T, strict=True)),
                "status": self.status.numpy(),
                "replicate": self.replicate.numpy(),
            }
        )

    def to_xarray(
        self: Any, dims: Sequence[str] | None = None, coords: dict[str, Any] | None = None
    ) -> Any:
        """An xarray.Dataset: theta's columns by name, y, status and replicate over `sample`
        (extra `uq`).

        dims    names of y's further axes, such as ("time",); None: axis_1, axis_2 ...
        coords  of these, such as {"time": t}
        """
        xarray = _imported("xarray")
        _apart(self, ["y"])
        dims = tuple(f"axis_{k}" for k in range(1, self.y.ndim)) if dims is None else dims
        names = (
            isinstance(dims, Sequence)
            and not isinstance(dims, str)
            and all(isinstance(name, str) for name in dims)
        )
        if not names or len(dims) != self.y.ndim - 1 or len({"sample", *dims}) <= len(dims):
            raise ValueError(
                f"dims = {shown(dims)} were given for a y {tuple(self.y.shape[1:])}; a name for "
                "each axis is wanted"
            )
        coords = {} if coords is None else coords
        taken = {*self.names, "y", "status", "replicate", "sample"}
        if not isinstance(coords, Mapping) or taken & {*coords}:
            raise ValueError(
                f"coords = {shown(coords)} were given; a dict, name -> places, of other names than "
                f"{', '.join(sorted(taken))} is wanted"
            )
        columns = {
            name: ("sample", column.numpy())
            for name, column in zip(self.names, self.theta.unbind(-1), strict=True)
        }
        coords = {
            name: value.numpy() if isinstance(value, Tensor) else value
            for name, value in coords.items()
        }
        return xarray.Dataset(
            {
                **columns,
                "y": (("sample", *dims), self.y.numpy()),
                "status": ("sample", self.status.numpy()),
                "replicate": ("sample", self.replicate.numpy()),
            },
            coords,
        )


def write_found(path: Path, summary: dict[str, Any]) -> None:
    """Write a summary: .csv for its rows alone, .json for all of it. Raises files.NotWritten."""
    if path.suffix == ".json":
        write(path, json.dumps(summary, indent=1) + "\n")
    else:
        rows = ([row[name] for name in COLUMNS] for row in summary["statistics"])
        write(path, csv_text([COLUMNS, *rows]))


def _several(name: str, values: Any) -> tuple[float, ...]:
    if (
        isinstance(values, (str, bytes, Mapping))
        or not isinstance(values, Iterable)
        or getattr(values, "ndim", 1) != 1
    ):
        raise refusal(f"{name} = {shown(values)}", "a sequence of numbers", were=True)
    return tuple(number(name, value) for value in values)


def _rows(name: str, estimate: Any, level: float) -> list[dict[str, Any]]:
    parts = [part.reshape(-1).tolist() for part in estimate]
    return [
        dict(zip(COLUMNS, (name, label, *map(_number, numbers), level), strict=True))
        for label, *numbers in zip(_labels(next(iter(estimate)).shape), *parts, strict=True)
    ]


def _number(value: float) -> float | None:
    """JSON has no infinity: a bound that is not there is None."""
    return value if math.isfinite(value) else None


def _labels(shape: torch.Size) -> list[str]:
    return [
        f"y[{', '.join(map(str, place))}]" if place else "y"
        for place in product(*map(range, shape))
    ]


def _apart(samples: Any, columns: Sequence[str]) -> None:
    """ValueError where a law has the name of another column."""
    if taken := [name for name in samples.names if name in (*columns, "status", "replicate")]:
        raise ValueError(
            f"samples of a law called {taken[0]!r} were given, as another column is; another "
            "name is wanted"
        )


def _imported(name: str) -> Any:
    try:
        return __import__(name)
    except ImportError:
        raise ImportError(f"{name} is wanted: pip install 'torchbeam[uq]'") from None
