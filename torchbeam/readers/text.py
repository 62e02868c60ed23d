"""Text files: numbered lines, values by their names, and tables; errors name file and line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..core.files import path_of
from ..core.validation import refusal, shown

SYMMETRIC = 1e-5  # |K_ij - K_ji| up to this times sqrt(K_ii K_jj): six printed digits
TOO_LARGE = 2**28  # bytes: no file of a blade


class Text:
    """A file's lines; `line` (counted from 0) is where the next table is looked for."""

    def __init__(self, path: Any) -> None:
        """Raises ValueError for what is no path, no file, or no text."""
        self.path = path_of("path", path)
        if not self.path.is_file():
            raise refusal(f"path = {str(path)!r}, where there is no file,", "a file's path")
        if self.path.stat().st_size > TOO_LARGE:
            raise refusal(f"{self.path.name} of {self.path.stat().st_size} bytes", "a text file")
        raw = self.path.read_bytes()
        if b"\0" in raw:
            raise refusal(f"{self.path.name}, which is no text,", "a text file")
        self.whole = raw.decode("utf-8-sig", errors="replace")  # a byte order mark is no text
        self.lines = self.whole.splitlines()
        self.line = 0

    def beside(self, name: str) -> Path:
        """The path of a file that this one names."""
        return self.path.parent / name.replace("\\", "/")

    def refusal(self, line: int, given: str, wanted: str, *, are: bool = False) -> ValueError:
        """The error about a line, counted from 0; behind the last line: where the file ends."""
        line = min(line, max(len(self.lines) - 1, 0))
        return refusal(f"{given} in {self.path.name}, line {line + 1},", wanted, are=are)

    def refuse_length(self, length: float | None, why: str = "which says it") -> None:
        """Raises ValueError for a `length` m beside a file that needs none."""
        if length is not None:
            raise refusal(f"length = {length:g} with {self.path.name}, {why},", "no length")

    def find(self, *words: str, start: int = 0) -> int | None:
        """The number of the first line from `start` on that contains all words, None = none."""
        for k in range(start, len(self.lines)):
            if all(word in self.lines[k] for word in words):
                return k
        return None

    def value(self, *names: str) -> tuple[str, int]:
        """The value of a line `value  name  - remark`, of the first of `names` that there is, and
        the line's number. Raises ValueError where there is none.
        """
        for name in names:
            for k, line in enumerate(self.lines):
                value, rest = _first(line)
                if rest.split()[:1] == [name]:
                    return value, k
        raise refusal(f"{self.path.name} without a line for {names[0]}", "a whole file")

    def number(self, *names: str) -> float:
        """The same as a number."""
        value, k = self.value(*names)
        return self.numbers_in([value], k, f"{names[0]}, a number,")[0]

    def count(self, *names: str, least: int = 1) -> int:
        """The same as a whole number."""
        value, k = self.value(*names)
        try:
            count = int(value)
        except ValueError:
            count = least - 1
        if count < least:
            raise self.refusal(k, f"{names[0]} = {value}", f"a whole number from {least} on")
        return count

    def numbers_in(self, words: list[str], k: int, wanted: str) -> list[float]:
        """Words as finite numbers; Fortran's 1.0D+03 is one."""
        try:
            numbers = [float(word.replace("D", "E").replace("d", "e")) for word in words]
        except ValueError:
            numbers = [math.nan]
        if not all(map(math.isfinite, numbers)):
            raise self.refusal(k, shown(self.lines[k].strip()), wanted, are=wanted.endswith("s"))
        return numbers

    def row(self, columns: int, of: str) -> list[float]:
        """The first `columns` numbers of the next line that is not empty."""
        while self.line < len(self.lines) and not self.lines[self.line].strip():
            self.line += 1
        wanted = f"{columns} numbers of {of}" if columns > 1 else f"{of}, a number,"
        if self.line >= len(self.lines):
            raise self.refusal(self.line, "an end of file", wanted, are=columns > 1)
        words = self.lines[self.line].replace(",", " ").split()[:columns]
        if len(words) < columns:
            given = shown(self.lines[self.line].strip())
            raise self.refusal(self.line, given, wanted, are=columns > 1)
        self.line += 1
        return self.numbers_in(words, self.line - 1, wanted)

    def matrix(self, n: int, of: str) -> list[list[float]]:
        """The next n rows of n numbers, a symmetric matrix whose diagonal is not negative."""
        first = None
        rows = []
        for _ in range(n):
            rows.append(self.row(n, of))
            first = self.line - 1 if first is None else first
        check_matrix(rows, lambda given, wanted: self.refusal(first, f"{of} that {given}", wanted))
        return rows

    def after(self, *words: str, skip: int = 1) -> None:
        """The next table is behind the first line with all words, and `skip` lines from it on."""
        k = self.find(*words)
        if k is None:
            raise refusal(f"{self.path.name} without {words[0]!r}", "a whole file")
        self.line = k + skip


def check_matrix(rows: list[list[float]], error: Any) -> None:
    """Raises error(given, wanted) for a matrix (n, n) that is not symmetric, or not positive."""
    n = len(rows)
    if any(rows[k][k] <= 0 for k in range(n)):
        raise error("has a diagonal entry that is not positive", "a positive one")
    for i in range(n):
        for j in range(i):
            size = math.sqrt(rows[i][i] * rows[j][j])
            if abs(rows[i][j] - rows[j][i]) > SYMMETRIC * size:
                raise error(
                    f"is not symmetric ({rows[i][j]:g} in row {i + 1}, column {j + 1}, and "
                    f"{rows[j][i]:g} across)",
                    "a symmetric one",
                )


def _first(line: str) -> tuple[str, str]:
    """The first word of a line, quoted or not, and what follows it."""
    line = line.strip()
    if line[:1] in ("'", '"'):
        value, _, rest = line[1:].partition(line[0])
        return value, rest
    value, *rest = line.split(None, 1) or [""]
    return value, "".join(rest)
