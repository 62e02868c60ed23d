"""Report of the benchmark: its tables, and a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from torchbeam.core.measurement import CPU, WALL, Measured
from torchbeam.extend.commands import table
from torchbeam.plot.canvas import grid, save

from . import (
    breakdown,
    calls,
    contact,
    first_use,
    gradients,
    growth,
    mechanisms,
    operations,
    structures,
    throughput,
)
from .others import PEERS


def markdown(rows: Sequence[Measured]) -> str:
    """One table a part that has rows."""
    tables = ((title, make(rows)) for title, make in TABLES.items())
    return "\n\n".join(f"**{title}**\n\n{text}" for title, text in tables if text)


def _throughput(rows: Sequence[Measured]) -> str:
    rates = {
        ((r.space, r.elements, r.step_ms, r.batch, r.element), (r.engine, r.unit, r.threads)): r
        for r in rows
        if r.part == throughput.PART
    }
    ceilings = {
        (r.space, r.elements, r.step_ms, r.batch, r.element): r.best
        for r in rows
        if r.part == throughput.PART and r.what == throughput.CEILING
    }
    peers = {r.space: r for r in rows if r.part == PEERS}
    lines = []
    for case in dict.fromkeys(case for case, _ in rates):
        compiled, eager, one, two = (
            rates.get((case, how))
            for how in (
                ("compiled", CPU, 1),
                ("eager", CPU, 1),
                ("compiled", WALL, 1),
                ("compiled", WALL, 2),
            )
        )
        peer = peers.get(case[0])
        lines.append(
            (
                case[0],
                f"{case[1]}, {case[4]}",
                f"{case[2]:.3g}",
                f"{100 * compiled.error:.2f} %",
                f"{case[3]}",
                _rate(eager),
                _rate(compiled),
                "" if eager is None else f"{compiled.best / eager.best:.0f}",
                "" if two is None else f"{two.best / one.best:.2f}",
                *([f"{ceilings[case]:.2f}" if case in ceilings else ""] if ceilings else []),
                *([f"{compiled.best / peer.best:.1f}" if peer else ""] if peers else []),
            )
        )
    for r in peers.values():
        lines.append(
            (
                f"{r.engine}, {r.space}",
                f"{r.elements}, {r.element}",
                f"{r.step_ms:.3g}",
                f"{100 * r.error:.2f} %",
                "1",
                "",
                _rate(r),
                *[""] * (3 + bool(ceilings)),
            )
        )
    heads = (
        "case",
        "elements",
        "step, ms",
        "error",
        "batch",
        "eager: simulated s per CPU s",
        "compiled, or the peer",
        "over eager",
        "2 threads over 1",
        *(["2 processes over 1"] if ceilings else []),
        *(["over the peer"] if peers else []),
    )
    return _table(heads, lines, words=1)


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]], words: int) -> str:
    return table(heads, lines, words) if lines else ""


def _rate(row: Measured | None) -> str:
    """Best, and the median behind it."""
    return "" if row is None else f"{_number(row.best)} ({_number(row.median)})"


def _number(value: float) -> str:
    """Three digits, and no exponent."""
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"


def _gradients(rows: Sequence[Measured]) -> str:
    rows = [r for r in rows if r.part == gradients.PART]
    lines = [
        (_case(r), r.what, *(f"{_number(x)} {r.unit}".strip() for x in (r.best, r.median)))
        for r in rows
    ]
    return _table(("case", "", "best", "median"), lines, words=2)


def _elsewhere(rows: Sequence[Measured]) -> str:
    known = {
        throughput.PART,
        gradients.PART,
        calls.PART,
        structures.PART,
        contact.PART,
        mechanisms.PART,
        first_use.PART,
        breakdown.PART,
        growth.PART,
        operations.PART,
        PEERS,
    }
    lines = [
        (r.what, f"{r.batch}", _number(r.best), _number(r.median), r.unit)
        for r in rows
        if r.part not in known
    ]
    return _table(("environment", "batch", "best", "median", "unit"), lines, words=1)


def _pairs(part: str, head: str, unit: str) -> Callable[[Sequence[Measured]], str]:
    """A table of what was measured (rows) by case (columns)."""

    def make(rows: Sequence[Measured]) -> str:
        rows = [r for r in rows if r.part == part]
        cases = list(dict.fromkeys(_case(r) for r in rows))
        values = {(r.what, _case(r)): r.best for r in rows}
        lines = [
            (what, *(_number(values[what, c]) if (what, c) in values else "" for c in cases))
            for what in dict.fromkeys(r.what for r in rows)
        ]
        return _table((f"{head}{unit}", *cases), lines, words=1)

    return make


def _case(row: Measured) -> str:
    return row.space if row.batch is None else f"{row.space}, batch {row.batch}"


def _growth(rows: Sequence[Measured]) -> str:
    return _pairs(growth.PART, "time grows with", ", to the power")(
        [
            r._replace(what=r.what.removeprefix("exponent of "))
            for r in rows
            if r.what.startswith("exponent of ")
        ]
    )


def _operations(rows: Sequence[Measured]) -> str:
    names = {
        "element",
        "before element",
        "node",
        "row",
        "back",
        "element bar",
        "blocks",
        "law",
        "node bar",
        "block",
        "joint",
        "interface",
        "row backward",
        "row bordered",
    }
    shown = [
        r
        for r in rows
        if r.what.endswith("tensor operations")
        or r.what.partition(", ")[2].rstrip(" 0123456789") in names
    ]
    return _pairs(operations.PART, "function", ", operations")(shown)


TABLES = {
    "Throughput, one thread: best (median)": _throughput,
    "Gradients": _gradients,
    "Calls": _pairs(calls.PART, "", f"{calls.STEPS} steps, {calls.ELEMENTS} elements"),
    "Structures": _pairs(structures.PART, "", "ratio of CPU times"),
    "Contact": _pairs(contact.PART, "", "ratio of CPU times"),
    "Mechanisms: CPU ms of one simulated second within an error": lambda rows: _table(
        *mechanisms.table(rows), words=2
    ),
    "Environments": _elsewhere,
    "First use": _pairs(first_use.PART, "", "seconds"),
    "Breakdown": _pairs(breakdown.PART, "", "CPU us a step of the batch"),
    "Growth": _growth,
    "Operations": _operations,
}


def picture(rows: Sequence[Measured], path: Path) -> None:
    """Throughput by batch, shares of a step, time against size. Raises ImportError without
    matplotlib.
    """
    first, second, third = grid(1, 3, (14.0, 4.0))
    legend = dict(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    rates = [r for r in rows if r.part in (throughput.PART, PEERS) and r.unit == CPU]
    best: dict[tuple[str, str], Measured] = {}
    for r in rates:
        name = f"{r.space}, batch {r.batch}", r.engine
        best[name] = max(r, best.get(name, r), key=lambda r: r.best)
    cases = list(dict.fromkeys(name for name, _ in best))
    for engine in dict.fromkeys(engine for _, engine in best):
        given = [(cases.index(name), r.best) for (name, e), r in best.items() if e == engine]
        first.plot([value for _, value in given], [place for place, _ in given], "o", label=engine)
    first.set(
        xscale="log",
        xlabel="simulated s per CPU s, one thread",
        yticks=range(len(cases)),
        yticklabels=cases,
    )
    first.grid(True, color="0.9")
    if rates:
        first.legend(**legend)
    shares = [
        r
        for r in rows
        if r.part == breakdown.PART and (r.what == "wrapper" or r.what.startswith("native: "))
    ]
    cases, left = list(dict.fromkeys(map(_case, shares))), {}
    whole = {case: sum(r.best for r in shares if _case(r) == case) for case in cases}
    for what in dict.fromkeys(r.what for r in shares):
        widths = [
            sum(r.best for r in shares if (r.what, _case(r)) == (what, case)) / whole[case]
            for case in cases
        ]
        second.barh(cases, widths, left=[left.get(case, 0.0) for case in cases], label=what)
        left = {
            case: left.get(case, 0.0) + width for case, width in zip(cases, widths, strict=True)
        }
    second.set(xlabel="share of a step", xlim=(0, 1))
    if shares:
        second.legend(**legend)
    for r in (timed := [r for r in rows if r.part == growth.PART]):
        if r.what.startswith("exponent of "):
            what = r.what.removeprefix("exponent of ")
            line = [x for x in timed if x.space == r.space and x.what.endswith(f"by {what}")]
            sizes = [
                x.elements
                if what == "elements"
                else x.batch
                if what == "batch"
                else int(x.what.split()[0])
                for x in line
            ]
            third.loglog(
                sizes,
                [x.best for x in line],
                "o-",
                ms=3,
                label=f"{r.space}, {what}: power {r.best:.2f}",
            )
    third.set(xlabel="elements, batch or steps", ylabel="CPU s")
    third.grid(True, color="0.9")
    third.tick_params(which="minor", labelbottom=False, labelleft=False)
    if timed:
        third.legend(**legend)
    first.figure.set_layout_engine("constrained")
    save(first, path)
