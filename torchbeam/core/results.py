"""Results of measuring commands: heading (machine, versions), Markdown tables, files."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from . import files

PACKAGES = ("torchbeam", "torch", "torchdiffeq", "gymnasium", "numpy")


def measured_on(dtype: str | None = "float64", threads: int | None = None) -> dict[str, Any]:
    """Heading of a result file: machine, cores, threads and dtype (None: several), versions."""
    processor = _processor()
    heading = {
        "machine": ", ".join(
            filter(None, (f"{platform.system()} {platform.machine()}", processor))
        ),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads() if threads is None else threads,
        "dtype": dtype,
        "python": platform.python_version(),
        "versions": versions(*PACKAGES),
    }
    return {name: value for name, value in heading.items() if value is not None}


def sentence(heading: Mapping[str, Any]) -> str:
    """A heading as a line under a table; it may hold less, or more, than `measured_on` gives."""

    def number(name: str, noun: str) -> list[str]:
        count = heading.get(name)
        return [] if count is None else [f"{count} {noun}" + ("" if count == 1 else "s")]

    software = {"Python": heading.get("python"), **heading.get("versions", {})}
    said = [heading.get("machine"), *number("cores", "core"), *number("threads", "thread")]
    said += [heading.get("dtype"), *(f"{name} {v}" for name, v in software.items() if v)]
    return f"Measured on: {', '.join(filter(None, said))}."


def versions(*packages: str) -> dict[str, str]:
    """Installed versions by package; "not installed" where there is none."""

    def one(package: str) -> str:
        try:
            return version(package)
        except PackageNotFoundError:
            return "not installed"

    return {package: one(package) for package in packages}


def table(
    head: str | Sequence[str], rows: Iterable[str | Sequence[str]], words: int | None = None
) -> str:
    """A Markdown table; the first `words` columns (None = all) stand left, the others, numbers,
    right. Head and rows are sequences of cells, or texts in which " | " stands between these.
    """
    head, *lines = (row if isinstance(row, str) else " | ".join(row) for row in (head, *rows))
    count = head.count(" | ") + 1
    words = count if words is None else words
    rule = "|" + "---|" * words + "---:|" * (count - words)
    return "\n".join([f"| {head} |", rule, *(f"| {line} |" for line in lines)])


def write(
    folder: Path,
    name: str,
    text: str,
    data: Mapping[str, Any],
    columns: Sequence[str] = (),
    rows: Iterable[Sequence[Any]] = (),
) -> None:
    """name.md with the text, name.json with the data and, where there are columns, name.csv;
    files.NotWritten where the disk is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files.write(folder / f"{name}.md", text.strip() + "\n")
    files.write(folder / f"{name}.json", json.dumps(data, indent=1) + "\n")
    if columns:
        files.write(folder / f"{name}.csv", files.csv_text([columns, *rows]))


def _processor() -> str:
    """The processor's name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() if platform.processor() != platform.machine() else ""
