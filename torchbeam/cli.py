"""python -m torchbeam: commands found by entry point.

A package adds a command (see `torchbeam.core.command_line.run_command`) in its pyproject.toml:

    [project.entry-points."torchbeam.commands"]
    demo = "torchbeam_envs.demo:main"

So torchbeam imports nothing of the packages that are built on it.
"""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import torch

from .analysis.describe import describe
from .core.command_line import run_command
from .core.results import measured_on, versions

GROUP = "torchbeam.commands"
STUDIES = (  # commands of before, which `python -m studies` has
    "accuracy", "bench", "control", "convergence", "coverage", "effects", "gradients", "hardcases",
    "identification", "oracle", "peers", "rates", "scale", "verify",
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The command line `argv` (default: the process's); returns the exit status."""
    name = next(iter(sys.argv[1:] if argv is None else argv), None)
    available = commands()
    if name in STUDIES and name not in available:
        print(
            f"python -m torchbeam {name}: error: {name} is a study; `python -m studies {name}` in "
            "a clone of the source is wanted",
            file=sys.stderr,
        )
        return 2
    return run_command(
        "python -m torchbeam",
        "Batched, differentiable, geometrically exact beam dynamics: a library for Python.\n"
        "Begin with `import torchbeam as tb`, the examples of a clone, or `demo` below.",
        available,
        argv,
    )


def commands() -> dict[str, EntryPoint]:
    """Every installed command, by name; `info` even where torchbeam is not installed."""
    here = {"info": EntryPoint("info", "torchbeam.cli:info", GROUP)}
    return {**here, **{entry.name: entry for entry in entry_points(group=GROUP)}}


def info(argv: Sequence[str]) -> None:
    """Print versions, precision, threads for a bug report; or describe the scenes of a file."""
    parser = argparse.ArgumentParser(prog="python -m torchbeam info", description=info.__doc__)
    parser.add_argument(
        "scene",
        nargs="?",
        metavar="SCENE.py",
        help="a Python file: its `scene` is described, or else each Scene in it",
    )
    path = parser.parse_args(argv).scene
    if path is not None:
        return _described(path, parser)
    facts = measured_on(dtype=None)
    facts |= {
        **facts.pop("versions"),
        **versions("llvmlite", "scipy"),
        "default dtype": torch.get_default_dtype(),
        "cuda": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
    }
    width = max(map(len, facts))
    for name, value in facts.items():
        print(f"{name:<{width}}  {value}")


def _described(path: str, parser: argparse.ArgumentParser) -> None:
    """Print the descriptions of the scenes in a Python file."""
    from .scene.scene import Scene

    if not Path(path).is_file():
        parser.error(f"{path} was given; a Python file with a torchbeam.Scene in it is wanted")
    scenes = {
        name: value for name, value in runpy.run_path(path).items() if isinstance(value, Scene)
    }
    if not scenes:
        parser.error(
            f"{path} without a torchbeam.Scene was given; one called `scene` is wanted, or some "
            "of other names"
        )
    if "scene" in scenes:
        scenes = {"scene": scenes["scene"]}
    for name, scene in scenes.items():
        try:
            print(f"{name}:\n{describe(scene)}\n")
        except ValueError as error:
            parser.error(f"{name}: {error}")
