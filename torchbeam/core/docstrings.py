"""Docstrings that share what they say of arguments."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TypeVar

Function = TypeVar("Function", bound=Callable)
ARGUMENTS = "\nArgs:\n"


def with_arguments_of(*records: type) -> Callable[[Function], Function]:
    """A decorator: what the docstrings of `records` say under `Args:` stands behind what the
    function's own says there, so that `help` tells of all its arguments.
    """

    def completed(function: Function) -> Function:
        for record in records:
            function.__doc__ = with_entries(function.__doc__, record.__doc__)
        return function

    return completed


def with_entries(docstring: str | None, other: str | None) -> str:
    """A docstring with the entries under `Args:` of another one behind its own."""
    head, entries, rest = _split(docstring)
    return f"{head}{entries}\n{_split(other)[1]}{rest}"


def _split(docstring: str | None) -> tuple[str, str, str]:
    """What stands before the entries of arguments, these, and what stands behind."""
    head, title, rest = inspect.cleandoc(docstring or "").partition(ARGUMENTS)
    entries, gap, rest = rest.partition("\n\n")
    return head + title, entries, gap + rest
