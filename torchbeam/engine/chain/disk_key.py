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
from typing import Any

import torch

from ..compiler.object_cache import ObjectCache, key_of
from .layout import Layout

PACKAGE = Path(__file__).parents[2]
PLAIN = (str, int, float, bool, type(None), torch.dtype)
IMPORTED = time.time()


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
