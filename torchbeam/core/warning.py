"""Warnings that point to the user's line."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from types import FrameType

import torch

# beginnings of the paths of their files
PACKAGE, TORCH = (
    f"{folder}{os.sep}" for folder in (Path(__file__).parents[1], Path(torch.__file__).parent)
)


class SlowPathWarning(UserWarning):
    """Steps or equilibria are made by eager torch operations, 15 to 300 times slower, where native
    code was to be expected.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter(
        ...     "error", tb.SlowPathWarning
        ... )  # an eager step is a mistake here
    """


def warn(sentence: str, category: type[Warning] = RuntimeWarning) -> None:
    """Warns of `sentence` at the innermost line that is neither torchbeam's own nor torch's."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and _file(frame).startswith((PACKAGE, TORCH)):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, category, stacklevel=level)


def _file(frame: FrameType) -> str:
    """Of its module: what a dataclass writes itself has a code of no file."""
    return frame.f_globals.get("__file__") or frame.f_code.co_filename
