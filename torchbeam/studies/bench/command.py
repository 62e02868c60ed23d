"""python -m torchbeam bench: the compiled engine in numbers, and its operation counts against
stored ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import torch

from ...cli import results_folder, threads
from ...core.results import measured_on, sentence, versions, write
from ...engine.chain.coverage import MISSING
from ...plot.canvas import where_installed
from .. import peers
from . import (
    breakdown,
    calls,
    first_use,
    gradients,
    growth,
    loads,
    operations,
    others,
    structures,
    throughput,
)
from .measurement import Measured, progress
from .report import markdown, picture

PARTS: dict[str, Callable[[bool], Iterator[Measured]]] = {
    "throughput": throughput.rows,
    "gradients": gradients.rows,
    "calls": calls.rows,
    "structures": structures.rows,
    "environments": others.found,
    "first-use": first_use.rows,
    "breakdown": breakdown.rows,
    "growth": growth.rows,
    "operations": operations.rows,
}
ABOUT = (
    "The compiled engine in numbers, float64: simulated seconds a second of the common dynamic "
    "case beside the eager engine, with the error of each setting; gradients over their forward, "
    "and memory; structures beside one beam; environments; compile times; the parts of a step; "
    "growth with elements, batch and steps; operation counts. Writes bench.csv, bench.md and "
    "bench.json (with machine and versions), and with matplotlib bench.png. About five minutes "
    "on an idle machine."
)

QUICK = "Quick run: few sizes and repeats, short pieces of the case."


def main(argv: Sequence[str] | None = None) -> int:
    """Speed of the compiled engine: throughput, gradients, environments, compile times, growth,
    operation counts.
    """
    parser = argparse.ArgumentParser(prog="python -m torchbeam bench", description=ABOUT)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/bench"),
        help="folder for the results (default: %(default)s)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer sizes and repeats: half a minute"
    )
    parser.add_argument(
        "--parts",
        nargs="+",
        choices=PARTS,
        default=list(PARTS),
        help="what is measured (default: all)",
    )
    peers.options(parser)
    parser.add_argument(
        "--loads",
        type=Path,
        metavar="FILE",
        help="only the loads that a Python file makes, LOADS = {name: function}: the engine of "
        "each, native steps beside eager ones; writes loads.csv, loads.md and loads.json",
    )
    parser.add_argument(
        "--operations",
        type=Path,
        metavar="FILE",
        help="only compare operation counts with those of a file: status 1 where one has grown by "
        f"more than {100 * operations.GROWTH:.0f} %%",
    )
    parser.add_argument("--update", action="store_true", help="write the file of --operations anew")
    given = parser.parse_args(argv)
    if given.update and not given.operations:
        parser.error("--update was given without --operations FILE, the file to write")
    if find_spec("llvmlite") is None:
        parser.error(MISSING)
    if given.operations:
        return _compare(given.operations, given.update, parser)
    out = results_folder(parser, given.out)
    if given.loads:
        return _loads(given.loads, out, parser)
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        with threads(1):
            rows = list(_rows(given))
            heading = measured_on()
    finally:
        torch.set_default_dtype(dtype)
    heading["versions"] |= versions("llvmlite")
    text = "\n\n".join((markdown(rows), *[QUICK] * given.quick, sentence(heading)))
    print(text)
    write(
        out,
        "bench",
        text,
        {**heading, "quick": given.quick, "rows": [row._asdict() for row in rows]},
        Measured._fields,
        rows,
    )
    with where_installed():
        picture(rows, out / "bench.png")
    return 0


def _loads(path: Path, out: Path, parser: argparse.ArgumentParser) -> int:
    """Engines and times of the loads of a file."""
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        with threads(1):
            measured, heading = list(loads.rows(path)), measured_on()
    except ValueError as error:
        parser.error(str(error))
    finally:
        torch.set_default_dtype(dtype)
    heading["versions"] |= versions("llvmlite")
    text = "\n\n".join((loads.markdown(measured), sentence(heading)))
    print(text)
    write(
        out,
        "loads",
        text,
        {**heading, "rows": [row._asdict() for row in measured]},
        loads.LoadRow._fields,
        measured,
    )
    return 0


def _rows(given: argparse.Namespace) -> Iterator[Measured]:
    """Rows of the parts that are asked for, the peers right behind what they are compared with."""
    for name in given.parts:
        progress(f"{name} ...")
        yield from PARTS[name](given.quick)
        if name == "throughput" and given.peers is not None:
            yield from others.peers(given.peers, given.python, given.quick)


def _compare(path: Path, update: bool, parser: argparse.ArgumentParser) -> int:
    """Operation counts now against those of a file."""
    counts = operations.counts()
    if update:
        operations.store(path, counts)
        print(f"{len(counts)} counts written to {path}")
        return 0
    try:
        said = operations.grown(counts, operations.stored(path))
    except ValueError as error:
        parser.error(f"--operations: {error}")
    for line in said:
        print(line)
    print(
        f"{len(counts)} counts, {len(said)} of them worse than stored or not in both: "
        f"`python -m torchbeam bench --operations {path} --update` stores those of now"
        if said
        else f"{len(counts)} counts, none has grown by more than {operations.GROWTH:.0%}"
    )
    return int(bool(said))
