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
from references import at_rest, distance

from torchbeam.extend.commands import (
    measured_on,
    results_folder,
    sentence,
    table,
    versions,
    write_results,
)

HEAD = ("experiment", "solver", "result", "date", "CPU s", "torchbeam's share")
EXACT = "exact rods"
INSIDE = ("max_penetration", "max_rod_overlap")  # of obstacles, and of each other
OTHERS = ("cosseratbench", "pyelastica", "mujoco")


def measure(name: str, solver: str, folder: Path | None) -> dict:
    """A row; the suite measures in CPU seconds, after a short run that compiles."""
    experiment, values = load_experiment(name), {}
    result = suite.run(experiment, load_solver(solver))
    if result.trajectory is not None:
        rest = at_rest(name, experiment.build(**experiment.values()), result.n_elements)
        if rest is not None:
            values["off the exact rods, m"] = distance(rest, result.trajectory)
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


def exact(name: str) -> list[dict]:
    """A row of what the suite makes of rods as they should come to rest, where that is known."""
    experiment = load_experiment(name)
    scenario, elements = experiment.build(**experiment.values()), experiment.n_elements
    rest = at_rest(name, scenario, elements)
    if rest is None:
        return []
    metrics, observations = map(suite.finite, suite.score(experiment, scenario, rest))
    row = {"experiment": name, "solver": EXACT, "date": date.today().isoformat(), "seconds": None}
    row |= {"outcome": "completed", "n_elements": elements}
    return [{**row, "values": metrics, "observations": observations}]


def cells(row: dict, rows: list[dict]) -> tuple[str, ...]:
    own = [r for r in rows if r["experiment"] == row["experiment"] and r["solver"] == "torchbeam"]
    seconds = row["seconds"]
    if row["outcome"] != "completed":
        result = row["failure"] or ", ".join(row["missing"])
    else:
        inside = {x.removeprefix("max_"): row["observations"].get(x) for x in INSIDE}
        inside = {f"{name} in radii": depth for name, depth in inside.items() if depth}
        result = ", ".join(
            f"{name.replace('_', ' ')} {'none' if value is None else f'{value:.3g}'}"
            for name, value in {**row["values"], **inside}.items()
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
        solvers = args.solver or ["torchbeam"]
        for row in (*(measure(name, x, args.motions) for x in solvers), *exact(name)):
            rows = [r for r in rows if (r["experiment"], r["solver"]) != (name, row["solver"])]
            rows.append(row)
            rows.sort(key=lambda r: (r["experiment"], r["solver"] != "torchbeam", r["solver"]))
            text = write(out, rows)
            print(*cells(row, rows), sep="  ", flush=True)
    print(text)


if __name__ == "__main__":
    main()
