"""The fit of the silicone cantilever as it is done without this library's search: SciPy's least
squares around a simulation that is a black box to it, beside `tb.identify`, in time and answer.

    python -m examples.measurements.silicone_by_scipy --data silicone_beam_load52_a.csv
        [--out docs/results/measurements]

Both have the same model, of one record, the same readings, priors and start. To SciPy they are a
function of 22 numbers (the offsets are nine of them, which `tb.identify` finds without evaluations)
that returns residuals, those of the priors last; derivatives are its forward differences, one
simulation each, which `tb.identify` has in one batch. SciPy's deviations are those of independent
noise of the size that the misfit has, as its users state them. Times are seconds of the processor,
after one evaluation of each that compiles.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import least_squares

import torchbeam as tb
from torchbeam.extend.commands import measured_on, sentence

from .silicone_beam import FITTED, SIGMA, Record, start

SHOWN = ("E", "power", "creep")


class BlackBox:
    """Residuals of a record as a function of numbers: logarithms, where a parameter is positive."""

    def __init__(self, record: Record) -> None:
        self.model, self.measurements = record.model(FITTED), record.measurements(FITTED)
        self.parameters, self.calls = start(False), 0
        self.sizes = [max(p.start.numel(), 1) for p in self.parameters.values()]
        self.offsets = self.measurements[0].values.new_zeros(3, 3)

    def first(self) -> np.ndarray:
        values = [
            (p.start.log() if p.transform == "log" else p.start).reshape(-1)
            for p in self.parameters.values()
        ]
        return torch.cat([*values, self.offsets.flatten()]).double().numpy()

    def scale(self) -> np.ndarray:
        """What each number is about known to before: how far SciPy's first steps go."""
        scales = [
            torch.full((size,), 0.3) if p.transform == "log" else p.prior.stddev.reshape(-1)
            for size, p in zip(self.sizes, self.parameters.values(), strict=True)
        ]
        return torch.cat([*scales, torch.full((9,), 1e-2)]).double().numpy()

    def theta(self, x: np.ndarray) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        *parts, offsets = torch.as_tensor(x).split([*self.sizes, 9])
        theta = {}
        for (name, p), part in zip(self.parameters.items(), parts, strict=True):
            value = part.exp() if p.transform == "log" else part
            theta[name] = value.reshape(1, *p.start.shape)
        return theta, offsets.reshape(3, 3)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        self.calls += 1
        theta, offsets = self.theta(x)
        motion = self.model(theta)
        rows = []
        for m, offset in zip(self.measurements, offsets, strict=True):
            rows.append(((m.read(motion, theta)[0] + offset - m.values) / SIGMA).flatten())
        for name, p in self.parameters.items():
            if p.prior is not None:
                value = theta[name][0].log() if p.transform == "log" else theta[name][0]
                prior = p.prior.base_dist if p.transform == "log" else p.prior
                rows.append(((value - prior.mean) / prior.stddev).reshape(-1))
        return torch.cat(rows).numpy()


def by_scipy(record: Record) -> dict:
    box = BlackBox(record)
    box(box.first())
    box.calls, begun = 0, time.process_time()
    found = least_squares(box, box.first(), x_scale=box.scale(), ftol=1e-6, xtol=1e-6)
    seconds = time.process_time() - begun
    J = found.jac
    noise = 2 * found.cost / (len(found.fun) - len(found.x))
    deviation = np.sqrt(np.diag(noise * np.linalg.inv(J.T @ J)))
    names = list(box.parameters)
    rows = {}
    for name in SHOWN:
        k, log = names.index(name), box.parameters[name].transform == "log"
        k = sum(box.sizes[:k])
        ends = found.x[k] + 1.96 * deviation[k] * np.array([0, -1, 1])
        rows[name] = [float(f"{v:.6g}") for v in (np.exp(ends) if log else ends)]
    residual = found.fun[: sum(m.values.numel() for m in box.measurements)]
    return dict(parameters=rows, misfit=rms(residual), simulations=box.calls, seconds=seconds)


def by_identify(record: Record) -> dict:
    model, calls = record.model(FITTED), []

    def counted(theta: dict[str, torch.Tensor]) -> tb.Solution:
        calls.append(len(theta["E"]))
        return model(theta)

    counted({name: p.start[None] for name, p in start(False).items()})
    calls.clear()
    begun = time.process_time()
    fit = tb.identify(
        {record.name: counted},
        {record.name: record.measurements(FITTED)},
        start(False),
        derivatives="difference",
        tolerance=1e-3,
    )
    seconds = time.process_time() - begun
    ends = fit.interval_without_warning(0.95)
    rows = {
        name: [float(f"{v:.6g}") for v in (fit[name].item(), *ends[fit.names.index(name)].tolist())]
        for name in SHOWN
    }
    residual = torch.cat([((r.y - r.data) / SIGMA).flatten() for r in fit.readings]).numpy()
    return dict(
        parameters=rows, misfit=rms(residual), simulations=sum(calls), batches=len(calls),
        seconds=seconds,
    )  # fmt: skip


def rms(residual: np.ndarray) -> float:
    """mm"""
    return 1e3 * SIGMA * float(np.sqrt(np.mean(residual**2)))


def table(rows: dict[str, dict]) -> str:
    lines = [
        "| search | E kPa | power | creep | misfit mm | simulations | in calls | CPU s |",
        "|---|---|---|---|---:|---:|---:|---:|",
    ]
    for name, row in rows.items():
        (E, *ends), power, creep = (row["parameters"][key] for key in SHOWN)
        shown = [
            f"{E / 1e3:.1f} ({ends[0] / 1e3:.1f} to {ends[1] / 1e3:.1f})",
            *(f"{v[0]:.4f} ({v[1]:.4f} to {v[2]:.4f})" for v in (power, creep)),
        ]
        calls = row.get("batches", row["simulations"])
        lines.append(
            f"| {name} | {' | '.join(shown)} | {row['misfit']:.4f} | {row['simulations']} | {calls}"
            f" | {row['seconds']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> dict[str, dict]:
    """Both fits, and their table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a record")
    parser.add_argument("--out", type=Path, help="a folder for the table")
    given = parser.parse_args(arguments)
    record = Record(given.data)
    rows = {
        "`scipy.optimize.least_squares`, a black box": by_scipy(record),
        "`tb.identify`": by_identify(record),
    }
    print(table(rows))
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        heading = measured_on()
        stored = json.dumps(heading | {"data": given.data.name, "rows": rows}, indent=1)
        (given.out / "by_scipy.json").write_text(stored + "\n")
        (given.out / "by_scipy.md").write_text(f"{table(rows)}\n{sentence(heading)}\n")
    return rows


if __name__ == "__main__":
    main()
