"""Remembered: what pure functions of tensors have given for the last few arguments."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import Any, TypeVar

import torch
from torch import Tensor

from .derivatives import caches_of, lasting, untracked
from .leaves import STATIC, Tree, map_leaves

K, T = TypeVar("K"), TypeVar("T")
LARGE = 2**14  # numbers in the arguments, from which on looking costs what computing does
RECENT = 4  # values of a function, for arguments of one structure
STRUCTURES = 64  # of all functions; the one that was not asked for for longest goes first

_VALUES: dict[Hashable, tuple[tuple[list[Tensor], Any], ...]] = {}  # no result depends on it


def remembered(function: Callable[..., T], *arguments: Any) -> T:
    """function(*given), of trees, tensors and what is static, computed of copies of these; or what
    it gave for the same before: of the same structure, and with the same numbers to the bit. Values
    are shared, and not to be written to.

    Computed as it is where a derivative may be recorded, off the CPU, in torch.func, and for many
    numbers.
    """
    tensors: list[Tensor] = []
    key = function, *[structure_of(x, tensors) for x in arguments]
    if not few(tensors):
        return function(*arguments)
    try:
        recent = _VALUES.pop(key, ())  # other threads may ask too: at worst two of them compute it
    except TypeError:  # a part has no hash
        return function(*arguments)
    at = 0
    while at < len(recent) and not all(map(torch.equal, recent[at][0], tensors)):
        at += 1
    if at < len(recent):
        # the last one asked for is looked at first
        recent = recent[at], *recent[:at], *recent[at + 1 :]
    else:
        with lasting():
            copies, known = tuple(_copied(x, {}) for x in arguments), []
            for x in copies:
                structure_of(x, known)
            recent = (known, function(*copies)), *recent[: RECENT - 1]
    keep(_VALUES, key, recent, STRUCTURES)
    return recent[0][1]


def keep(entries: dict[K, T], key: K, value: T, most: int) -> T:
    """The value, as the last of at most so many entries. Other threads may do the same."""
    entries.pop(key, None)
    for oldest in [*entries][: max(0, len(entries) + 1 - most)]:
        entries.pop(oldest, None)
    entries[key] = value
    return value


def structure_of(
    x: Any, tensors: list[Tensor], known: dict[int, tuple[Hashable, Tree]] | None = None
) -> Hashable:
    """What is static in x, as something that can be a key; its tensors are added to those. Which
    trees are one object is part of it: walks that meet each once (`leaves_in_order`) give of two
    loads that are one another number of tensors than of two alike.
    """
    if isinstance(x, Tensor):
        tensors.append(x)
        return x.shape, x.dtype
    if type(x) in STATIC:
        return x
    known = {} if known is None else known
    if isinstance(x, Tree):
        if (again := known.get(id(x))) is not None:
            return again[0]
        known[id(x)] = (Tree, len(known)), x  # held, so that its id stays its own
        caches = caches_of(type(x))
        return type(x), *[
            value if type(value) in STATIC else structure_of(value, tensors, known)
            for name, value in [*vars(x).items()]
            if " " not in name and name not in caches
        ]
    if isinstance(x, (tuple, list)):
        return type(x), *[structure_of(value, tensors, known) for value in x]
    if isinstance(x, dict):
        return type(x), *[(name, structure_of(value, tensors, known)) for name, value in x.items()]
    return x


def _copied(x: Any, results: dict[int, Any]) -> Any:
    """With tensors of its own, also in tuples, lists and dictionaries."""
    if isinstance(x, Tensor):
        return x.detach().clone()
    if isinstance(x, (tuple, list)):
        parts = [_copied(part, results) for part in x]
        return type(x)(*parts) if hasattr(x, "_fields") else type(x)(parts)
    if isinstance(x, dict):
        return {name: _copied(part, results) for name, part in x.items()}
    return map_leaves(lambda value, axes: _copied(value, results), x, results=results)


def few(tensors: Iterable[Tensor]) -> bool:
    """Whether these are few numbers on the CPU, of which no derivative is recorded."""
    numbers = 0
    for x in tensors:
        if type(x) is not Tensor or not x.is_cpu:
            return False
        numbers += x.numel()
    return numbers <= LARGE and untracked(tensors)
