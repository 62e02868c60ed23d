"""What examples with measurements read and end with: a CSV of numbers, and one line of JSON."""

import json
import re
from collections.abc import Iterable
from pathlib import Path

import torch
from torch import Tensor

import torchbeam as tb

CHANNEL = r" of '[^']*'( and \d+ more channels?)?| \(.*"


def columns(path: Path) -> tuple[list[str], Tensor]:
    """Names and rows (rows, columns) of a file."""
    with path.open() as file:
        names = file.readline().strip().split(",")
        rows = [[float(x) for x in row.split(",")] for row in file]
    return names, torch.tensor(rows, dtype=torch.float64)


def rms(off: Tensor) -> Tensor:
    """(markers,) of the distances of off (times or poses, markers, 3)."""
    return off.square().sum(-1).mean(0).sqrt()


def line(
    fit: tb.Fit, names: Iterable[str], rms: Tensor, coverage: float, seconds: float, **more: float
) -> str:
    """JSON of the parameters `names` with their 95 % intervals, RMS (markers,) m of what was held
    out, the share of its readings that the 95 % bands hold, how long it took, doubts, and more.
    """
    ends = fit.interval(0.95).tolist()
    parameters = {
        name: [float(f"{x:.6g}") for x in (value, *ends[k])]
        for k, (name, value) in enumerate(zip(fit.names, fit.theta.tolist(), strict=True))
        if name.split("[")[0] in names
    }
    return json.dumps(
        {
            "parameters": parameters,
            "rms_mm": [round(1e3 * x, 2) for x in rms.tolist()],
            "coverage": round(coverage, 3),
            "seconds": round(seconds, 1),
            "doubts": [re.sub(CHANNEL, "", doubt.partition(": ")[0]) for doubt in fit.doubts],
            **more,
        }
    )
