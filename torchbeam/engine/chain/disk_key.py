"""Programs on disk: what calls need of one that another process has traced, by a key of its
structure.

The key is made of the structure, of torchbeam's own source, and of the versions of torch and
Python: whatever a trace depends on. The layout is kept as JSON beside the object code.
"""

from __future__ import annotations

import json
import platform
import time
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import torch
from torch import Tensor

from ...core.derivatives import cache_of
from ...core.leaves import Tree, map_leaves
from ...nodal.coordinates.planar import Planar
from ..compiler.object_cache import ObjectCache, key_of
from .kinds import Kinds
from .layout import Layout
from .local_functions import LocalFunctions

PACKAGE = Path(__file__).parents[2]
PLAIN = (str, int, float, bool, type(None), torch.dtype)
IMPORTED = time.time()


def structure(local: LocalFunctions, kinds: Kinds, held: bool) -> tuple:
    """What the program of a step depends on; never the values of tensors, nor how many elements
    there are.
    """
    model = local.model
    space = model.space
    plane = (space.name, space.section_axes) if isinstance(space, Planar) else None
    return (
        type(local),
        local.options,
        type(space),
        space.order,
        plane,
        model.length.dtype,
        model.scene.beam.offset,
        bool(model.scene.loads),
        model.touching.present,
        model.has_friction,
        local.searches,
        kinds,
        held,
        *(_static(_shapes(tree, kind != "common")) for kind, tree in local.trees.by_record.items()),
    )


def _shapes(tree: Any, rows: int) -> Any:
    return map_leaves(
        lambda x, axes: x.shape[x.ndim - axes + rows :] if isinstance(x, Tensor) else x, tree
    )


def _static(x: Any, known: dict[int, int] | None = None) -> Any:
    """What a tree holds, as something that can be a key; known: trees by id, by their numbers: what
    of it is one object is part of it, whose tensors `flattened` gives once.
    """
    known = {} if known is None else known
    if isinstance(x, Tree):
        if id(x) in known:
            return "again", known[id(x)]
        known[id(x)] = len(known)
        return type(x), tuple(
            (name, value is None if name == "node" else _static(value, known))
            for name, value in vars(x).items()
            if not cache_of(x, name)
        )
    if isinstance(x, dict):
        return tuple((name, _static(value, known)) for name, value in x.items())
    if isinstance(x, FunctionType):
        return x.__code__  # what it reads beside its arguments is in `Dependencies.key`
    if callable(x) and not isinstance(x, type):
        return type(x)
    return tuple([_static(part, known) for part in x]) if isinstance(x, (tuple, list)) else x


def key_on_disk(structure: tuple) -> str | None:
    """None where a structure holds what may be another thing in another process: classes that a
    user wrote, functions.
    """
    source, words = source_key(), _words(structure)
    if source is None or words is None:
        return None
    return key_of(words, source, torch.__version__, platform.python_version())


def _words(x: Any) -> str | None:
    if isinstance(x, type):
        return (
            f"{x.__module__}.{x.__qualname__}"
            if x.__module__.startswith(f"{PACKAGE.name}.")
            else None
        )
    if isinstance(x, tuple):
        parts = [_words(part) for part in x]
        return None if None in parts else f"({', '.join(parts)})"
    return repr(x) if isinstance(x, PLAIN) else None


@cache
def source_key() -> str | None:
    """Of the package's source; None where it cannot be read, or was written to since it was
    imported.
    """
    try:
        files = sorted(PACKAGE.rglob("*.py"))
        if any(file.stat().st_mtime > IMPORTED for file in files):
            return None
        return key_of(
            *(
                part
                for file in files
                for part in (str(file.relative_to(PACKAGE)), file.read_bytes())
            )
        )
    except OSError:
        return None


def store_layout(key: str, layout: Layout) -> None:
    ObjectCache().put(key_of(key, "layout"), json.dumps(layout.numbers()).encode())


def stored_layout(key: str) -> Layout | None:
    """None where there is none."""
    data = ObjectCache().get(key_of(key, "layout"))
    try:
        return None if data is None else Layout.of(json.loads(data))
    except (ValueError, TypeError):
        return None
