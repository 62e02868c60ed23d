"""The command line of a study: where its results go, how quick it is to be."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from torchbeam.core.command_line import results_folder


def study(
    argv: Sequence[str] | None,
    name: str,
    description: str,
    quick: str,
    more: Callable[[argparse.ArgumentParser], Any] | None = None,
    instead: str | None = None,
) -> tuple[argparse.Namespace, Path]:
    """Options of a command that writes NAME.csv, NAME.md and NAME.json, --out, --quick and those
    that `more` adds, and the folder for its results; where the option `instead` is given, a file
    that is written in place of these, the folder of that.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m studies {name}",
        description=(
            f"{description} Writes {name}.csv, {name}.md and {name}.json (with machine and "
            "versions)."
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out") / name,
        help="folder for the results (default: %(default)s)",
    )
    parser.add_argument("--quick", action="store_true", help=quick)
    if more is not None:
        more(parser)
    given = parser.parse_args(argv)
    if instead is not None and (file := getattr(given, instead)) is not None:
        return given, results_folder(parser, file.parent, f"--{instead}")
    return given, results_folder(parser, given.out)


@contextmanager
def double_precision() -> Iterator[None]:
    """float64 by default within it."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)
