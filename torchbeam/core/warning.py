"""Warnings that point to the user's line."""

from __future__ import annotations

import sys
import warnings

# whose lines are no user's: modules' first names
OWN = frozenset({"torchbeam", "torchbeam_envs", "torch", "gymnasium"})


class SlowPathWarning(UserWarning):
    """Steps or equilibria are made by eager torch operations, 15 to 300 times slower, where native
    code was to be expected.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", tb.SlowPathWarning)  # an eager step is a mistake here
    """


def goes(name: str, instead: str) -> None:
    """Warns of a public name that is deprecated; instead: what is to be written."""
    warn(f"{name} goes in the next minor version: {instead}", DeprecationWarning)


def warn(sentence: str, category: type[Warning] = RuntimeWarning) -> None:
    """Warns of `sentence` at the innermost line that is neither torchbeam's own, its environments',
    Gymnasium's nor torch's.

    Examples:
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as seen:
        ...     extend.warn("the beam is slack")
        >>> str(seen[0].message)
        'the beam is slack'
    """
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and (
        str(frame.f_globals.get("__name__")).partition(".")[0] in OWN
    ):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, category, stacklevel=level)
