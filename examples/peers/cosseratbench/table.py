"""The results of `cosseratbench run` as a table: `python table.py results > table.md`."""

import json
import sys
from pathlib import Path

SKIPPED = "settling_residual"  # of what came to rest


def cell(result: dict) -> str:
    """What came out, and the wall time, s."""
    if result["outcome"] != "completed":
        return result["outcome"]
    values = {k: v for k, v in result["metrics"].items() if k != SKIPPED}
    numbers = ", ".join(f"{k} {'none' if v is None else f'{v:.2g}'}" for k, v in values.items())
    return f"{numbers.replace('_', ' ')} ({result['wall_time']:.2g} s)"


def table(folder: Path) -> str:
    """Experiments down, solvers across, of the ordinary variant of each."""
    found = {}
    for path in sorted(folder.glob("*/default/*/result.json")):
        result = json.loads(path.read_text())
        found[result["experiment"], result["solver"]] = cell(result)
    solvers = sorted({solver for _, solver in found}, key=lambda name: (name != "torchbeam", name))
    rows = [["experiment", *solvers], ["---"] * (1 + len(solvers))]
    for experiment in sorted({experiment for experiment, _ in found}):
        rows.append([experiment, *(found.get((experiment, s), "not run") for s in solvers)])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


if __name__ == "__main__":
    print(table(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))
