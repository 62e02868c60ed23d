"""The harness of studies: options, resuming, and what is written of results.

A study is a function of the options that gives a `Report`, or one after the other as it goes on.
`Study` makes a command of it: its parser, the folder, NAME.md, NAME.json (with machine and
versions), NAME.csv and pictures.
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from torchbeam.extend.commands import (
    measured_on,
    results_folder,
    sentence,
    threads,
    versions,
    write_results,
)

Options = Mapping[str, Mapping[str, Any]]


@contextmanager
def where_installed() -> Iterator[None]:
    """For the pictures of a command, which goes on without matplotlib, and says so."""
    try:
        yield
    except ImportError as error:
        print(f"no picture: {error}", file=sys.stderr)


@dataclass
class Report:
    """What a study has found so far.

    text     paragraphs of Markdown; what it was measured on is said below them
    rows     dataclasses, named tuples or mappings: the CSV, and in the JSON `key`
    data     of the JSON, beside heading and rows;  name: of the files, None = the study's
    columns, cells  of the CSV, where these are not the rows' own names and values
    picture  draws into the folder, where matplotlib is installed
    status   of the command at its end
    """

    text: Sequence[str]
    rows: Sequence[Any]
    data: Mapping[str, Any] = field(default_factory=dict)
    key: str = "rows"
    name: str | None = None
    columns: Sequence[str] | None = None
    cells: Sequence[Sequence[Any]] | None = None
    picture: Callable[[Path], None] | None = None
    status: int = 0

    def write(self, folder: Path, name: str, text: str, heading: Mapping[str, Any]) -> None:
        records = [record(row) for row in self.rows]
        columns = (list(records[0]) if records else ()) if self.columns is None else self.columns
        cells = [r.values() for r in records] if self.cells is None else self.cells
        write_results(
            folder, name, text, {**heading, **self.data, self.key: records}, columns, cells
        )
        if self.picture is not None:
            with where_installed():
                self.picture(folder)


def record(row: Any) -> dict[str, Any]:
    """A row by names; of one that says whether it holds, that too."""
    if is_dataclass(row):
        ok = {"ok": row.ok} if hasattr(row, "ok") else {}
        return {**asdict(row), **ok}  # type: ignore[call-overload]
    return row._asdict() if hasattr(row, "_asdict") else dict(row)


@dataclass
class Study:
    """A command.

    title    first line in the list of commands;  about: what it does
    run      (options) -> a `Report`; an iterator of reports, each in place of the last; or, where
             nothing is to be written, the command's status
    quick, resume  help of --quick and --resume, None = it has no such option; `options.stored` is
             what the JSON of an earlier run holds, {} without --resume
    options  by flag: arguments of `ArgumentParser.add_argument`
    check    (options) -> why they do not fit, or None
    place    (options) -> the folder that is written into, None = none, and the option that says it
    out      whether results are written without --out, into out/NAME
    threads  of torch, None = as they are;  double: by default float64
    dtype    see `measured_on`;  packages: whose versions are told too
    """

    name: str
    title: str
    about: str
    run: Callable[[Namespace], Report | Iterator[Report] | int]
    quick: str | None = None
    resume: str | None = None
    options: Options = field(default_factory=dict)
    check: Callable[[Namespace], str | None] = lambda options: None
    place: Callable[[Namespace], tuple[Path | None, str]] = lambda options: (options.out, "--out")
    out: bool = True
    threads: int | None = 1
    double: bool = False
    dtype: str | None = "float64"
    packages: Sequence[str] = ()

    def __post_init__(self) -> None:
        self.__doc__ = self.title  # what the list of commands shows

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        parser = self.parser()
        options = parser.parse_args(argv)
        if (why := self.check(options)) is not None:
            parser.error(why)
        folder, flag = self.place(options)
        if folder is not None:
            folder = results_folder(parser, folder, flag)
        options.stored = {}
        if getattr(options, "resume", False) and (folder / f"{self.name}.json").is_file():
            options.stored = json.loads((folder / f"{self.name}.json").read_text())
        text, status = None, 0
        try:
            for report in self._reports(options, parser):
                if isinstance(report, int):
                    return report
                text, heading = self._said(report)
                status = report.status
                if folder is not None:
                    report.write(folder, report.name or self.name, text, heading)
        finally:  # neither a disk that fills up nor Ctrl-C takes what was found from the screen
            if text is not None:
                print(text, flush=True)
        return status

    def parser(self) -> ArgumentParser:
        names = f"{self.name}.csv, {self.name}.md and {self.name}.json"
        parser = ArgumentParser(
            prog=f"python -m studies {self.name}",
            description=f"{self.about} Writes {names} (with machine and versions).",
        )
        default = Path("out") / self.name if self.out else None
        about = f"folder for the results (default: {default or 'printed only'})"
        parser.add_argument("--out", type=Path, default=default, help=about)
        for flag in ("quick", "resume"):
            if (text := getattr(self, flag)) is not None:
                parser.add_argument(f"--{flag}", action="store_true", help=text)
        for flag, arguments in self.options.items():
            parser.add_argument(flag, **arguments)
        return parser

    def _reports(self, options: Namespace, parser: ArgumentParser) -> Iterator[Report | int]:
        with ExitStack() as stack:
            if self.threads is not None:
                stack.enter_context(threads(self.threads))
            if self.double:
                stack.enter_context(double_precision())
            try:
                reports = self.run(options)
                yield from reports if isinstance(reports, Iterator) else (reports,)
            except Refused as error:
                parser.error(str(error))

    def _said(self, report: Report) -> tuple[str, dict[str, Any]]:
        heading = measured_on(dtype=self.dtype)
        heading["versions"] |= versions(*self.packages)
        return "\n\n".join((*report.text, sentence(heading))).strip(), heading


class Refused(ValueError):
    """Error: options that only running shows not to fit."""


@contextmanager
def double_precision() -> Iterator[None]:
    """float64 by default within it."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def data(name: str) -> Any:
    """The contents of data/NAME.json."""
    return json.loads(resources.files("studies").joinpath(f"data/{name}.json").read_text())
