"""Options that the command lines here share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from .tuned import TASKS, Task, task_named


def add_task(
    parser: argparse.ArgumentParser, default: str | None = "reach", instead: str = "%(default)s"
) -> None:
    """The option --task, whose value is a `Task`; `instead` says what holds without it."""

    def task(name: str) -> Task:
        try:
            return task_named(name)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    parser.add_argument(
        "--task",
        type=task,
        default=default,
        metavar="TASK",
        help=f"{', '.join(TASKS)}, or MODULE:NAME, a training.tuned.Task of one's own "
        f"(default: {instead})",
    )


def add_budget(parser: argparse.ArgumentParser) -> None:
    """The options --budget and --minutes, for `common.budget_given`."""
    parser.add_argument(
        "--budget",
        type=above_zero(int),
        help="environment steps (default: those of the study, training/tuned.py, or without bound "
        "where --minutes is given)",
    )
    parser.add_argument(
        "--minutes",
        type=above_zero(float),
        help="end after so many CPU minutes of training at the latest",
    )


def above_zero(kind: type) -> Callable[[str], Any]:
    """The type of an option that is a number above 0."""

    def number(text: str) -> Any:
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} was given; a number above 0 is wanted")
        return value

    number.__name__ = kind.__name__  # in what argparse says of other texts
    return number
