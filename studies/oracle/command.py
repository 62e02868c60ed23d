"""python -m studies oracle: random rods by the library and by the oracle, and a table of what
they differ by.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict, fields

from torchbeam.core.command_line import threads
from torchbeam.core.results import measured_on, sentence, write
from torchbeam.core.results import table as markdown_table

from ..command import study
from .comparison import NETS, Comparison, compare
from .statics import NotFound

ABOUT = (
    "Random rods (straight, arc, helix, pretwisted; sections coupled, offset, turned, tapered or "
    "rigid in some strains; clamped, elastically clamped, hinged, pinned, on slides, supports "
    "displaced and turned; in planes and in space; at rest and in a frame that turns) under "
    "effects of every kind. `statics`: the Cosserat equations as a boundary value problem. "
    "`vibrations`: their linearisation by collocation. `motion`: balances of momentum, angular "
    "momentum and energy. Error: of what the library's answers on three meshes tend to, over the "
    "size of the quantity; accepted is what the last refinement changed it by, and the accuracy "
    "of the oracle."
)
QUICK = 2  # cases


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seed", type=int, default=0, help="of the random cases (default: %(default)s)"
    )
    parser.add_argument(
        "--cases", type=int, default=20, help="how many of each net (default: %(default)s)"
    )
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first case (default: %(default)s)"
    )
    parser.add_argument(
        "--net",
        choices=(*NETS, "all"),
        default="all",
        help="which comparison (default: %(default)s)",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Random rods against an independent reference: statics, vibrations, balances of motion; 0 if
    all agree.
    """
    given, out = study(
        argv,
        "oracle",
        "Random rods by the library and by a dense reference that shares no line with it.",
        quick=f"{QUICK} cases of each net",
        more=_options,
    )
    try:
        import scipy  # noqa: F401
    except ImportError:
        print(
            "python -m studies oracle: error: scipy is missing; the extra `control` brings it",
            file=sys.stderr,
        )
        return 2
    rows: list[Comparison] = []
    failed, seconds = [], {}
    numbers = range(given.first, given.first + (QUICK if given.quick else given.cases))
    with threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of equilibria that are not stable
        for net in NETS if given.net == "all" else (given.net,):
            start = time.perf_counter()
            for number in numbers:
                try:
                    rows += (new := compare(net, given.seed, number))
                    bad = [
                        f"{r.quantity} {r.error:.1e} > {r.tolerance:.1e}" for r in new if not r.ok
                    ]
                    print(
                        net,
                        number,
                        new[0].about if new else "",
                        "; ".join(bad) or "ok",
                        file=sys.stderr,
                    )
                except (NotFound, RuntimeError, ValueError, MemoryError) as error:
                    failed.append((net, str(number), f"{type(error).__name__}: {error}"))
                    print(net, number, *failed[-1][2:], file=sys.stderr)
            seconds[net] = time.perf_counter() - start
        heading = measured_on()
    none = [markdown_table(("net", "case", "no answer"), failed)] if failed else []
    text = "\n\n".join((ABOUT, markdown(rows, seconds), *none, sentence(heading)))
    print(text)
    write(
        out,
        "oracle",
        text,
        {
            **heading,
            "seconds": seconds,
            "rows": [{**asdict(r), "ok": r.ok} for r in rows],
            "failed": failed,
        },
        [*(f.name for f in fields(Comparison)), "ok"],
        ((*asdict(r).values(), r.ok) for r in rows),
    )
    return 0 if all(r.ok for r in rows) and not failed else 1


def markdown(rows: Sequence[Comparison], seconds: dict[str, float]) -> str:
    """The table by quantity, and what disagrees."""
    lines = []
    for net, spent in seconds.items():
        own = [r for r in rows if r.net == net]
        for quantity in dict.fromkeys(r.quantity for r in own):
            some = [r for r in own if r.quantity == quantity]
            errors = sorted(r.error for r in some)
            lines.append(
                (
                    net,
                    quantity,
                    f"{sum(r.ok for r in some)} of {len(some)}",
                    f"{errors[len(errors) // 2]:.1e}",
                    f"{errors[-1]:.1e}",
                    f"{max(r.tolerance for r in some):.1e}",
                    f"{spent:.0f}",
                )
            )
    head = (
        "net",
        "quantity",
        "agree",
        "error: median",
        "largest",
        "accepted at most",
        "s of the net",
    )
    wrong = [
        (r.net, str(r.case), r.about, r.quantity, f"{r.error:.1e}", f"{r.tolerance:.1e}")
        for r in rows
        if not r.ok
    ]
    table = markdown_table(head, lines, words=2)
    if not wrong:
        return table
    return (
        table
        + "\n\n"
        + markdown_table(("net", "case", "of", "quantity", "error", "accepted"), wrong, words=4)
    )
