"""Other programs, by the scripts of a folder: each prints what it has measured, one JSON object a
line. `python -m studies peers`: all of them beside torchbeam, in one run.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress, timed
from torchbeam.extend.commands import table, versions

from .common_case import SPACES, Case
from .harness import Options, Report, Study

BATCH = 256
# elements, steps in the 2 s, element, method: the cheapest here within errors from 2.5 to 0.15 %
SETTINGS = (
    (4, 40, "linked", "midpoint4"),
    (6, 100, "linked", "midpoint4"),
    (16, 600, "linear", "midpoint"),
    (16, 400, "linked", "midpoint4"),
    (8, 400, "order 2", "midpoint4"),
)


def scripts(folder: Path) -> list[Path]:
    """The scripts of a folder; ValueError where there are none."""
    paths = [path for path in sorted(folder.glob("*.py")) if "__main__" in path.read_text()]
    if not paths:
        raise ValueError(
            f"the folder {str(folder)!r} was given; one with scripts, as examples/peers is, is "
            "wanted"
        )
    return paths


def measured(folder: Path, python: str, *options: str) -> Iterator[dict[str, Any]]:
    """What the scripts of a folder print, each by `python` with --json and the options, and on one
    thread; those of packages that are not installed are left out, and named. Raises ValueError for
    a folder without scripts.
    """
    for path in scripts(folder):
        yield from printed(path, python, *options)


def printed(path: Path, python: str, *options: str) -> list[dict[str, Any]]:
    """What one script prints, see `measured`; none where it stops, and why in the terminal."""
    done = subprocess.run(
        [python, str(path), "--json", *options],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    if done.returncode:
        why = done.stderr.strip().splitlines()
        progress(f"{path.name} is left out: {why[-1] if why else f'exit status {done.returncode}'}")
        return []
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def _folder(given: str) -> Path:
    try:
        scripts(Path(given))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(given)


def _interpreter(given: str) -> str:
    if shutil.which(given) is None:
        raise argparse.ArgumentTypeError(f"{given!r} was given; a Python interpreter is wanted")
    return given


# of commands that run the scripts of other programs
OPTIONS: Options = {
    "--peers": dict(
        type=_folder,
        metavar="FOLDER",
        help="also run the scripts of a folder that measure other programs: examples/peers",
    ),
    "--python": dict(
        type=_interpreter,
        default=sys.executable,
        help="the interpreter for these (default: this one)",
    ),
}
ABOUT = (
    "The common dynamic case by other programs, each beside the fastest setting here of no larger "
    "error, measured right behind it; rates of batches are those of all beams."
)


def study(options: Namespace) -> Iterator[Report]:
    rows = options.stored.get("rows", [])
    for path in scripts(options.peers or Path("examples/peers")):
        if any(row["script"] == path.stem for row in rows):
            continue
        progress(path.stem)
        found = printed(path, options.python, "--beside", *["--ladder"] * (not options.quick))
        if found:
            found += own(SETTINGS[:2] if options.quick else SETTINGS)
            rows += [{"script": path.stem, **row} for row in found]
            yield Report([ABOUT, beside(rows)], rows)


def own(settings: Sequence[tuple[int, int, str, str]], repeats: int = 3) -> Iterator[dict]:
    """Rows of torchbeam, as the scripts have them: single beams in space and in the plane, and a
    batch in space.
    """
    case, name = Case.load(), f"torchbeam {versions('torchbeam')['torchbeam']}"
    for space, batch in (("3D", 1), ("plane", 1), ("3D", BATCH)):
        for elements, steps, element, method in settings:
            every = max(1, 200 // steps)
            t = case.t[: 200 - 200 % every + 1 : every]
            force = torch.tensor((0.0, 1.0, 0.0), dtype=case.t.dtype).expand(batch, 3)
            scene = case.scene(elements, SPACES[space], force=force, element=element)

            def run(scene: tb.Scene = scene, t: Tensor = t, steps: int = steps, by: str = method):
                with torch.no_grad():
                    solution = tb.simulate(scene, t, step=2 / steps, method=by)
                    assert solution.tip.position.isfinite().all()
                    return solution

            error = case.error(run())
            (times,) = timed([run], repeats)
            best = min(times.cpu)
            yield dict(
                peer=name, space=space, elements=elements, element=f"{element}, {method}",
                step_ms=2000 / steps, error=error, best_cpu_s=best,
                median_cpu_s=median(times.cpu), rate=batch * t[-1].item() / best, batch=batch,
            )  # fmt: skip


def beside(rows: list[dict[str, Any]]) -> str:
    """A table: each row of a program beside the fastest of torchbeam in its own block, with as
    many dimensions and no larger error, alone or in a batch.
    """
    lines = []
    for row in sorted(rows, key=lambda r: (r["script"], r["batch"], -r["error"])):
        if row["peer"].startswith("torchbeam"):
            continue
        rivals = [
            r for r in rows
            if r["script"] == row["script"] and r["peer"].startswith("torchbeam")
            and r["space"] == row["space"] and (r["batch"] > 1) == (row["batch"] > 1)
            and r["error"] <= row["error"]
        ]  # fmt: skip
        best = max(rivals, key=lambda r: r["rate"], default=None)
        lines.append(
            (
                f"{row['peer']}, {row['space']}", str(row["batch"]),
                f"{row['elements']}, {row['element']}",
                f"{row['step_ms']:.3g}", f"{100 * row['error']:.2g} %", _rate(row),
                *(("", "", "") if best is None else (
                    f"{best['element']}, {best['elements']}, {best['step_ms']:.3g} ms",
                    f"{100 * best['error']:.2g} %", _rate(best),
                )),
            )
        )  # fmt: skip
    head = (
        "program | batch | elements | step, ms | error | simulated s a CPU s | "
        "here: element, elements, step | error | simulated s a CPU s"
    )
    return table(head, lines, 1)


def _rate(row: dict[str, Any]) -> str:
    return f"{float(format(row['rate'], '.3g')):,g}"


main = Study(
    "peers",
    "Time the common dynamic case by other programs, beside ours.",
    "The common dynamic case by other programs, each at several settings, alone and, where it has "
    "batches of its own, in one; torchbeam is measured again behind each.",
    study,
    quick="the first setting of each alone",
    resume="keep what the folder has of scripts, and go on",
    options=OPTIONS,
)
