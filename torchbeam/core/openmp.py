"""OpenMP, by which torch divides its operations."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch


@cache
def openmp() -> ctypes.CDLL | None:
    """The library that torch has loaded; None where it has none that is called so."""
    if "OpenMP" not in torch.__config__.parallel_info():
        return None
    try:
        [path] = (Path(torch.__file__).parent / "lib").glob("libtorch_cpu.so")
        library = ctypes.CDLL(str(path))  # finds what is in the libraries that it needs, as well
    except (ValueError, OSError):
        return None
    return library if hasattr(library, "omp_set_num_threads") else None
