"""Memory of this machine: what is asked for is compared with what is there before it is used."""

from __future__ import annotations

import os
from pathlib import Path

SMALL = 2**28  # bytes that are not asked about
GROUP = Path("/sys/fs/cgroup")  # limits of a container


def available() -> int | None:
    """Bytes that this process may still take, None = not known."""
    free = _free()
    try:
        most, taken = ((GROUP / f"memory.{name}").read_text() for name in ("max", "current"))
        left = int(most) - int(taken)
    except (OSError, ValueError):  # no group, or one without limit
        return free
    return left if free is None else min(left, free)


def _free() -> int | None:
    try:
        with open("/proc/meminfo") as file:
            lines = dict(line.split(":") for line in file)
        return int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, ValueError, KeyError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def check_memory(what: str, wanted: int, advice: str) -> None:
    """Raises MemoryError where more bytes are wanted than there are."""
    free = available() if wanted > SMALL else None
    if free is not None and wanted > free:
        raise MemoryError(f"{what} would take {wanted / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free; {advice}")
