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
    def case(r: Measured) -> tuple:
        return r.space, r.elements, r.step_ms, r.batch, r.element

    own = [r for r in rows if r.part == throughput.PART]
    rates = {(case(r), (r.engine, r.unit, r.threads)): r for r in own}
    ceilings = {case(r): r.best for r in own if r.what == throughput.CEILING}
    peers = {r.space: r for r in rows if r.part == PEERS}
    lines = []
    for of in dict.fromkeys(of for of, _ in rates):
        compiled, eager = (rates.get((of, (engine, CPU, 1))) for engine in ("compiled", "eager"))
        one, two = (rates.get((of, ("compiled", WALL, count))) for count in (1, 2))
        space, elements, step, batch, element = of
        faster = "" if eager is None else f"{compiled.best / eager.best:.0f}"
        threads = "" if two is None else f"{two.best / one.best:.2f}"
        ceiling = [f"{ceilings[of]:.2f}" if of in ceilings else ""] if ceilings else []
        peer = peers.get(space)
        over = [f"{compiled.best / peer.best:.1f}" if peer else ""] if peers else []
        error, rate = f"{100 * compiled.error:.2f} %", (_rate(eager), _rate(compiled))
        first = space, f"{elements}, {element}", f"{step:.3g}", error, f"{batch}"
        lines.append((*first, *rate, faster, threads, *ceiling, *over))
    for r in peers.values():
        first = f"{r.engine}, {r.space}", f"{r.elements}, {r.element}", f"{r.step_ms:.3g}"
        error, empty = f"{100 * r.error:.2f} %", [""] * (3 + bool(ceilings))
        lines.append((*first, error, "1", "", _rate(r), *empty))
    head = (
        "case | elements | step, ms | error | batch | eager: simulated s per CPU s | "
        "compiled, or the peer | over eager | 2 threads over 1"
        f"{' | 2 processes over 1' * bool(ceilings)}{' | over the peer' * bool(peers)}"
    )
    return _table(head, lines, words=1)


def _table(head: str | Sequence[str], lines: Sequence[Sequence[str]], words: int) -> str:
    return table(head, lines, words) if lines else ""


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
    parts = throughput, gradients, calls, structures, contact, mechanisms, first_use, breakdown
    known = {PEERS, *(part.PART for part in (*parts, growth, operations))}
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
    names = (
        "element, before element, node, row, back, element bar, blocks, law, node bar, block, "
        "joint, interface, row backward, row bordered"
    ).split(", ")
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
            sizes = [getattr(x, what, None) or int(x.what.split()[0]) for x in line]
            label = f"{r.space}, {what}: power {r.best:.2f}"
            third.loglog(sizes, [x.best for x in line], "o-", ms=3, label=label)
    third.set(xlabel="elements, batch or steps", ylabel="CPU s")
    third.grid(True, color="0.9")
    third.tick_params(which="minor", labelbottom=False, labelleft=False)
    if timed:
        third.legend(**legend)
    first.figure.set_layout_engine("constrained")
    save(first, path)
