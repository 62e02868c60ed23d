"""python -m studies verify: run the cases, print the table, write it."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Iterator

from ..harness import Report, Study
from .case import Case, Result, run
from .cases import CASES

ABOUT = (
    "`reference` and `here`: the number with the largest error, of as many as stand in brackets. "
    "`error` is relative, or over what `quantity` names."
)


def study(options: Namespace) -> Iterator[Report]:
    chosen = _chosen(options)
    old = [
        Result(**{name: value for name, value in row.items() if name != "ok"})
        for row in options.stored.get("results", [])
    ]
    stored = {_key(row): row for row in old if row.ok}
    rows: list[Result] = []
    for k, case in enumerate(chosen):
        rows.append(stored.get(_key(case)) or run(case))
        # a run that is ended goes on from there
        kept = [stored[key] for key in map(_key, chosen[k + 1 :]) if key in stored]
        status = int(not all(row.ok for row in rows))
        yield Report([markdown([*rows, *kept])], [*rows, *kept], key="results", status=status)


def _chosen(options: Namespace) -> list[Case]:
    return [c for c in CASES if options.filter in f"{c.name} {c.source} {c.quantity}"]


def _check(options: Namespace) -> str | None:
    if options.resume and not options.out:
        return "--resume was given without --out; the folder of what is kept is wanted"
    if not _chosen(options):
        return (
            f"--filter {options.filter!r} was given; no case has that in its name, source or "
            "quantity"
        )
    return None


def _key(row: Case | Result) -> tuple[str | float, ...]:
    """What makes two rows the same case."""
    name = row.case if isinstance(row, Result) else row.name
    return name, row.source, row.quantity, row.mesh, row.bound


def markdown(results: Iterable[Result]) -> str:
    """The table: of a case with several numbers, that of the largest error."""
    lines = []
    for r in results:
        many = f" ({r.entries})" if r.entries > 1 else ""
        error = f"{r.error:.1e}" if r.ok else f"**{r.error:.1e}**, {r.bound:.0e} is accepted"
        lines.append(
            f"| {r.case} | {r.source} | {r.quantity}{many} | {r.reference:.6g} | {r.ours:.6g} | "
            f"{error} | {r.mesh} | {r.seconds:.1f} |"
        )
    head = "| case | source | quantity | reference | here | error | mesh | s |"
    return "\n".join((ABOUT, "", head, "|---|---|---|---:|---:|---:|---|---:|", *lines))


main = Study(
    "verify",
    "Compare with closed forms, other codes and published figures; 0 if every error is within its "
    "bound.",
    "Compare with closed forms, other codes and published figures; print a row a case. Exit "
    "status 0 if every error is within its bound.",
    study,
    resume="keep the rows in --out of cases that are the same and hold, and compute the others",
    options={
        "--filter": dict(
            default="", metavar="TEXT", help="only cases whose name, source or quantity holds TEXT"
        )
    },
    check=_check,
    out=False,
    threads=None,
)
