"""Effects of whatever kind."""

from __future__ import annotations

from typing import Any

from .load_point import LoadEffect

Effect = LoadEffect


def of_library(effect: Any) -> bool:
    """Whether an effect's class is torchbeam's own."""
    return type(effect).__module__.startswith(f"{__package__}.")
