"""All experiments of cosseratbench by torchbeam and by the suite's own solvers, in CPU seconds:
`python measure.py --out docs/results/cosseratbench`.

Rows are written as they come. An experiment and solver that are measured again take the place of
the row that is there.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from datetime import date
from pathlib import Path
from types import SimpleNamespace

os.environ.setdefault("OMP_NUM_THREADS", "1")

from cosseratbench import experiment as suite
from cosseratbench.registry import EXPERIMENTS, load_experiment, load_solver, names
from references import MORE

from torchbeam.extend.commands import (
    measured_on,
    results_folder,
    sentence,
    table,
    versions,
    write_results,
)

HEAD = ("experiment", "solver", "result", "date", "CPU s", "torchbeam's share")
OTHERS = ("cosseratbench", "pyelastica", "mujoco")


def measure(name: str, solver: str, folder: Path | None) -> dict:
    """A row; the suite measures in CPU seconds, after a short run that compiles."""
    experiment, values = load_experiment(name), {}
    result = suite.run(experiment, load_solver(solver))
    if result.trajectory is not None:
        scenario = experiment.build(**experiment.values())
        values = {k: error(scenario, result.trajectory) for k, error in MORE.get(name, {}).items()}
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            result.trajectory.save(folder / f"{name}_{solver}.npz")
    summary = result.summary()
    return {
        "experiment": name,
        "solver": solver,
        "date": date.today().isoformat(),
        "seconds": summary["wall_time"],
        "values": {**suite.finite(summary["metrics"]), **values},
        **{k: summary[k] for k in ("outcome", "failure", "missing", "n_elements", "settings")},
        "observations": summary["observations"],
    }


def cells(row: dict, rows: list[dict]) -> tuple[str, ...]:
    own = [r for r in rows if r["experiment"] == row["experiment"] and r["solver"] == "torchbeam"]
    seconds, result = row["seconds"], row["failure"] or ", ".join(row["missing"])
    if row["outcome"] == "completed":
        result = ", ".join(
            f"{name.replace('_', ' ')} {'none' if value is None else f'{value:.3g}'}"
            for name, value in row["values"].items()
        )
    share = own[0]["seconds"] / seconds if own and seconds and own[0]["seconds"] else None
    return (
        row["experiment"],
        row["solver"],
        result,
        row["date"],
        "" if seconds is None else f"{seconds:.3g}",
        "" if share is None else f"{share:.2g}",
    )


def write(out: Path, rows: list[dict]) -> str:
    heading = measured_on()
    heading["versions"] |= versions(*OTHERS)
    lines = [cells(row, rows) for row in rows]
    text = f"{table(HEAD, lines, words=4)}\n\n{sentence(heading)}"
    write_results(out, "cosseratbench", text, {**heading, "rows": rows}, HEAD, lines)
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("experiment", nargs="*", help="experiments to run (default: all)")
    parser.add_argument("--solver", action="append", help="repeatable (default: torchbeam)")
    parser.add_argument("--out", type=Path, required=True, help="folder for the table")
    parser.add_argument("--motions", type=Path, help="folder for what moved, NumPy files")
    args = parser.parse_args()
    out = results_folder(parser, args.out)
    suite.time = SimpleNamespace(perf_counter=time.process_time)
    stored = out / "cosseratbench.json"
    rows = json.loads(stored.read_text())["rows"] if stored.exists() else []
    for name in args.experiment or names(EXPERIMENTS):
        for solver in args.solver or ["torchbeam"]:
            row = measure(name, solver, args.motions)
            rows = [r for r in rows if (r["experiment"], r["solver"]) != (name, solver)]
            rows.append(row)
            rows.sort(key=lambda r: (r["experiment"], r["solver"] != "torchbeam", r["solver"]))
            text = write(out, rows)
            print(*cells(row, rows), sep="  ", flush=True)
    print(text)


if __name__ == "__main__":
    main()
