"""Numbers of the answers to every good public call, by the default dtype of torch that a process
has: `python -m tests.cases.answers float32 FILE` writes them.
"""

import dataclasses
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

import torchbeam as tb

# what times itself, and what is a picture
UNLIKE = ("advise", "converge", "plot.", "view", "render")


def numbers(value: Any, name: str = "", seen: tuple[int, ...] = ()) -> Iterator[tuple[str, Any]]:
    """(name, tensor) of all floating numbers in an answer."""
    if isinstance(value, tb.Solution):
        value = {"state": value.state, "energy": value.energy, "stats": value.stats}
    if isinstance(value, np.ndarray | np.floating) and value.dtype.kind == "f":
        value = torch.as_tensor(np.asarray(value))
    if isinstance(value, torch.Tensor):
        if value.is_floating_point() or value.is_complex():
            yield name, value.detach().clone()
    elif isinstance(value, float):
        yield name, torch.tensor(value, dtype=torch.float64)
    elif id(value) in seen or (callable(value) and not hasattr(value, "__dict__")):
        return
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from numbers(part, f"{name}[{key}]", (*seen, id(value)))
    elif isinstance(value, tuple | list):
        for k, part in enumerate(value):
            yield from numbers(part, f"{name}[{k}]", (*seen, id(value)))
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            part = getattr(value, field.name, None)
            yield from numbers(part, f"{name}.{field.name}", (*seen, id(value)))


def answers() -> dict[str, dict[str, torch.Tensor] | str]:
    """Of every call of the table."""
    from tests.cases.public_calls_of_results import EVERY

    found = {}
    for call, (function, given) in EVERY.items():
        if any(word in call for word in UNLIKE):
            continue
        torch.manual_seed(0)
        try:
            found[call] = dict(numbers(function(**given)))
        except Exception as error:
            found[call] = f"{type(error).__name__}: {error}"
    return found


if __name__ == "__main__":
    torch.set_default_dtype(getattr(torch, sys.argv[1]))
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    torch.save(answers(), sys.argv[2])
