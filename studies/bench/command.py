"""python -m studies bench: the compiled engine in numbers, and its operation counts against
stored ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from torchbeam.core.command_line import results_folder, threads
from torchbeam.core.measurement import Measured, progress
from torchbeam.core.results import measured_on, sentence, versions, write
from torchbeam.engine.chain.coverage import MISSING
from torchbeam.plot.canvas import where_installed

from .. import peers
from ..command import double_precision
from . import (
    breakdown,
    calls,
    contact,
    errors,
    first_use,
    gradients,
    growth,
    loads,
    mechanisms,
    operations,
    others,
    structures,
    throughput,
)
from .report import markdown, picture
from .stored import GROWTH, grown, store, stored

PARTS: dict[str, Callable[[bool], Iterator[Measured]]] = {
    "throughput": throughput.rows,
    "gradients": gradients.rows,
    "calls": calls.rows,
    "structures": structures.rows,
    "contact": contact.rows,
    "mechanisms": mechanisms.rows,
    "environments": others.measurements,
    "first-use": first_use.rows,
    "breakdown": breakdown.rows,
    "growth": growth.rows,
    "operations": operations.rows,
}
# parts that other programs have rows of
PEERS = {"throughput": others.peers, "mechanisms": mechanisms.peers}
# option: what its file holds, the unit, and those of now
GUARDS: dict[str, tuple[str, str, Callable[[], dict[str, Any]]]] = {
    "operations": ("operation counts", "operations", lambda: operations.counts()),
    "errors": ("errors of fixed settings", "relative", lambda: errors.errors()),
}
ABOUT = (
    "The compiled engine in numbers, float64: simulated seconds a second of the common dynamic "
    "case beside the eager engine, with the error of each setting; gradients over their forward, "
    "and memory; structures beside one beam; a linkage and a hand; contact; environments; "
    "compile times; the parts of a step; growth with elements, batch and steps; operation "
    "counts. Writes bench.csv, bench.md and bench.json (with machine and versions), and with "
    "matplotlib bench.png. About five minutes on an idle machine."
)

QUICK = "Quick run: few sizes and repeats, short pieces of the case."


def main(argv: Sequence[str] | None = None) -> int:
    """Speed of the compiled engine: throughput, gradients, environments, compile times, growth,
    operation counts.
    """
    parser = argparse.ArgumentParser(prog="python -m studies bench", description=ABOUT)
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
    for name, (what, *_) in GUARDS.items():
        parser.add_argument(
            f"--{name}",
            type=Path,
            metavar="FILE",
            help=f"only compare {what} with those of a file: status 1 where one has grown by more "
            f"than {100 * GROWTH:.0f} %%",
        )
    options = " or ".join(f"--{name}" for name in GUARDS)
    parser.add_argument("--update", action="store_true", help=f"write the file of {options} anew")
    given = parser.parse_args(argv)
    guarded = {name: path for name in GUARDS if (path := getattr(given, name))}
    if given.update and not guarded:
        parser.error(f"--update was given without {options} FILE, the file to write")
    if find_spec("llvmlite") is None:
        parser.error(MISSING)
    if guarded:
        return max(_compare(name, path, given.update, parser) for name, path in guarded.items())
    out = results_folder(parser, given.out)
    if given.loads:
        return _loads(given.loads, out, parser)
    with double_precision(), threads(1):
        rows, heading = list(_rows(given)), measured_on()
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
    try:
        with double_precision(), threads(1):
            measured, heading = list(loads.rows(path)), measured_on()
    except ValueError as error:
        parser.error(str(error))
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
        if name in PEERS and given.peers is not None:
            yield from PEERS[name](given.peers, given.python, given.quick)


def _compare(name: str, path: Path, update: bool, parser: argparse.ArgumentParser) -> int:
    """Numbers now against those of a file."""
    what, unit, measure = GUARDS[name]
    with double_precision():
        now = measure()
    if update:
        store(path, now)
        print(f"{len(now)} {what} written to {path}")
        return 0
    try:
        said = grown(now, stored(path, what), unit)
    except ValueError as error:
        parser.error(f"--{name}: {error}")
    for line in said:
        print(line)
    print(
        f"{len(now)} {what}, {len(said)} of them worse than stored or not in both: "
        f"`python -m studies bench --{name} {path} --update` stores those of now"
        if said
        else f"{len(now)} {what}, none has grown by more than {GROWTH:.0%}"
    )
    return int(bool(said))
