"""Which engine has made the steps of a run, and the warning where "auto" makes many of them
eagerly.
"""

from __future__ import annotations

from collections import Counter

from ..core.warning import SlowPathWarning, warn

SOLVES = 20  # made eagerly from which on it is said: fewer take less time than compiling
SHORT_RUNS = 200  # the same, of steppers that make fewer each, for one reason
SILENCED = (
    "(docs/compiled_engine.md has what native code takes; engine='eager', or "
    'warnings.filterwarnings("ignore", category=torchbeam.SlowPathWarning), silences this)'
)


def slow_path(what: str, reason: str) -> None:
    """The warning that steps or equilibria are made by torch operations where native code was to be
    expected.
    """
    warn(
        f"{what} eagerly, 15 to 300 times slower than by native code: {reason} {SILENCED}",
        SlowPathWarning,
    )


# solves made eagerly since the last word, by reason; no result depends on it
_of_short_runs: Counter[str] = Counter()


class EngineUse:
    """Solves of a step, or of a part of one, that each engine has made; one for all copies of a
    stepper.

    reason  why "auto" makes them eagerly, for the warning; None where that is meant, or needs no
            word
    """

    def __init__(self, reason: str | None = None) -> None:
        self.native = self.eager = 0
        self.reason = reason
        self._said = False

    def eagerly(self) -> None:
        """One more. Warns once, if there is a reason: when they are many, or were those of many
        steppers.
        """
        self.eager += 1
        if self.reason is None or self._said:
            return
        _of_short_runs[self.reason] += 1
        if self.eager >= SOLVES or _of_short_runs[self.reason] >= SHORT_RUNS:
            self._said = True
            del _of_short_runs[self.reason]
            slow_path("steps are made", self.reason)

    @property
    def engine(self) -> str | None:
        """ "native", "eager" or "mixed"; None before the first step."""
        if self.native and self.eager:
            return "mixed"
        return "native" if self.native else "eager" if self.eager else None
