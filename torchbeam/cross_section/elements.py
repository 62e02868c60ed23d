"""Elements: shape functions of quadratic quadrilaterals and triangles, at points of integration."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

from ..math.concrete import concrete

QUADRILATERAL, TRIANGLE = 9, 6  # nodes


@cache
def rule(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Weights (g,), shape functions (g, k), and slopes (g, k, 2) of an element of k nodes.

    A quadrilateral's nodes are numbered row by row of its 3 x 3 grid on [-1, 1]^2; a triangle's are
    its corners, then the midpoints of 01, 12, 20. Integration: 3 x 3 points of Gauss, and six of
    degree 4 (Strang and Fix 1973).
    """
    if count == QUADRILATERAL:
        x = torch.tensor([-(0.6**0.5), 0.0, 0.6**0.5], dtype=torch.float64)
        w = torch.tensor([5.0, 8.0, 5.0], dtype=torch.float64) / 9
        s, t = (a.reshape(-1) for a in torch.meshgrid(x, x, indexing="ij"))
        (S, dS), (T, dT) = _line(s), _line(t)
        N = (S[:, :, None] * T[:, None, :]).flatten(1)
        dN = torch.stack((dS[:, :, None] * T[:, None], S[:, :, None] * dT[:, None]), -1)
        return (w[:, None] * w).reshape(-1), N, dN.flatten(1, 2)
    a, b = 0.445948490915965, 0.091576213509771
    L = torch.tensor(
        [[1 - 2 * p if k == i else p for k in range(3)] for p in (a, b) for i in range(3)],
        dtype=torch.float64,
    )
    w = torch.tensor([0.223381589678011] * 3 + [0.109951743655322] * 3, dtype=torch.float64) / 2
    following = L.roll(-1, 1)
    N = torch.cat((L * (2 * L - 1), 4 * L * following), 1)
    slope = torch.tensor([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    corner = (4 * L - 1)[..., None] * slope
    side = 4 * (L[..., None] * slope.roll(-1, 0) + following[..., None] * slope)
    return w / w.sum() / 2, N, torch.cat((corner, side), 1)


def plain(x: Tensor) -> np.ndarray:
    """Numbers to decide by, of every sample where torch.func.vmap shows one."""
    # `numpy()` has no storage to look at within torch.func
    return np.from_dlpack(concrete(x.detach().cpu())).copy()


def _line(x: Tensor) -> tuple[Tensor, Tensor]:
    N = torch.stack((x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2), -1)
    return N, torch.stack((x - 0.5, -2 * x, x + 0.5), -1)
