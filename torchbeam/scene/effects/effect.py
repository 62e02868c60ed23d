"""Effects of whatever kind."""

from __future__ import annotations

from typing import Any

from ...core.tree import FunctionOfTime, Tree
from .load_point import LoadEffect

Effect = LoadEffect


def of_library(effect: Any) -> bool:
    """Whether an effect's class is torchbeam's own, and those of what it holds, as an obstacle."""
    return all([is_own(part) for part in parts_of(effect)])


def is_own(part: Any) -> bool:
    """Whether its class is torchbeam's own, whatever it holds."""
    return type(part).__module__.partition(".")[0] == __name__.partition(".")[0]


def parts_of(effect: Any) -> list[Any]:
    """An effect and the trees that it holds, but those of t alone, which are asked in torch."""
    trees = [x for x in vars(effect).values() if isinstance(x, Tree)]
    held = [x for x in trees if not isinstance(x, FunctionOfTime)]
    return [effect, *(part for tree in held for part in parts_of(tree))]
