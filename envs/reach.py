"""Reach: where a static tip force holds the tip, as a polynomial of the force; and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

import torchbeam as tb

DEGREE = 16  # of the polynomial, in either component of the force


@dataclass(frozen=True)
class Reach:
    """Static tip position as a function of the tip force's share in `force`, interpolated at (DEGREE + 1)^2 Chebyshev points
    of [-1, 1]^2.

    One batch of equilibria at construction, then a matrix product an episode: drawing targets costs no solve. For the default
    strip and reach the polynomial is within 3e-6 of the length of the equilibrium anywhere in the square.

    coefficients  (..., DEGREE + 1, DEGREE + 1, 3) m
    """

    coefficients: Tensor

    @classmethod
    def of(cls, scene: tb.Scene, force: Tensor, axes: Tensor) -> Reach:
        """scene with the input "force"; force (2,) N, largest along the two rows of axes (2, 3)."""
        k = torch.arange(DEGREE + 1, dtype=scene.dtype, device=scene.device)
        points = torch.cos(torch.pi * (k + 0.5) / (DEGREE + 1))
        grid = torch.stack(torch.meshgrid(points, points, indexing="ij"), -1)
        loads = (grid.reshape(-1, *[1] * len(scene.batch_shape), 2) * force) @ axes
        tip = tb.equilibrium(scene, force=loads).tip.position.unflatten(0, grid.shape[:2])
        basis = _chebyshev(points) * torch.where(k > 0, 2.0, 1.0) / (DEGREE + 1)  # (point, degree)
        return cls(torch.einsum("pi,qj,pq...c->...ijc", basis, basis, tip))

    def tip(self, share: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """(k, 3) m, where static forces share * force, share (k, 2), hold the tips of the sub-envs `rows`."""
        c = self.coefficients[rows] if self.coefficients.ndim > 3 else self.coefficients
        return torch.einsum("ki,kj,...ijc->kc" if c.ndim == 3 else "ki,kj,kijc->kc",
                            _chebyshev(share[:, 0]), _chebyshev(share[:, 1]), c)


def holding_action(scene: tb.Scene, target: Tensor, force: Tensor, axes: Tensor, iterations: int = 8) -> Tensor:
    """The action (n, 2) whose static equilibrium has its tip nearest the target (n, 3) m: Gauss-Newton on `tb.equilibrium`."""
    action = torch.zeros(len(target), 2, dtype=scene.dtype, device=scene.device)
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
