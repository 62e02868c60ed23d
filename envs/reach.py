"""Reach: static tip position as a polynomial of constant actions, its inverse, and smoothed distances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

SOFT = 1e-3  # of the length: below it the distance in a cost is rounded off
DEGREE = 16  # of the polynomial, in either action


@dataclass(frozen=True)
class Reach:
    """Static tip position as a function of one or two actions, interpolated at Chebyshev points of [-1, 1]^2 or [-1, 1].

    One batch of equilibria at construction, then a matrix product an episode: drawing targets costs no solve. For the default
    strip and reach the polynomial is within 3e-6 of the length of the equilibrium anywhere in the square.

    coefficients  (..., DEGREE + 1, DEGREE + 1, 3) m; of one action (..., DEGREE + 1, 1, 3)
    """

    coefficients: Tensor

    @classmethod
    def of(cls, scene: tb.Scene, actions: int, inputs: Callable[[Tensor], dict[str, Tensor]],
           read: Callable[[tb.State], Tensor] | None = None) -> Reach:
        """The scene under inputs(action (..., actions)) -> name -> (..., size), as `Task.inputs`.

        read  what to interpolate instead of the tip's position: state -> (..., c)

        Raises ValueError for more than two actions: the points would be too many.
        """
        if actions not in (1, 2):
            raise ValueError(f"a beam with {actions} actions was given; static tip positions are interpolated over one or two")
        k = torch.arange(DEGREE + 1, dtype=scene.dtype, device=scene.device)
        points = torch.cos(torch.pi * (k + 0.5) / (DEGREE + 1))
        grid = torch.stack(torch.meshgrid(*[points] * actions, indexing="ij"), -1)
        state = tb.equilibrium(scene, **inputs(grid.reshape(-1, *[1] * len(scene.batch_shape), actions)))
        value = (state.tip.position if read is None else read(state)).unflatten(0, (DEGREE + 1, -1))
        basis = _chebyshev(points) * (1 + (k > 0).to(k.dtype)) / (DEGREE + 1)  # (point, degree)
        second = basis if actions == 2 else basis.new_ones(1, 1)
        return cls(torch.einsum("pi,qj,pq...c->...ijc", basis, second, value))

    @property
    def actions(self) -> int:
        return 1 if self.coefficients.shape[-2] == 1 else 2

    def tip(self, share: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """(k, 3) m, where constant actions share (k, 1 or 2) hold the tips of the sub-envs `rows`."""
        c = self.coefficients[rows] if self.coefficients.ndim > 3 else self.coefficients
        basis = _chebyshev(share)
        first = basis[:, 0]
        second = basis[:, 1] if share.shape[-1] == 2 else torch.ones_like(first[:, :1])
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


def rounded(d: Tensor, length: float) -> Tensor:
    """(n,): (sqrt(d^2 + s^2) - s) / (0.1 L) of distances d (n,) m: smooth at 0, about 1 at L / 10."""
    soft = SOFT * length
    return ((d.square() + soft**2).sqrt() - soft) / (0.1 * length)


def holding_action(scene: tb.Scene, target: Tensor, actions: int, inputs: Callable[[Tensor], dict[str, Tensor]],
                   iterations: int = 8) -> Tensor:
    """The action (n, actions) whose equilibrium has its tip nearest the target (n, 3) m: Gauss-Newton on `tb.equilibrium` of
    the scene under inputs(action), as `Task.inputs`.
    """
    action = torch.zeros(len(target), actions, dtype=scene.dtype, device=scene.device)
    for _ in range(iterations):
        with torch.enable_grad():
            a = action.requires_grad_()
            tip = tb.equilibrium(scene, **inputs(a)).tip.position
            J = torch.stack([torch.autograd.grad(tip[:, i].sum(), a, retain_graph=True)[0] for i in range(3)], -2)
        change = torch.linalg.lstsq(J, (target - tip.detach())[..., None]).solution[..., 0]
        action = (action.detach() + change).clamp(-1, 1)
    return action


def _chebyshev(x: Tensor) -> Tensor:
    """T_0 ... T_DEGREE of x (...) in [-1, 1]: (..., DEGREE + 1)."""
    T, twice = [torch.ones_like(x), x], 2 * x
    for _ in range(DEGREE - 1):
        T.append(twice * T[-1] - T[-2])
    return torch.stack(T, -1)
