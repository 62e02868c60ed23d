"""The house in numbers: how large it is, in how many files a word stands, what is long, and what it
is to become.
"""

from __future__ import annotations

import ast
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from torchbeam.extend.commands import table

from .harness import Report, Study

ROOT = Path(__file__).parents[1]
LARGEST = {"torchbeam": 55_000, "torchbeam/engine": 10_500, "studies": 9_500, "tests": 47_000}
WORDS = {"tendon": 8, "joint": 20, "order ==": 3}  # library files in which they stand
BASES, LINES, LENGTH = 3, 80, 400  # of a class, of a function, of a file: at most
FILLERS, EACH = ("own", "given", "one", "what"), 100
ABOUT = (
    "Lines of Python by folder. A word stands in a file of `torchbeam/` in any case. Bases of a "
    "class: those above it that are torchbeam's own. Names: functions, classes, arguments and "
    "variables that are called so, each time that they are bound."
)


class HouseNumber(NamedTuple):
    """A number, and what it is to be at most; the worst of those that are counted, and all."""

    what: str
    now: int
    aim: int
    worst: str = ""
    above: tuple[str, ...] = ()


@cache
def files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


@cache
def text(path: Path) -> str:
    return path.read_text()


def length(path: Path) -> int:
    return text(path).count("\n")


@cache
def nodes() -> list[tuple[Path, ast.AST]]:
    """Of the library's syntax trees, with their files."""
    return [(path, node) for path in files("torchbeam") for node in ast.walk(ast.parse(text(path)))]


def functions() -> dict[str, int]:
    """Lines by name."""
    return {
        f"{path.relative_to(ROOT)}: {node.name}": (node.end_lineno or 0) - node.lineno + 1
        for path, node in nodes()
        if isinstance(node, ast.FunctionDef)
    }


def bases() -> dict[str, int]:
    """Bases of torchbeam's own by class."""
    counts = {}
    for path, node in nodes():
        if not isinstance(node, ast.ClassDef):
            continue
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        if isinstance(kind := getattr(import_module(name), node.name, None), type):
            above = [base for base in kind.__mro__[1:] if base.__module__.startswith("torchbeam")]
            counts[f"{name}: {node.name}"] = len(above)
    return counts


def bound() -> Counter[str]:
    """How often something is called so."""
    names = Counter[str]()
    for _, node in nodes():
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names[node.name] += 1
        elif isinstance(node, ast.arg):
            names[node.arg] += 1
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names[node.id] += 1
    return names


def over(what: str, counts: dict[str, int], most: int) -> HouseNumber:
    """How many are above it, and which, the worst first."""
    names = sorted(counts, key=lambda name: -counts[name])
    above = tuple(f"{name} ({counts[name]})" for name in names if counts[name] > most)
    return HouseNumber(f"{what} {most}", len(above), 0, next(iter(above), ""), above)


def rows() -> Iterator[HouseNumber]:
    for folder, most in LARGEST.items():
        yield HouseNumber(f"lines of {folder}/", sum(map(length, files(folder))), most)
    for word, most in WORDS.items():
        count = sum(word in text(path).lower() for path in files("torchbeam"))
        yield HouseNumber(f"library files with `{word}`", count, most)
    yield over("classes whose bases are more than", bases(), BASES)
    yield over("functions whose lines are more than", functions(), LINES)
    lengths = {f"{path.relative_to(ROOT)}": length(path) for path in files("torchbeam")}
    yield over("files whose lines are more than", lengths, LENGTH)
    names = bound()
    for name in FILLERS:
        yield HouseNumber(f"names `{name}`", names[name], EACH)


def study(options: Namespace) -> Report:
    numbers = list(rows())
    shown: Callable[[int], str] = "{:,}".format
    lines = ((row.what, shown(row.now), shown(row.aim), row.worst) for row in numbers)
    parts = [ABOUT, table("what | now | at most | worst", lines, 1)]
    if options.all:
        each = [(row.what, name) for row in numbers for name in row.above]
        parts.append(table("what | which", each, 2))
    return Report(parts, [row._replace(above=()) for row in numbers])


main = Study(
    "house",
    "Size of the house: lines by folder, files with a word, long functions, files and lists of "
    "bases.",
    "Counts what the library is made of, beside what it is to become.",
    study,
    options={"--all": dict(action="store_true", help="name all that are above, not the worst")},
    out=False,
    dtype=None,
)
