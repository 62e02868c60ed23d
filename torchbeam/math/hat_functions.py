"""Hat functions: linear interpolation in a table as a sum, without a look-up."""

from __future__ import annotations

import torch
from torch import Tensor


def hats(x: Tensor, places: Tensor) -> Tensor:
    """Weights (..., n) of places (n,) at x (...), of which two beside each other are not 0. At a
    place their slopes are the mean of those on both sides.
    """
    share = (x[..., None] - places[:-1]) / places.diff()
    one, none = torch.ones_like(share[..., :1]), torch.zeros_like(share[..., :1])
    share = torch.minimum(torch.maximum(share, none), one)  # `clamp` has the sum of both slopes
    return torch.cat((one, share), -1) - torch.cat((share, none), -1)
