"""A linear model elsewhere: as arrays in a file, and as a model of python-control's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import torch
from numpy.lib.format import write_array

from ..core import files
from ..core.validation import as_tensor, refusal, shown

LONGEST = 31  # letters of a name that every release of MATLAB reads


def labels(columns: Mapping[str, slice]) -> list[str]:
    """Of each input, as "u" or "u[2]"."""
    found = []
    for name, own in columns.items():
        size = own.stop - own.start
        found += [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
    return found


def array_of(name: str, value: Any) -> np.ndarray:
    """Of numbers. Raises ValueError for what are none, and for a name that no file can hold."""
    if not (name.isascii() and name.isidentifier()) or name[0] == "_" or len(name) > LONGEST:
        raise refusal(
            f"the name {shown(name)}", f"letters, digits and _, up to {LONGEST}, a letter first,"
        )
    dtype = value.dtype if isinstance(value, torch.Tensor) else torch.float64
    return as_tensor(value, dtype).detach().cpu().numpy()


def write(
    path: str | Path, arrays: Mapping[str, np.ndarray], names: Mapping[str, list[str]]
) -> Path:
    """Arrays and lists of names into a file .npz or .mat, whole or not at all. Raises ValueError
    for another ending or no such folder, ImportError for .mat without scipy, NotWritten.
    """
    path = files.file_of("path", path, ".npz", ".mat", of=" for a linear model")
    if path.suffix == ".mat":
        try:
            from scipy.io import savemat
        except ImportError:
            raise ImportError("a .mat file wants scipy: pip install 'torchbeam[control]'") from None
    files.folder(path.parent)
    with files.written(path, path.suffix) as part:
        if path.suffix == ".npz":
            labelled = {k: np.array(v, dtype=str) for k, v in names.items()}
            with ZipFile(part, "w") as archive:  # savez takes no array of the name "file"
                for name, array in {**arrays, **labelled}.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as content:
                        write_array(content, array, allow_pickle=False)
        else:
            cells = {k: np.array(v, dtype=object) for k, v in names.items()}
            savemat(part, {**arrays, **cells}, oned_as="column")
    return path


def state_space(A: Any, B: Any, C: Any, D: Any, dt: float | None, inputs: list[str]) -> Any:
    """control.StateSpace of matrices without batch axes. Raises ImportError without
    python-control.
    """
    try:
        from control import StateSpace
    except ImportError:
        raise ImportError(
            "to_control wants python-control: pip install 'torchbeam[control]'"
        ) from None
    matrices = [X.detach().cpu().double().numpy() for X in (A, B, C, D)]
    time = 0 if dt is None else dt
    return StateSpace(*matrices, time, inputs=inputs, remove_useless_states=False)
