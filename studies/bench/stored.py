"""Stored numbers that are not to grow: operation counts, errors of fixed settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from torchbeam.extend.commands import write as write_file

GROWTH = 0.03  # that is let pass


def stored(path: Path, what: str) -> dict[str, float]:
    """Numbers of a file, by name. Raises ValueError where there is none."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        raise ValueError(
            f"{str(path)!r} was given; a file of {what} that --update has written is wanted"
        ) from None


def store(path: Path, numbers: Mapping[str, float]) -> None:
    write_file(path, json.dumps(numbers, indent=1) + "\n")


def grown(now: Mapping[str, float], before: Mapping[str, float], unit: str) -> list[str]:
    """A sentence on each number that has grown by more than `GROWTH`, and on names that only one of
    the two has.
    """
    said = [
        f"{name}: {number:.6g} {unit}, {number / (before[name] or 1) - 1:+.1%} of the "
        f"{before[name]:.6g} stored"
        for name, number in now.items()
        if name in before and not number <= before[name] * (1 + GROWTH)
    ]
    said += [f"{name}: found now, and not stored" for name in now if name not in before]
    return said + [f"{name}: stored, and not found any more" for name in before if name not in now]
