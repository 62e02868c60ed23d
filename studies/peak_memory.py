"""Peak memory: what a run takes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from torchbeam.core.memory import STATUS, amount, most_held

RESET = Path("/proc/self/clear_refs")  # the most held so far is counted anew


def peak_memory() -> Callable[[], float]:
    """A function for the most MB in memory that this process has held since now, beside what it
    held; nan where the system does not tell. Where the system cannot begin to count anew (no
    /proc), beside the most that it had held. Pages that the system took back meanwhile are not in
    it: on a machine short of memory it may be 0.
    """
    try:
        RESET.write_text("5")
        before, most = _most_since(), _most_since
    except (OSError, KeyError, ValueError):
        before, most = most_held(), most_held
    return lambda: max(most() - before, 0) / 1e6 if before else float("nan")


def _most_since() -> int:
    """Bytes held at most since the count began."""
    return amount(STATUS, "VmHWM")
