"""The hard cases: one list, run by `python -m torchbeam hardcases` and by the tests."""

from . import dynamics, statics
from .case import Answer, Case, Result, run

MISSING = [
    Case("payload of 100 times the beam's mass", "the tip holds nearly all of the inertia", needs="a PointMass effect"),
    Case("root spun", "centrifugal and gyroscopic terms", needs="Frame or RootMotion in the nodal form"),
]
CASES = [*dynamics.CASES, *statics.CASES, *MISSING]


def main(argv: list[str]) -> int:
    """Run the hard cases and say what fails."""
    from .command import main as command

    return command(argv)


__all__ = ["CASES", "Answer", "Case", "Result", "main", "run"]
