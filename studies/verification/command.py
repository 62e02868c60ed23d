"""python -m studies verify: run the cases, print the table, write it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from torchbeam.core.command_line import results_folder
from torchbeam.core.results import measured_on, sentence, write

from .case import Case, Result, run
from .cases import CASES

HEAD = ("case", "source", "quantity", "reference", "here", "error", "mesh", "s")


def main(argv: Sequence[str]) -> int:
    """Compare with closed forms, other codes and published figures; 0 if every error is within its
    bound.
    """
    parser = argparse.ArgumentParser(
        prog="python -m studies verify",
        description=(
            "Compare with closed forms, other codes and published figures; print a row a case. "
            "Exit status 0 if every error is within its bound."
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for verify.json, verify.csv and verify.md (default: printed only)",
    )
    parser.add_argument(
        "--filter",
        default="",
        metavar="TEXT",
        help="only cases whose name, source or quantity holds TEXT",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="keep the rows in --out of cases that are the same and hold, and compute the others",
    )
    args = parser.parse_args(argv)
    if args.resume and not args.out:
        parser.error("--resume was given without --out; the folder of what is kept is wanted")
    chosen = [case for case in CASES if args.filter in f"{case.name} {case.source} {case.quantity}"]
    if not chosen:
        parser.error(
            f"--filter {args.filter!r} was given; no case has that in its name, source or quantity"
        )
    out = args.out and results_folder(parser, args.out)
    stored = _stored(out) if args.resume else {}
    rows: list[Result] = []
    try:
        for k, case in enumerate(chosen):
            rows.append(stored.get(_key(case)) or run(case))
            if out:  # a run that is ended goes on from there
                _write(out, rows + [old for x in chosen[k + 1 :] if (old := stored.get(_key(x)))])
    finally:  # and a disk that fills up, or Ctrl-C, takes no row from the screen
        if rows:
            print(f"{markdown(rows)}\n{sentence(measured_on())}")
    return 0 if all(r.ok for r in rows) else 1


def _key(row: Case | Result) -> tuple[str | float, ...]:
    """What makes two rows the same case."""
    name = row.case if isinstance(row, Result) else row.name
    return name, row.source, row.quantity, row.mesh, row.bound


def _stored(out: Path) -> dict[tuple[str | float, ...], Result]:
    """Those of an earlier run in the folder that hold, by their case."""
    file = out / "verify.json"
    rows = json.loads(file.read_text())["results"] if file.exists() else []
    results = [Result(**{k: v for k, v in row.items() if k != "ok"}) for row in rows]
    return {_key(r): r for r in results if r.ok}


def _write(out: Path, results: Sequence[Result]) -> None:
    heading = measured_on()
    rows = [{**asdict(r), "ok": r.ok} for r in results]
    text = f"{markdown(results)}\n{sentence(heading)}"
    data = {**heading, "results": rows}
    write(out, "verify", text, data, list(rows[0]), (row.values() for row in rows))


def markdown(results: Iterable[Result]) -> str:
    """The table: of a case with several numbers, that of the largest error."""
    lines = [
        "`reference` and `here`: the number with the largest error, of as many as stand in "
        "brackets. `error` is relative, or over what `quantity` names.",
        "",
        f"| {' | '.join(HEAD)} |",
        "|---|---|---|---:|---:|---:|---|---:|",
    ]
    for r in results:
        many = f" ({r.entries})" if r.entries > 1 else ""
        error = f"{r.error:.1e}" if r.ok else f"**{r.error:.1e}**, {r.bound:.0e} is accepted"
        cells = (
            r.case,
            r.source,
            r.quantity + many,
            f"{r.reference:.6g}",
            f"{r.ours:.6g}",
            error,
            r.mesh,
            f"{r.seconds:.1f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])
