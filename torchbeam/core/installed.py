"""Installed packages: which of them a function, class or module belongs to, and in what version it
is there.
"""

from __future__ import annotations

import builtins
import functools
import os
import sys
import types
from importlib.metadata import PackageNotFoundError, version
from typing import Any

FOLDERS = {"site-packages", "dist-packages"}  # that installed packages lie in
HERE = __name__.split(".")[0]
PYTHON = "python"
HEAP_TYPE = 1 << 9  # of a class's flags: made while Python ran (Include/object.h)


def package(value: Any) -> str | None:
    """Name of the installed package that a module, class or function belongs to, "python" for
    Python's own; None where it belongs to none: its code may change while versions stay.
    """
    name = (
        value.__name__
        if isinstance(value, types.ModuleType)
        else getattr(value, "__module__", None)
    )
    # written by a user, in a namespace without a name
    if name in (None, builtins.__name__) and (
        isinstance(value, types.FunctionType)
        or (isinstance(value, type) and value.__flags__ & HEAP_TYPE)
    ):
        return None
    if not isinstance(name, str):  # of what is built in: that of its type
        owner = next(
            (
                o
                for o in (getattr(value, a, None) for a in ("__self__", "__objclass__"))
                if o is not None
            ),
            value,
        )
        named = owner if isinstance(owner, (type, types.ModuleType)) else type(owner)
        name = str(named.__name__ if isinstance(named, types.ModuleType) else named.__module__)
    top = name.split(".")[0]
    if top == builtins.__name__ or (top in sys.stdlib_module_names and top != "__main__"):
        return PYTHON
    return top if top == HERE or FOLDERS & _folders(_file(top)) else None


def version_of(name: str) -> str:
    """Of an installed package; of Python its minor version, which bytecode is of."""
    if name == PYTHON:
        return "{}.{}".format(*sys.version_info)
    try:
        return version(name).split("+")[0]
    except PackageNotFoundError:
        return str(getattr(sys.modules.get(name), "__version__", "unknown"))


@functools.lru_cache(1024)
def _folders(file: str) -> set[str]:
    """That it lies in, also by links."""
    return {*file.split(os.sep), *os.path.realpath(file).split(os.sep)}


def _file(top: str) -> str:
    module = sys.modules.get(top)
    return str(getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), ""))
