"""Output: what an environment gives back, as tensors or as NumPy's arrays."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
from torch import Tensor


def converted(value: Tensor | dict[str, Any], output: str, dtype: Any = np.float32) -> Any:
    """Tensors, or dictionaries of them, as they are for `output` "torch"; for "numpy" as copies
    without gradient, those of floating numbers in `dtype`.
    """
    if output == "torch":
        return value
    if isinstance(value, dict):
        return {name: converted(x, output, dtype) for name, x in value.items()}
    array = (value.detach() if value.requires_grad else value).cpu().numpy()
    return array.astype(dtype) if array.dtype.kind == "f" else array.copy()


def deprecated(sentence: str) -> None:
    """A DeprecationWarning at the innermost line that is neither torchbeam's nor
    Gymnasium's.
    """
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith(
        ("torchbeam", "gymnasium")
    ):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, DeprecationWarning, stacklevel=level)
