"""A linear model elsewhere: as arrays in a file, and as a model of python-control's."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import torch
from numpy.lib.format import write_array
from torch import Tensor

from ..core import files
from ..core.validation import as_tensor, refusal, shown
from ..nodal.coordinates.spatial import Spatial

SEVERAL = re.compile(r"(.+)\[\d+\]", re.DOTALL)
LONGEST = 31  # letters of a name that every release of MATLAB reads


def labels(columns: Mapping[str, slice]) -> list[str]:
    """Of each input, as "u" or "u[2]"."""
    found = []
    for name, place in columns.items():
        size = place.stop - place.start
        found += [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
    return found


def columns_of(labelled: Sequence[str]) -> dict[str, slice]:
    """The columns of inputs, by their `labels`."""
    columns: dict[str, slice] = {}
    for k, label in enumerate(labelled):
        several = SEVERAL.fullmatch(label)
        name = several[1] if several else label
        columns[name] = slice(columns[name].start if name in columns else k, k + 1)
    return columns


def labels_of_readings(sensors: Sequence[Any], rows: Sequence[slice]) -> tuple[str, ...]:
    """Of each number, as "tip position z"; with its place where several are alike, as those of a
    function, "y[2]".
    """
    names: list[str] = []
    for sensor, place in zip(sensors, rows, strict=True):
        known, size = getattr(sensor, "labels", None), place.stop - place.start
        known = known if isinstance(known, tuple) and len(known) == size else ()
        # labels of a stack have its sensors' names
        prefix = [sensor.name] if known and not hasattr(sensor, "sensors") else []
        names += [" ".join((*prefix, label)) for label in known] or ["y"] * size
    alike = {name for name, times in Counter(names).items() if times > 1} | {"y"}
    return tuple(f"{name}[{k}]" if name in alike else name for k, name in enumerate(names))


def labels_of_states(reads: Tensor, space: Spatial, nodes: int) -> list[str]:
    """Of each state that is one move of one of the nodes, or its rate, see `Linear.to_control`."""
    axes = space.plane or "xyz"
    turns = [f"turn {axis}" for axis in axes] if space.dims.spin == 3 else ["turn"]
    moves = [f"node {k} {move}" for k in range(nodes) for move in (*axes, *turns)]
    moves += [f"{move} rate" for move in moves]
    single = ((reads != 0).sum(-1) == 1) & (reads[:, : len(moves)] == 1).any(-1)
    at = reads[:, : len(moves)].argmax(-1).tolist()
    return [moves[at[k]] if known else f"z[{k}]" for k, known in enumerate(single.tolist())]


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
    savemat = _scipy().savemat if path.suffix == ".mat" else None
    files.folder(path.parent)
    with files.written(path, path.suffix) as part:
        if savemat is None:
            labelled = {k: np.array(v, dtype=str) for k, v in names.items()}
            with ZipFile(part, "w") as archive:  # savez takes no array of the name "file"
                for name, array in {**arrays, **labelled}.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as content:
                        write_array(content, array, allow_pickle=False)
        else:
            cells = {k: np.array(v, dtype=object) for k, v in names.items()}
            savemat(part, {**arrays, **cells}, oned_as="column")
    return path


def read(
    path: str | Path, needed: Sequence[str], names: Sequence[str]
) -> tuple[dict[str, Tensor], dict[str, list[str]]]:
    """Arrays, among them the `needed`, and the lists of these names of a file that `write` wrote;
    in a .mat file arrays have two axes at least. It runs no code of the file's. Raises ValueError
    for another file, ImportError for .mat without scipy.
    """
    path = files.file_of("path", path, ".npz", ".mat", of=" for a linear model")
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                content = dict(file)
        else:
            content = _scipy().loadmat(path)
            content = {name: x for name, x in content.items() if not name.startswith("__")}
            content |= {name: [cell[0] for cell in content[name].ravel()] for name in names}
        lists = {name: [str(x) for x in content.pop(name)] for name in names}
        arrays = {name: torch.from_numpy(np.array(x, order="C")) for name, x in content.items()}
        _fit(arrays, *lists.values())
        return {name: arrays.pop(name) for name in needed} | arrays, lists
    except ImportError:
        raise
    except OSError as error:
        sentence = f"which cannot be read ({files.reason(error)})"
    except Exception:  # of another file numpy and scipy may raise anything
        sentence = "which is no linear model of this version"
    raise ValueError(
        f"the file {str(path)!r} was given, {sentence}; one that Linear.save wrote is wanted"
    )


def _fit(arrays: Mapping[str, Tensor], inputs: list[str], readings: list[str]) -> None:
    """Raises for arrays that belong to no linear model, of whatever kind."""
    n, m, p = arrays["A"].shape[-1], len(inputs), len(readings)
    dt, arms = (arrays[name].item() for name in ("dt", "arms"))
    q = (n - arms) / 2
    sizes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m), "M": (q, q)}
    matrices = {name: arrays[name] for name in sizes if name in arrays}
    torch.broadcast_shapes(*(x.shape[:-2] for x in matrices.values()))
    fits = [tuple(x.shape[-2:]) == sizes[name] for name, x in matrices.items()]
    fits += [bool(x.isfinite().all()) for x in matrices.values()]
    reads, output, C = arrays["reads"], arrays["output"], arrays["C"]
    fits += [reads.shape[-2] == n, output.numel() == C[..., :1].numel()]
    kinds = {x.dtype for x in (*matrices.values(), reads, output)}
    fits += [dt >= 0, 0 <= arms <= n, len(kinds) == 1, C.is_floating_point()]
    if not all(fits):
        raise ValueError


def _scipy() -> Any:
    """scipy.io. Raises ImportError without scipy."""
    try:
        import scipy.io
    except ImportError:
        raise ImportError("a .mat file wants scipy: pip install 'torchbeam[control]'") from None
    return scipy.io


def state_space(
    system: Sequence[Tensor],
    dt: float | None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    states: Sequence[str],
) -> Any:
    """control.StateSpace of A, B, C, D without batch axes, by names, in which python-control takes
    no point. Raises ImportError without python-control.
    """
    try:
        from control import StateSpace
    except ImportError:
        raise ImportError(
            "to_control wants python-control: pip install 'torchbeam[control]'"
        ) from None
    matrices = [X.detach().cpu().double().numpy() for X in system]
    names = dict(inputs=inputs, outputs=outputs, states=states)
    names = {of: [x.replace(".", ",") for x in words] or None for of, words in names.items()}
    return StateSpace(*matrices, 0 if dt is None else dt, **names, remove_useless_states=False)
