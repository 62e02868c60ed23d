"""Reach: where a static tip force holds the tip, as a polynomial of the force; the way back; and how far from it the tip is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

SOFT = 1e-3  # of the length: below it the distance in a cost is rounded off
DEGREE = 16  # of the polynomial, in either component of the force


@dataclass(frozen=True)
class Reach:
    """Static tip position as a function of the tip force's share in `force`, interpolated at Chebyshev points of [-1, 1]^2, or
    of [-1, 1] for a force along one axis.

    One batch of equilibria at construction, then a matrix product an episode: drawing targets costs no solve. For the default
    strip and reach the polynomial is within 3e-6 of the length of the equilibrium anywhere in the square.

    coefficients  (..., DEGREE + 1, DEGREE + 1, 3) m; of one axis (..., DEGREE + 1, 1, 3)
    """

    coefficients: Tensor

    @classmethod
    def of(cls, scene: tb.Scene, force: Tensor, axes: Tensor, read: Callable[[tb.State], Tensor] | None = None) -> Reach:
        """scene with the input "force"; force (1 or 2,) N, largest along the rows of axes (1 or 2, 3).

        read  what to interpolate instead of the tip's position: state -> (..., c)
        """
        k = torch.arange(DEGREE + 1, dtype=scene.dtype, device=scene.device)
        points = torch.cos(torch.pi * (k + 0.5) / (DEGREE + 1))
        grid = torch.stack(torch.meshgrid(*[points] * len(force), indexing="ij"), -1)
        loads = (grid.reshape(-1, *[1] * len(scene.batch_shape), len(force)) * force) @ axes
        state = tb.equilibrium(scene, force=loads)
        value = (state.tip.position if read is None else read(state)).unflatten(0, (DEGREE + 1, -1))
        basis = _chebyshev(points) * (1 + (k > 0).to(k.dtype)) / (DEGREE + 1)  # (point, degree)
        second = basis if len(force) == 2 else basis.new_ones(1, 1)
        return cls(torch.einsum("pi,qj,pq...c->...ijc", basis, second, value))

    def tip(self, share: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """(k, 3) m, where static forces share * force, share (k, 1 or 2), hold the tips of the sub-envs `rows`."""
        c = self.coefficients[rows] if self.coefficients.ndim > 3 else self.coefficients
        first = _chebyshev(share[:, 0])
        second = _chebyshev(share[:, 1]) if share.shape[-1] == 2 else torch.ones_like(first[:, :1])
        return torch.einsum("ki,kj,...ijc->kc" if c.ndim == 3 else "ki,kj,kijc->kc", first, second, c)


def share_in_ellipse(unit: np.ndarray, axes: int) -> np.ndarray:
    """Two uniform numbers of [0, 1) each, (k, 2) -> points (k, 2) uniform in the unit disc, or (k, 1) in [-1, 1]."""
    if axes == 1:
        return 2 * unit[:, :1] - 1
    radius, turn = unit.T
    return (np.sqrt(radius) * np.array([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])).T


def distance(a: Tensor, b: Tensor) -> Tensor:
    """(n,) m between points (n, 3)."""
    return torch.linalg.vector_norm(a - b, dim=-1)


def rounded(gap: Tensor, length: float) -> Tensor:
    """(n,): (sqrt(d^2 + s^2) - s) / (0.1 L), d = |gap|, gap (n, 3) m: smooth at 0, about 1 at L / 10."""
    soft = SOFT * length
    return ((gap.square().sum(-1) + soft**2).sqrt() - soft) / (0.1 * length)


def holding_action(scene: tb.Scene, target: Tensor, force: Tensor, axes: Tensor, iterations: int = 8) -> Tensor:
    """The action (n, 1 or 2) whose equilibrium has its tip nearest the target (n, 3) m: Gauss-Newton on `tb.equilibrium`."""
    action = torch.zeros(len(target), len(force), dtype=scene.dtype, device=scene.device)
    for _ in range(iterations):
        with torch.enable_grad():
            a = action.requires_grad_()
            tip = tb.equilibrium(scene, force=(a * force) @ axes).tip.position
            J = torch.stack([torch.autograd.grad(tip[:, i].sum(), a, retain_graph=True)[0] for i in range(3)], -2)
        change = torch.linalg.lstsq(J, (target - tip.detach())[..., None]).solution[..., 0]
        action = (action.detach() + change).clamp(-1, 1)
    return action


def _chebyshev(x: Tensor) -> Tensor:
    """T_0 ... T_DEGREE of x (...) in [-1, 1]: (..., DEGREE + 1)."""
    T = [torch.ones_like(x), x]
    for _ in range(DEGREE - 1):
        T.append(2 * x * T[-1] - T[-2])
    return torch.stack(T, -1)
