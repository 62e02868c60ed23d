"""Report of work and precision: its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

from torchbeam.extend.commands import table

from ..common_case import KINDS
from .measurement import AccuracyRun
from .motions import MOTIONS, Motion
from .references import Reference
from .settings import BASE, FORMS, METHODS, TARGETS, Setting

ABOUT = (
    "Motions: {motions}. Error: RMS distance of the tip from a reference over its RMS "
    "displacement. Times are CPU time of one thread, of a call of `simulate`, least of the "
    "repeats (medians are in the CSV). Base: linear elements and equal midpoint steps with no "
    "more than the wanted error; where the time did not suffice for such a run (~), the time of "
    "its finest one times its error over the wanted one, which is less than it would be. A mesh "
    "and a number of steps were chosen so that what each is off by adds up to the wanted error at "
    "the least cost; that the two cancel in some pairs is not made use of."
)
BATCHES = (
    "In a batch (of {batch}; of adaptive steps as many as there was time for): CPU ms a sample."
)
EVERY = (
    "CPU ms by element and method, alone, and (elements, steps or rtol); the base is the "
    "first line of each motion."
)
EXPLICIT = (
    "Explicit methods, rtol = {rtol:g} (rk4: as many steps as are stable), at the finest mesh "
    "that there was time for; ~: scaled up from the first part of the motion, whose whole nobody "
    "would wait for."
)
PEERS = (
    "Other programs in the common dynamic case, beside the cheapest setting here of no "
    "larger error, 3D and plane."
)
REFERENCES = "The references are known to: {said}. Errors below twice that are not looked for."


def best(
    rows: Iterable[AccuracyRun],
    target: float,
    cost: Callable[[AccuracyRun], float | None] = lambda row: row.seconds,
) -> AccuracyRun | None:
    """The cheapest row of an error, or a smaller one."""
    within = [
        row
        for row in rows
        if row.error is not None and row.error <= target and cost(row) is not None
    ]
    return min(within, key=cost, default=None)


def base(
    rows: Sequence[AccuracyRun], target: float, cost: Callable[[AccuracyRun], float | None]
) -> tuple[float, bool, AccuracyRun] | None:
    """What the second-order setting costs at an error, whether that is measured, and its row."""
    of_base = [row for row in rows if (row.element, row.method) == BASE]
    if (setting := best(of_base, target, cost)) is not None:
        return cost(setting), True, setting
    known = [row for row in of_base if row.error is not None and cost(row) is not None]
    if not known:
        return None
    finest = min(known, key=lambda row: row.error)
    return cost(finest) * finest.error / target, False, finest


def markdown(
    rows: Sequence[AccuracyRun], known: Mapping[str, Reference], others: Sequence[Mapping[str, Any]]
) -> str:
    motions = [motion for motion in MOTIONS if any(row.motion == motion.name for row in rows)]
    implicit = [row for row in rows if row.method in METHODS]
    batch = max((row.batch for row in implicit if row.batch), default=0)
    parts = [
        ABOUT.format(motions="; ".join(f"**{m.name}**, {m.about}" for m in motions)),
        _cheapest(motions, implicit), BATCHES.format(batch=batch), _batches(motions, implicit),
        EVERY, _every(motions, implicit),
    ]  # fmt: skip
    if any(row.element in FORMS for row in rows):
        rtol = next(row.fineness for row in rows if row.element in FORMS and row.method != "rk4")
        parts += [EXPLICIT.format(rtol=rtol), _explicit(rows)]
    if others:
        parts += [PEERS, _peers(implicit, others)]
    said = "; ".join(
        f"{name} {one.agreement:.1e} (gradient {one.gradient_agreement:.1e})"
        for name, one in known.items()
    )
    return "\n\n".join((*parts, REFERENCES.format(said=said)))


def _setting(row: AccuracyRun) -> str:
    return f"{row.element}, {row.method}, {_fineness(row)}"


def _fineness(row: AccuracyRun) -> str:
    setting = Setting(row.element, row.method, row.elements, row.fineness)
    return f"{row.elements}, {setting.fineness_text()}"


def _ms(seconds: float | None, exact: bool = True) -> str:
    return "" if seconds is None else f"{'' if exact else '~'}{1e3 * seconds:.3g}"


def _ratio(over: float | None, under: float | None, exact: bool = True) -> str:
    return "" if not over or not under else f"{'' if exact else '~'}{over / under:.3g}"


def _percent(value: float | None) -> str:
    if value is None:
        return ""
    return f"{100 * value:.2g} %" if value >= 5e-4 else f"{value:.1e}".replace("e-0", "e-")


def _target(value: float) -> str:
    return f"{100 * value:g} %" if value >= 1e-3 else f"{value:.0e}".replace("e-0", "e-")


def _pairs(
    motions: Sequence[Motion],
    rows: Sequence[AccuracyRun],
    cost: Callable[[AccuracyRun], float | None],
) -> Iterator[tuple[Motion, float, AccuracyRun, float, bool, AccuracyRun]]:
    """Of each motion and wanted error that both reach: the cheapest row, what the base costs,
    whether that is measured, and the base's row.
    """
    for motion in motions:
        own = [row for row in rows if row.motion == motion.name]
        for target in TARGETS:
            row, second = best(own, target, cost), base(own, target, cost)
            if row is not None and second is not None:
                yield motion, target, row, *second


def _cheapest(motions: Sequence[Motion], rows: Sequence[AccuracyRun]) -> str:
    lines = (
        f"{motion.name} | {motion.kind} | {_target(target)} | {_setting(row)} | "
        f"{_percent(row.error)} | {_ms(row.seconds)} | {_fineness(finest) if exact else ''} | "
        f"{_ms(cost, exact)} | {_ratio(cost, row.seconds, exact)} | "
        f"{_ratio(row.gradient, row.seconds)} | {_percent(row.gradient_error)}"
        for motion, target, row, cost, exact, finest in _pairs(motions, rows, lambda r: r.seconds)
    )
    head = (
        "motion | kind | wanted | cheapest (elements, steps) | its error | ms | base | its ms | "
        "times faster | gradient over forward | its error"
    )
    return table(head, lines, words=4)


def _batches(motions: Sequence[Motion], rows: Sequence[AccuracyRun]) -> str:
    lines = (
        f"{motion.name} | {_target(target)} | {_setting(row)} | {_ms(row.batch_seconds)} | "
        f"{_ms(cost, exact)} | {_ratio(cost, row.batch_seconds, exact)} | "
        f"{_ratio(row.batch_gradient, row.batch_seconds)}"
        for motion, target, row, cost, exact, _ in _pairs(motions, rows, lambda r: r.batch_seconds)
    )
    head = (
        "motion | wanted | cheapest setting | ms a sample | base: ms a sample | times faster | "
        "gradient over forward"
    )
    return table(head, lines, words=3)


def _every(motions: Sequence[Motion], rows: Sequence[AccuracyRun]) -> str:
    lines = []
    for motion, element, method in product((m.name for m in motions), KINDS, METHODS):
        own = [r for r in rows if (r.motion, r.element, r.method) == (motion, element, method)]
        least = [best(own, target) for target in TARGETS]
        said = ["" if row is None else f"{_ms(row.seconds)} ({_fineness(row)})" for row in least]
        if not any(least) and (note := next((row.note for row in own if row.note), "")):
            said[0] = note.partition(";")[0]
        if any(said):
            lines.append((motion, element, method, *said))
    return table(("motion", "element", "method", *map(_target, TARGETS)), lines, words=3)


def _explicit(rows: Sequence[AccuracyRun]) -> str:
    last = {(row.motion, row.element, row.method): row for row in rows if row.element in FORMS}
    lines = []
    for row in last.values():
        note = row.error is None and row.note.partition(";")[0]
        seconds = "" if row.seconds is None else f"{'~' if row.scaled > 1 else ''}{row.seconds:.3g}"
        lines.append(
            f"{row.motion} | {row.element} | {row.method} | {row.elements} | "
            f"{'' if row.steps is None else row.steps} | {note or _percent(row.error)} | "
            f"{seconds} | {_percent(row.gradient_error)} | {_ratio(row.gradient, row.seconds)}"
        )
    head = (
        "motion | form | method | elements | evaluations | error | CPU s | "
        "error of the gradient | gradient over forward"
    )
    return table(head, lines, words=3)


def _peers(rows: Sequence[AccuracyRun], others: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for other in others:
        ours = [
            best((row for row in rows if row.motion == name), other["error"])
            for name in ("sudden", "sudden, plane")
        ]
        if not other["error"] < 1:
            continue
        said = ("" if row is None else f"{_ms(row.seconds)} ({_setting(row)})" for row in ours)
        lines.append(
            f"{other['peer']}, {other['space']} | {other['elements']} | {other['step_ms']:g} | "
            f"{_percent(other['error'])} | {_ms(other['best_cpu_s'])} | {' | '.join(said)}"
        )
    head = "program | elements | step, ms | error | ms | here, 3D: ms | here, plane: ms"
    return table(head, lines, words=1)
