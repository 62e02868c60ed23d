"""Memory of this machine: what is asked for against what is there."""

from __future__ import annotations

import os
import sys
from pathlib import Path

SMALL = 2**28  # bytes that are not asked about
GROUP = Path("/sys/fs/cgroup")  # limits of a container
STATUS = "/proc/self/status"


def available() -> int | None:
    """Bytes that this process may still take, None = not known."""
    left = [x for x in (_free(), _left_to_group(), _left_to_process()) if x is not None]
    return max(0, min(left)) if left else None


def _left_to_group() -> int | None:
    """Under the limit of a container, None = there is none."""
    try:
        most, taken = ((GROUP / f"memory.{name}").read_text() for name in ("max", "current"))
        return int(most) - int(taken)
    except (OSError, ValueError):
        return None


def _left_to_process() -> int | None:
    """Under this process's own limit of addresses (`ulimit -v`), None = there is none."""
    try:
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        return None if most == resource.RLIM_INFINITY else most - amount(STATUS, "VmSize")
    except (ImportError, AttributeError, OSError, KeyError, ValueError):
        return None


def _free() -> int | None:
    try:
        return amount("/proc/meminfo", "MemAvailable")
    except (OSError, ValueError, KeyError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def check_memory(what: str, wanted: float, advice: str) -> None:
    """Raises MemoryError where more bytes are wanted than there are."""
    free = available() if wanted > SMALL else None
    if free is not None and wanted > free:
        raise MemoryError(
            f"{what} would take {wanted / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free; {advice}"
        )


def most_held() -> int:
    """Most bytes that this process has held so far; 0 = not known."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )


def amount(path: str, name: str) -> int:
    """Bytes that a file of /proc tells by this name. Raises OSError, ValueError or KeyError."""
    lines = dict(line.split(":", 1) for line in Path(path).read_text().splitlines())
    return 1024 * int(lines[name].split()[0])
