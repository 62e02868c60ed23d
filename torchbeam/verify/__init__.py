"""Verification: what is known from elsewhere against what comes out here; run by `python -m torchbeam verify` and the tests."""

from . import motion, rotating, stability, statics
from .case import Case, Result, run

CASES = [*statics.CASES, *stability.CASES, *motion.CASES, *rotating.CASES]


def main(argv: list[str]) -> int:
    """Compute every case that is known from elsewhere, and compare."""
    from .command import main as command

    return command(argv)


__all__ = ["CASES", "Case", "Result", "main", "run"]
