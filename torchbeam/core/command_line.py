"""Command lines: commands by name, the folder for results, threads."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint
from pathlib import Path
from textwrap import fill

import torch

from .files import NotWritten, folder
from .results import versions


def run_command(
    program: str, about: str, commands: Mapping[str, EntryPoint], argv: Sequence[str] | None = None
) -> int:
    """The command that `argv` (default: the process's) names; returns the exit status.

    A command is a function that takes the rest of the command line as a list and returns an exit
    status or None; the first paragraph of its docstring describes it.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv and argv[0] in commands:
        try:
            return commands[argv[0]].load()(argv[1:]) or 0
        except NotWritten as error:
            print(f"{program} {argv[0]}: error: {error}", file=sys.stderr)
            return 2
    parser = argparse.ArgumentParser(
        prog=program,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description=about,
        epilog=_listing(commands) if set(argv) & {"-h", "--help"} or not argv else None,
    )
    parser.add_argument(
        "--version", action="version", version=f"torchbeam {versions('torchbeam')['torchbeam']}"
    )
    parser.add_argument(
        "command",
        choices=sorted(commands),
        metavar="COMMAND",
        help="a command of the list below; `COMMAND --help` lists its options",
    )
    if not argv:
        parser.print_help()
        return 0
    parser.parse_args(argv[:1])
    return 0


def _listing(commands: Mapping[str, EntryPoint]) -> str:
    width = max(map(len, commands))
    lines = []
    for name in sorted(commands):
        try:
            text = (commands[name].load().__doc__ or "").strip().split("\n\n")[0]
        except (ImportError, AttributeError) as error:
            text = f"cannot be loaded: {error}"
        indents = dict(initial_indent=f"  {name:<{width}}  ", subsequent_indent=" " * (width + 4))
        lines.append(fill(" ".join(text.split()), 100, **indents))
    return "commands:\n" + "\n".join(lines)


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


@contextmanager
def threads(count: int) -> Iterator[None]:
    """So many threads of torch, and as many as before afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
