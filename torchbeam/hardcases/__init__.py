"""The hard cases: one list, run by `python -m torchbeam hardcases` and by the tests."""

from . import dynamics, held, statics
from .case import Answer, Case, Result, run

CASES = [*dynamics.CASES, *held.CASES, *statics.CASES]


def main(argv: list[str]) -> int:
    """Run the hard cases and say what fails."""
    from .command import main as command

    return command(argv)


__all__ = ["CASES", "Answer", "Case", "Result", "main", "run"]
