"""python -m torchbeam: commands found by entry point.

A command is a function that takes the rest of the command line as a list and returns an exit status
or None; the first line of its docstring describes it. A package adds one in its pyproject.toml:

    [project.entry-points."torchbeam.commands"]
    demo = "torchbeam_envs.demo:main"

So torchbeam imports nothing of the packages that are built on it.
"""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import torch

from .analysis.describe import describe
from .core.files import NotWritten, folder
from .core.results import measured_on, versions

GROUP = "torchbeam.commands"


def main(argv: Sequence[str] | None = None) -> int:
    """The command line `argv` (default: the process's); returns the exit status."""
    argv = list(sys.argv[1:] if argv is None else argv)
    available = commands()
    if argv and argv[0] in available:
        try:
            return available[argv[0]].load()(argv[1:]) or 0
        except NotWritten as error:
            print(f"python -m torchbeam {argv[0]}: error: {error}", file=sys.stderr)
            return 2
    parser = argparse.ArgumentParser(
        prog="python -m torchbeam",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Batched, differentiable, geometrically exact beam dynamics.",
        epilog=_listing(available) if set(argv) & {"-h", "--help"} or not argv else None,
    )
    parser.add_argument(
        "--version", action="version", version=f"torchbeam {versions('torchbeam')['torchbeam']}"
    )
    parser.add_argument(
        "command", choices=sorted(available), help="what to do; `COMMAND --help` says more"
    )
    if not argv:
        parser.print_help()
        return 0
    parser.parse_args(argv[:1])
    return 0


def commands() -> dict[str, EntryPoint]:
    """Every installed command, by name; `info` is there even where torchbeam runs without being
    installed.
    """
    here = {"info": EntryPoint("info", "torchbeam.cli:info", GROUP)}
    return {**here, **{entry.name: entry for entry in entry_points(group=GROUP)}}


def info(argv: Sequence[str]) -> None:
    """Versions, precision and threads: what a bug report should say; or what a scene has and
    needs.
    """
    parser = argparse.ArgumentParser(prog="python -m torchbeam info", description=info.__doc__)
    parser.add_argument(
        "scene",
        nargs="?",
        metavar="SCENE.py",
        help="a Python file: its `scene` is described, or else each Scene in it",
    )
    given = parser.parse_args(argv).scene
    if given is not None:
        return _described(given, parser)
    facts = measured_on(dtype=None)
    facts |= {
        **facts.pop("versions"),
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


def results_folder(
    parser: argparse.ArgumentParser, path: str | Path, option: str = "--out"
) -> Path:
    """The folder for a command's results, made with those it lies in; called before any work is
    begun, it ends the command with a sentence, which names the option, and the status 2 where
    nothing can be written there.
    """
    try:
        return folder(path, parents=True)
    except ValueError as error:
        parser.error(f"{option}: {error}")


def study(
    argv: Sequence[str] | None,
    name: str,
    description: str,
    quick: str,
    more: Callable[[argparse.ArgumentParser], Any] | None = None,
    instead: str | None = None,
) -> tuple[argparse.Namespace, Path]:
    """Options of a command that writes NAME.csv, NAME.md and NAME.json, --out, --quick and those
    that `more` adds, and the folder for its results; where the option `instead` is given, a file
    that is written in place of these, the folder of that.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m torchbeam {name}",
        description=(
            f"{description} Writes {name}.csv, {name}.md and {name}.json (with machine and "
            "versions)."
        ),
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out") / name,
        help="folder for the results (default: %(default)s)",
    )
    parser.add_argument("--quick", action="store_true", help=quick)
    if more is not None:
        more(parser)
    given = parser.parse_args(argv)
    if instead is not None and (file := getattr(given, instead)) is not None:
        return given, results_folder(parser, file.parent, f"--{instead}")
    return given, results_folder(parser, given.out)


@contextmanager
def double_precision() -> Iterator[None]:
    """float64 by default within it."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many threads of torch, and as many as before afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _listing(available: dict[str, EntryPoint]) -> str:
    width = max(map(len, available))
    lines = []
    for name in sorted(available):
        try:
            text = (available[name].load().__doc__ or "").strip().splitlines() or [""]
        except (ImportError, AttributeError) as error:
            text = [f"cannot be loaded: {error}"]
        lines.append(f"  {name:<{width}}  {text[0]}")
    return "commands:\n" + "\n".join(lines)
