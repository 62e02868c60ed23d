"""Effects of whatever kind."""

from __future__ import annotations

from typing import Any

from ...core.tree import Tree
from .load_point import LoadEffect

Effect = LoadEffect


def of_library(effect: Any) -> bool:
    """Whether the classes of an effect, and of the obstacle that it holds, are torchbeam's."""
    return all([is_own(part) for part in parts_of(effect)])


def is_own(part: Any) -> bool:
    """Whether its class is torchbeam's own, whatever it holds."""
    return type(part).__module__.partition(".")[0] == __name__.partition(".")[0]


def parts_of(effect: Any) -> list[Any]:
    """An effect and the trees that it holds."""
    held = [value for value in vars(effect).values() if isinstance(value, Tree)]
    return [effect, *(part for tree in held for part in parts_of(tree))]
