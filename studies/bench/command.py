"""python -m studies bench: the compiled engine in numbers, and its operation counts against
stored ones.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from torchbeam.core.measurement import Measured, progress
from torchbeam.engine.chain.coverage import MISSING

from .. import peers
from ..harness import Refused, Report, Study
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
    "throughput": throughput.rows, "gradients": gradients.rows, "calls": calls.rows,
    "structures": structures.rows, "contact": contact.rows, "mechanisms": mechanisms.rows,
    "environments": others.measurements, "first-use": first_use.rows, "breakdown": breakdown.rows,
    "growth": growth.rows, "operations": operations.rows,
}  # fmt: skip
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
    "counts; with matplotlib bench.png. About five minutes on an idle machine."
)
NAMED = " or ".join(f"--{name}" for name in GUARDS)
QUICK = "Quick run: few sizes and repeats, short pieces of the case."


def study(options: Namespace) -> Report | int:
    if guarded := _guarded(options):
        return max(_compare(name, path, options.update) for name, path in guarded.items())
    if options.loads:
        measured = list(loads.rows(options.loads))
        return Report([loads.markdown(measured)], measured, name="loads")
    rows = list(_rows(options))
    return Report(
        [markdown(rows), *[QUICK] * options.quick],
        rows,
        {"quick": options.quick},
        picture=lambda folder: picture(rows, folder / "bench.png"),
    )


def _guarded(options: Namespace) -> dict[str, Path]:
    return {name: path for name in GUARDS if (path := getattr(options, name))}


def _check(options: Namespace) -> str | None:
    if options.update and not _guarded(options):
        return f"--update was given without {NAMED} FILE, the file to write"
    return MISSING if find_spec("llvmlite") is None else None


def _rows(given: Namespace) -> Iterator[Measured]:
    """Rows of the parts that are asked for, the peers right behind what they are compared with."""
    for name in given.parts:
        progress(f"{name} ...")
        yield from PARTS[name](given.quick)
        if name in PEERS and given.peers is not None:
            yield from PEERS[name](given.peers, given.python, given.quick)


def _compare(name: str, path: Path, update: bool) -> int:
    """Numbers now against those of a file."""
    what, unit, measure = GUARDS[name]
    now = measure()
    if update:
        store(path, now)
        print(f"{len(now)} {what} written to {path}")
        return 0
    try:
        said = grown(now, stored(path, what), unit)
    except ValueError as error:
        raise Refused(f"--{name}: {error}") from None
    for line in said:
        print(line)
    print(
        f"{len(now)} {what}, {len(said)} of them worse than stored or not in both: "
        f"`python -m studies bench --{name} {path} --update` stores those of now"
        if said
        else f"{len(now)} {what}, none has grown by more than {GROWTH:.0%}"
    )
    return int(bool(said))


main = Study(
    "bench",
    "Speed of the compiled engine: throughput, gradients, environments, compile times, growth, "
    "operation counts.",
    ABOUT,
    study,
    quick="fewer sizes and repeats: half a minute",
    options={
        "--parts": dict(
            nargs="+", choices=PARTS, default=list(PARTS), help="what is measured (default: all)"
        ),
        **peers.OPTIONS,
        "--loads": dict(
            type=Path,
            metavar="FILE",
            help="only the loads that a Python file makes, LOADS = {name: function}: the engine of "
            "each, native steps beside eager ones; writes loads.csv, loads.md and loads.json",
        ),
        **{
            f"--{name}": dict(
                type=Path,
                metavar="FILE",
                help=f"only compare {what} with those of a file: status 1 where one has grown by "
                f"more than {100 * GROWTH:.0f} %%",
            )
            for name, (what, *_) in GUARDS.items()
        },
        "--update": dict(action="store_true", help=f"write the file of {NAMED} anew"),
    },
    check=_check,
    place=lambda options: (None if _guarded(options) else options.out, "--out"),
    double=True,
    packages=("llvmlite",),
)
