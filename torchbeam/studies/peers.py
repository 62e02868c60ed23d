"""Other programs, by the scripts of a folder: each prints what it has measured, one JSON object a line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def measured(folder: Path, python: str, *options: str) -> Iterator[dict[str, Any]]:
    """What the scripts of a folder print, each by `python` with --json and the options, and on one thread; those of packages
    that are not installed are left out, and named. Raises ValueError for a folder without scripts.
    """
    scripts = [path for path in sorted(folder.glob("*.py")) if "__main__" in path.read_text()]
    if not scripts:
        raise ValueError(f"the folder {str(folder)!r} was given; one with scripts, as examples/peers is, is wanted")
    for path in scripts:
        done = subprocess.run([python, str(path), "--json", *options], capture_output=True, text=True,
                              env={**os.environ, "OMP_NUM_THREADS": "1"})
        if done.returncode:
            why = done.stderr.strip().splitlines()
            print(f"{path.name} is left out: {why[-1] if why else f'exit status {done.returncode}'}", file=sys.stderr)
            continue
        yield from map(json.loads, filter(lambda line: line.startswith("{"), done.stdout.splitlines()))
