"""Progress of a run: samples done, rate, time to go, failures."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..core.arguments import function as checked_function

Report = Callable[[Any], None]  # is given the Progress after each chunk
EVERY, LOG = 0.5, 10.0  # seconds between two lines on a terminal, and in a file


@dataclass
class Progress:
    """done of total samples, `found` of them in the folder; failed; rate, samples a second of those
    computed; eta, s.

    total   the most there will be
    report  called after each chunk; True: a line on the terminal (standard error)
    """

    total: int
    begun: float
    report: Report | bool
    done: int = 0
    restored: int = 0
    failed: int = 0
    _reported: float = 0.0

    def __post_init__(self) -> None:
        if self.report is not True:
            checked_function("progress", self.report, "progress")

    def add(self, samples: int, failed: int, stored: bool) -> None:
        """Count a chunk, and tell."""
        self.done += samples
        self.restored += samples * stored
        self.failed += failed
        terminal = sys.stderr.isatty()
        late = time.monotonic() - self._reported > (EVERY if terminal else LOG)
        if self.report is not True:
            self.report(self)
        elif late or self.done >= self.total:
            self._reported = time.monotonic()
            over = terminal and self.done < self.total
            line, end = (f"\r{self}", "" if over else "\n") if terminal else (f"{self}", "\n")
            print(line, end=end, file=sys.stderr, flush=True)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.begun

    @property
    def rate(self) -> float:
        """Samples a second, 0 while none was computed."""
        return (self.done - self.restored) / max(self.seconds, 1e-9)

    @property
    def eta(self) -> float:
        """Seconds to go, infinite while none was computed."""
        if self.rate:
            return (self.total - self.done) / self.rate
        return 0.0 if self.done >= self.total else float("inf")

    def __str__(self) -> str:
        return (
            f"{self.done:,} of {self.total:,} samples, {100 * self.done / self.total:.0f} %; "
            f"{self.rate:,.0f}/s, {_clock(self.eta)} to go; {self.failed} failed"
            + (f"; {self.restored:,} were there" if self.restored else "")
        )


def _clock(seconds: float) -> str:
    if seconds == float("inf"):
        return "?"
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
