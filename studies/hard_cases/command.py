"""python -m studies hardcases: run the list, print it, write it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from torchbeam.core.command_line import results_folder
from torchbeam.core.results import measured_on, sentence, table, write

from .case import BATCH, VARIANTS, Case, Result, run
from .cases import CASES
from .precision import precision_rows


def main(argv: Sequence[str]) -> int:
    """Run the hard cases and say what fails; 0 if all went as the list says."""
    parser = argparse.ArgumentParser(
        prog="python -m studies hardcases",
        description=(
            "Run the hard cases in float64, in float32, as a batch and with gradients; print what "
            "fails and why. Exit status 0 if all went as the list says."
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for hardcases.json and hardcases.md (default: printed only)",
    )
    parser.add_argument("--quick", action="store_true", help="the reduced sizes of the tests")
    parser.add_argument(
        "--long",
        action="store_true",
        help="100,000 steps where a case has them (20 minutes a precision)",
    )
    parser.add_argument(
        "--filter", default="", metavar="TEXT", help="only cases whose name holds TEXT"
    )
    parser.add_argument(
        "--float32", action="store_true", help="only the table of single against double precision"
    )
    args = parser.parse_args(argv)
    chosen = [] if args.float32 else [case for case in CASES if args.filter in case.name]
    if not (chosen or args.float32):
        parser.error(f"--filter {args.filter!r} was given; no case has that in its name")
    out = args.out and results_folder(parser, args.out)
    results = [r for case in _progress(chosen) for r in run(case, args.quick, args.long)]
    precision = precision_rows() if args.float32 or not args.filter else []
    heading = measured_on(dtype=None)
    text = f"{markdown(chosen, results, precision, BATCH[args.quick])}\n{sentence(heading)}"
    print(text)
    if out:
        write(
            out,
            "hardcases",
            text,
            {
                **heading,
                "quick": args.quick,
                "batch": BATCH[args.quick],
                "results": [asdict(r) for r in results],
                "float32": precision,
            },
        )
    return 0 if all(r.expected for r in results) else 1


def _progress(cases: list[Case]) -> Iterable[Case]:
    try:
        from tqdm import tqdm
    except ImportError:
        return cases
    return tqdm(cases, unit="case", leave=False)


def markdown(cases: list[Case], results: list[Result], precision: list[dict], batch: int) -> str:
    """The tables: one row a case, then what fails and why, and single precision."""
    lines = []
    if cases:
        lines += [
            "`error` is what the case checks, in float64. float32: distance from float64. Batch "
            f"of {batch}: distance of its first sample from the sample alone, 0 = the same bits. "
            "Gradient: distance from central differences. `iterations a step` and `s` (all four "
            "runs): as measured here.",
            "",
        ]
        lines += [
            table(
                (
                    "case",
                    "what makes it hard",
                    "checked",
                    "error",
                    *VARIANTS[1:],
                    "iterations a step",
                    "s",
                ),
                (_row(case, [r for r in results if r.case == case.name]) for case in cases),
            )
        ]
    failed = [r for r in results if not r.expected or not r.ok]
    if failed:
        lines += ["", "### What fails", ""]
        lines += [
            table(
                ("case", "in", "status", "what happens", "why"),
                (
                    (
                        r.case,
                        r.variant,
                        str(r.status),
                        r.reason or "it passes",
                        r.known or "NOT EXPECTED",
                    )
                    for r in failed
                ),
            )
        ]
    if precision:
        lines += [
            "",
            "### float32 against float64",
            "",
            "Distance of the tips over the distance the tip has moved; P L^2/EI = 4 in statics, "
            "1 in motion.",
            "",
        ]
        lines += [
            table(
                tuple(precision[0]),
                (
                    tuple(
                        "fails" if v is None else str(v) if isinstance(v, int) else f"{v:.0e}"
                        for v in row.values()
                    )
                    for row in precision
                ),
            )
        ]
    return "\n".join([*lines, ""])


def _row(case: Case, results: list[Result]) -> tuple[str, ...]:
    of = {r.variant: r for r in results}
    cells = [
        _cell(of[v], of[v].error if v == "float64" else of[v].difference) if v in of else ""
        for v in VARIANTS
    ]
    iterations = of["float64"].iterations
    return (
        case.name,
        case.hard,
        case.check,
        *cells,
        "" if iterations is None else f"{iterations:.1f}",
        f"{sum(r.seconds for r in results):.1f}",
    )


def _cell(r: Result, number: float | None) -> str:
    text = "" if number is None else f"{number:.0e}"
    return text if r.ok else f"**FAILS** {text}"
