"""Results on their way from one process to another: bytes, in which tensors are arrays.

Between processes of one machine torch itself sends a file descriptor for each tensor, by a
connection of its own, and both ends keep it open as long as the tensor lives: a run of some hundred
chunks would have more open files than a process may have.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

import torch
from torch import Tensor


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        # which NumPy has not: torch's own, slower, bytes
        if isinstance(obj, Tensor) and obj.dtype is not torch.bfloat16:
            return torch.from_numpy, (obj.numpy(),)
        return NotImplemented


def packed(result: Any) -> bytes:
    """Bytes of what holds tensors on the CPU, without gradients."""
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(result)
    return file.getvalue()


def unpacked(result: Any) -> Any:
    """What was packed, or the result itself where it was not: one of this process."""
    return pickle.loads(result) if isinstance(result, bytes) else result
