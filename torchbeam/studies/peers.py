"""Other programs, by the scripts of a folder: each prints what it has measured, one JSON object a
line.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def options(parser: argparse.ArgumentParser) -> None:
    """Adds --peers, a folder of scripts, and --python, the interpreter for these."""
    parser.add_argument(
        "--peers",
        type=_folder,
        metavar="FOLDER",
        help="also run the scripts of a folder that measure other programs: examples/peers",
    )
    parser.add_argument(
        "--python",
        type=_interpreter,
        default=sys.executable,
        help="the interpreter for these (default: this one)",
    )


def scripts(folder: Path) -> list[Path]:
    """The scripts of a folder; ValueError where there are none."""
    paths = [path for path in sorted(folder.glob("*.py")) if "__main__" in path.read_text()]
    if not paths:
        raise ValueError(
            f"the folder {str(folder)!r} was given; one with scripts, as examples/peers is, is "
            "wanted"
        )
    return paths


def measured(folder: Path, python: str, *options: str) -> Iterator[dict[str, Any]]:
    """What the scripts of a folder print, each by `python` with --json and the options, and on one
    thread; those of packages that are not installed are left out, and named. Raises ValueError for
    a folder without scripts.
    """
    for path in scripts(folder):
        done = subprocess.run(
            [python, str(path), "--json", *options],
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        if done.returncode:
            why = done.stderr.strip().splitlines()
            print(
                f"{path.name} is left out: {why[-1] if why else f'exit status {done.returncode}'}",
                file=sys.stderr,
            )
            continue
        yield from map(
            json.loads, filter(lambda line: line.startswith("{"), done.stdout.splitlines())
        )


def _folder(given: str) -> Path:
    try:
        scripts(Path(given))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(given)


def _interpreter(given: str) -> str:
    if shutil.which(given) is None:
        raise argparse.ArgumentTypeError(f"{given!r} was given; a Python interpreter is wanted")
    return given
