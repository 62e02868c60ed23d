"""Small motions about an equilibrium: natural frequencies, damping, stability.

With a the moves (displacement, spin) of the free nodes and M, D, K the mass, damping and tangent stiffness there, the last
with the stress and the loads that turn (so K need not be symmetric):  M a'' + D a' + K a = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from .checks import count as check_count
from .nodal.matrices import matrices, moves
from .nodal.model import Model
from .scene import Scene
from .state import State
from .statics import equilibrium


@dataclass(frozen=True)
class Modes:
    """The slowest motions x exp(eigenvalue t), one of each conjugate pair, by frequency.

    eigenvalue  (..., count) complex, 1/s; a positive real part grows
    shape       (..., count, N+1, 6) complex: displacement (m) and rotation (rad) of the nodes, frame a; its largest entry is 1
    """

    eigenvalue: Tensor
    shape: Tensor

    @property
    def frequency(self) -> Tensor:
        """(..., count) rad/s, |imaginary part|; 0 for a motion that does not oscillate."""
        return self.eigenvalue.imag.abs()

    @property
    def damping_ratio(self) -> Tensor:
        """(..., count) -real part / |eigenvalue|: 1 for no oscillation, negative for growth."""
        return -self.eigenvalue.real / self.eigenvalue.abs()


def modes(scene: Scene, state: State | None = None, count: int = 6, *, t: float = 0.0, lumped: bool = False, **inputs: Any
          ) -> Modes:
    """Natural frequencies, damping ratios and shapes of the nodal form.

    state   an equilibrium of the scene; None = the one under its loads at time t (s)
    count   pairs of eigenvalues, the slowest first; an overdamped pair counts as two
    lumped  as in `Stepper`: the mass of the explicit form
    inputs  by name, (..., size)

    Follower loads are in K: flutter is a positive real part, divergence a positive eigenvalue without frequency. Sections
    without rotary inertia are taken as they are. An infinite stiffness is a very large one here: its own modes, far above
    those of the finite stiffnesses, mean nothing. Dense, O(N^3). Gradients of eigenvalues need them distinct.

    Raises ValueError for more modes than the mesh has, or for what the nodal form does not take.
    """
    model = Model.of(scene, lumped)
    free = model.held.count
    if check_count("count", count) > free:
        raise ValueError(f"count = {count} was given; {scene.beam.count} elements have at most {free} modes")
    if state is None:
        state = equilibrium(scene, t=t, **inputs)
    M, D, K = matrices(model, state, torch.as_tensor(t, dtype=scene.dtype, device=scene.device), scene.tensors(inputs))
    found, vectors = inverse_spectrum(M, D, K)
    chosen = _slowest(_eigenvalue(found.detach(), D is None), count)
    eigenvalue = _eigenvalue(found.gather(-1, chosen), D is None)
    vectors = vectors.mT.gather(-2, chosen[..., None].expand(*chosen.shape, free))
    vectors = vectors / vectors.gather(-1, vectors.abs().argmax(-1, keepdim=True))
    return Modes(eigenvalue, moves(model, vectors))


def inverse_spectrum(M: Tensor, D: Tensor | None, K: Tensor) -> tuple[Tensor, Tensor]:
    """1/eigenvalue^2, or without D 1/eigenvalue, and the shapes as columns: inverse because K is regular where M may not be."""
    flexible = torch.linalg.solve(K, M if D is None else torch.cat((D, M), -1))
    if D is None:
        return torch.linalg.eig(-flexible)
    eye = torch.eye(M.shape[-1], dtype=M.dtype, device=M.device).expand_as(M)
    found, vectors = torch.linalg.eig(torch.cat((-flexible, torch.cat((eye, torch.zeros_like(M)), -1)), -2))
    return found, vectors[..., :M.shape[-1], :]


def _eigenvalue(found: Tensor, squared: bool) -> Tensor:
    """From 1/eigenvalue, or its square; inverse because K is regular where M may not be."""
    if not squared:
        return 1 / found
    root = (1 / found).sqrt()
    return torch.where(root.imag < 0, -root, root)


def _slowest(eigenvalue: Tensor, count: int) -> Tensor:
    """Where the `count` smallest in size are, one of each conjugate pair, by their imaginary part."""
    slow = torch.where(eigenvalue.imag < 0, torch.inf, eigenvalue.abs()).argsort(dim=-1, stable=True)[..., :count]
    return slow.gather(-1, eigenvalue.imag.gather(-1, slow).argsort(dim=-1, stable=True))
