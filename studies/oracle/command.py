"""python -m studies oracle: random rods by the library and by the oracle, and a table of what
they differ by.
"""

from __future__ import annotations

import time
import warnings
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import fields
from importlib.util import find_spec

from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table

from ..harness import Report, Study
from .comparison import NETS, Comparison, compare
from .statics import NotFound

ABOUT = (
    "Random rods (straight, arc, helix, pretwisted; sections coupled, offset, turned, tapered or "
    "rigid in some strains; clamped, elastically clamped, hinged, pinned, on slides, supports "
    "displaced and turned; in planes and in space; at rest and in a frame that turns) under "
    "effects of every kind. `statics`: the Cosserat equations as a boundary value problem. "
    "`vibrations`: their linearisation by collocation. `motion`: balances of momentum, angular "
    "momentum and energy. `hinges`: wheels on hinges that yield or have hysteresis, "
    "by their differential equations. Error: of what the library's answers on three "
    "meshes tend to, over the "
    "size of the quantity; accepted is what the last refinement changed it by, and the accuracy "
    "of the oracle."
)
QUICK = 2  # cases
ALL = (*NETS, "hinges")


def study(options: Namespace) -> Report:
    rows: list[Comparison] = []
    failed, seconds = [], {}
    numbers = range(options.first, options.first + (QUICK if options.quick else options.cases))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of equilibria that are not stable
        for net in ALL if options.net == "all" else (options.net,):
            start = time.perf_counter()
            for number in numbers:
                try:
                    rows += (new := compare(net, options.seed, number))
                    bad = (
                        f"{r.quantity} {r.error:.1e} > {r.tolerance:.1e}" for r in new if not r.ok
                    )
                    about = new[0].about if new else ""
                    progress(f"{net} {number} {about} {'; '.join(bad) or 'ok'}")
                except (NotFound, RuntimeError, ValueError, MemoryError) as error:
                    failed.append((net, str(number), f"{type(error).__name__}: {error}"))
                    progress(" ".join(failed[-1]))
            seconds[net] = time.perf_counter() - start
    none = [table("net | case | no answer", failed)] if failed else []
    return Report(
        [ABOUT, markdown(rows, seconds), *none],
        rows,
        {"seconds": seconds, "failed": failed},
        columns=[*(f.name for f in fields(Comparison)), "ok"],
        status=int(bool(failed) or not all(r.ok for r in rows)),
    )


def markdown(rows: Sequence[Comparison], seconds: dict[str, float]) -> str:
    """The table by quantity, and what disagrees."""
    lines = []
    for net, spent in seconds.items():
        own = [r for r in rows if r.net == net]
        for quantity in dict.fromkeys(r.quantity for r in own):
            some = [r for r in own if r.quantity == quantity]
            errors = sorted(r.error for r in some)
            lines.append(
                f"{net} | {quantity} | {sum(r.ok for r in some)} of {len(some)} | "
                f"{errors[len(errors) // 2]:.1e} | {errors[-1]:.1e} | "
                f"{max(r.tolerance for r in some):.1e} | {spent:.0f}"
            )
    head = "net | quantity | agree | error: median | largest | accepted at most | s of the net"
    wrong = [
        f"{r.net} | {r.case} | {r.about} | {r.quantity} | {r.error:.1e} | {r.tolerance:.1e}"
        for r in rows
        if not r.ok
    ]
    tables = [table(head, lines, words=2)]
    if wrong:
        tables.append(table("net | case | of | quantity | error | accepted", wrong, words=4))
    return "\n\n".join(tables)


def _number(default: int, said: str) -> dict[str, object]:
    return dict(type=int, default=default, help=f"{said} (default: %(default)s)")


main = Study(
    "oracle",
    "Random rods against an independent reference: statics, vibrations, balances of motion; 0 if "
    "all agree.",
    "Random rods by the library and by a dense reference that shares no line with it.",
    study,
    quick=f"{QUICK} cases of each net",
    options={
        "--seed": _number(0, "of the random cases"),
        "--cases": _number(20, "how many of each net"),
        "--first": _number(0, "number of the first case"),
        "--net": dict(
            choices=(*ALL, "all"), default="all", help="which comparison (default: %(default)s)"
        ),
    },
    check=lambda options: (
        None if find_spec("scipy") else "scipy is missing; the extra `control` brings it"
    ),
)
