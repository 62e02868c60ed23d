"""Output: what an environment gives back, as tensors or as NumPy's arrays."""

from __future__ import annotations

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
