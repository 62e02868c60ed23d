"""python -m studies hardcases: run the list, print it, write it."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable

from torchbeam.extend.commands import table

from ..harness import Report, Study
from .case import BATCH, VARIANTS, Case, Result, run
from .cases import CASES
from .precision import precision_rows

ABOUT = (
    "`error` is what the case checks, in float64. float32: distance from float64. Batch of "
    "{batch}: distance of its first sample from the sample alone, 0 = the same bits. Gradient: "
    "distance from central differences. `iterations a step` and `s` (all four runs): as measured "
    "here."
)
PRECISION = (
    "### float32 against float64",
    "Distance of the tips over the distance the tip has moved; P L^2/EI = 4 in statics, 1 in "
    "motion.",
)


def study(options: Namespace) -> Report:
    chosen = _chosen(options)
    results = [r for case in _progress(chosen) for r in run(case, options.quick, options.long)]
    precision = precision_rows() if options.float32 or not options.filter else []
    batch = BATCH[options.quick]
    return Report(
        markdown(chosen, results, precision, batch),
        results,
        {"quick": options.quick, "batch": batch, "float32": precision},
        key="results",
        status=int(not all(r.expected for r in results)),
    )


def _chosen(options: Namespace) -> list[Case]:
    return [] if options.float32 else [case for case in CASES if options.filter in case.name]


def _check(options: Namespace) -> str | None:
    if options.float32 or _chosen(options):
        return None
    return f"--filter {options.filter!r} was given; no case has that in its name"


def _progress(cases: list[Case]) -> Iterable[Case]:
    try:
        from tqdm import tqdm
    except ImportError:
        return cases
    return tqdm(cases, unit="case", leave=False)


def markdown(
    cases: list[Case], results: list[Result], precision: list[dict], batch: int
) -> list[str]:
    """The tables: one row a case, then what fails and why, and single precision."""
    text = []
    if cases:
        variants = " | ".join(VARIANTS[1:])
        head = f"case | what makes it hard | checked | error | {variants} | iterations a step | s"
        rows = (_row(case, [r for r in results if r.case == case.name]) for case in cases)
        text += [ABOUT.format(batch=batch), table(head, rows)]
    if failed := [r for r in results if not r.expected or not r.ok]:
        rows = (
            f"{r.case} | {r.variant} | {r.status} | {r.reason or 'it passes'} | "
            f"{r.known or 'NOT EXPECTED'}"
            for r in failed
        )
        text += ["### What fails", table("case | in | status | what happens | why", rows)]
    if precision:
        values = (row.values() for row in precision)
        text += [*PRECISION, table(tuple(precision[0]), (map(_digit, row) for row in values))]
    return text


def _digit(value: float | None) -> str:
    return "fails" if value is None else str(value) if isinstance(value, int) else f"{value:.0e}"


def _row(case: Case, results: list[Result]) -> str:
    of = {r.variant: r for r in results}
    cells = " | ".join(
        _cell(of[v], of[v].error if v == "float64" else of[v].difference) if v in of else ""
        for v in VARIANTS
    )
    iterations = of["float64"].iterations
    return (
        f"{case.name} | {case.hard} | {case.check} | {cells} | "
        f"{'' if iterations is None else f'{iterations:.1f}'} | "
        f"{sum(r.seconds for r in results):.1f}"
    )


def _cell(r: Result, number: float | None) -> str:
    text = "" if number is None else f"{number:.0e}"
    return text if r.ok else f"**FAILS** {text}"


main = Study(
    "hardcases",
    "Run the hard cases and say what fails; 0 if all went as the list says.",
    "Run the hard cases in float64, in float32, as a batch and with gradients; print what fails "
    "and why. Exit status 0 if all went as the list says.",
    study,
    quick="the reduced sizes of the tests",
    options={
        "--long": dict(
            action="store_true", help="100,000 steps where a case has them (20 minutes a precision)"
        ),
        "--filter": dict(default="", metavar="TEXT", help="only cases whose name holds TEXT"),
        "--float32": dict(
            action="store_true", help="only the table of single against double precision"
        ),
    },
    check=_check,
    out=False,
    threads=None,
    dtype=None,
)
