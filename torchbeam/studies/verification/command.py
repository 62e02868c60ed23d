"""python -m torchbeam verify: run the cases, print the table, write it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from ...cli import results_folder
from ...core.results import measured_on, sentence, write
from .case import Result, run
from .cases import CASES

HEAD = ("case", "source", "quantity", "reference", "here", "error", "mesh", "s")


def main(argv: Sequence[str]) -> int:
    """Compare with closed forms, other codes and published figures; 0 if every error is within its
    bound.
    """
    parser = argparse.ArgumentParser(
        prog="python -m torchbeam verify",
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
    args = parser.parse_args(argv)
    chosen = [case for case in CASES if args.filter in f"{case.name} {case.source} {case.quantity}"]
    if not chosen:
        parser.error(
            f"--filter {args.filter!r} was given; no case has that in its name, source or quantity"
        )
    out = args.out and results_folder(parser, args.out)
    results = [run(case) for case in chosen]
    heading = measured_on()
    text = f"{markdown(results)}\n{sentence(heading)}"
    print(text)
    if out:
        rows = [{**asdict(r), "ok": r.ok} for r in results]
        write(
            out,
            "verify",
            text,
            {**heading, "results": rows},
            list(rows[0]),
            (row.values() for row in rows),
        )
    return 0 if all(r.ok for r in results) else 1


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
