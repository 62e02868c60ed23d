"""System of a framework: its matrix restricted to what is free, with midside nodes condensed; see
`elimination`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_tridiagonal import finite_pivots, in_unit, positive_definite, recorded
from ..math.concrete import concrete
from ..math.shapes import broadcast_shapes
from .cut import Cut
from .elimination import FrameworkSolve, blocks, condense, solve
from .framework_unknowns import FrameworkUnknowns
from .interface import Interface
from .midside_nodes import Midside


@dataclass(frozen=True)
class FrameworkSystem:
    """See `protocols.System`. Of the elements' end nodes: D (..., n, w, w), U and L
    (..., N, w, w) from an element's first end to its last and back; tied (..., n, w, w) of ties,
    and held, see `FrameworkMatrix`; None = there are none.
    """

    framework: Any
    unknowns: FrameworkUnknowns
    cut: Cut
    D: Tensor
    U: Tensor
    L: Tensor
    midside: Midside | None = None
    tied: Tensor | None = None
    held: Tensor | None = None

    @property
    def _parts(self) -> tuple[Tensor | None, ...]:
        """As `solve` and `condense` take them."""
        return self.D, self.U, self.L, self.tied, self.held

    def solve(self, b: Tensor, constant: bool = True) -> Tensor:
        """b (..., nodes + J, w): behind the nodes what constraints change by; multipliers then."""
        n, unknowns, middle = self.framework.node_count, self.unknowns, None
        nodes, forces = (b, None) if self.held is None else b.split((n, b.shape[-2] - n), -2)
        if unknowns.partial or self.cut.holds(unknowns.held):
            nodes = nodes * unknowns.mask
        if self.midside is not None:
            nodes, middle = self.midside.condense(nodes)
        b, n = nodes, nodes.shape[-2]
        if forces is not None:
            b = torch.cat((nodes, forces.expand(*nodes.shape[:-2], *forces.shape[-2:])), -2)
        x = (
            FrameworkSolve.apply(self.cut, b, *self._parts)
            if constant and recorded()
            else solve(self.cut, b, *self._parts)
        )
        if self.midside is None:
            return x
        nodes = self.midside.restore(x if forces is None else x[..., :n, :], middle)
        return nodes if forces is None else torch.cat((nodes, x[..., n:, :]), -2)

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Of midside nodes, of the runs, and of the interface where constraints leave it free."""
        pivots, sound = [], torch.ones((), dtype=torch.bool, device=self.D.device)
        for line in self.cut.lines:
            line_pivots, well = finite_pivots(*blocks(line, self.D, self.U, self.L))
            alone = line.alone
            pivots.append(in_unit(line_pivots if alone else line_pivots.flatten(-4, -3), unit))
            sound = sound & (well if alone else well.all(-1))
        if (system := self._interface()) is not None:
            line_pivots, well = finite_pivots(*self._free(system, unit))
            pivots.append(line_pivots)
            sound = sound & well
        if self.midside is not None:
            first = torch.isfinite(self.midside.D)
            pivots.insert(0, in_unit(torch.where(first, self.midside.D, 0.0), unit))
            sound = sound & first.all(-1).all(-1).all(-1)
        shape = broadcast_shapes(*(x.shape[:-3] for x in pivots))
        return torch.cat([x.expand(*shape, *x.shape[-3:]) for x in pivots], -3), sound

    def positive_definite(self) -> Tensor:
        well = []
        for line in self.cut.lines:
            definite_line = positive_definite(*blocks(line, self.D, self.U, self.L))
            well.append(definite_line if line.alone else definite_line.all(-1))
        if (system := self._interface()) is not None:
            held = 0 if self.held is None else int(self.held.sum())
            definite = system.definite(held) if system.large else None
            if definite is None or not concrete(definite).all():
                definite = positive_definite(*self._free(system))
            well.append(definite)
        if self.midside is not None:
            well.append(
                (torch.linalg.cholesky_ex(self.midside.D + self.midside.D.mT).info == 0).all(-1)
            )
        return torch.stack(torch.broadcast_tensors(*well)).all(0)

    def _free(self, system: Interface, unit: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """The pivots of the interface's matrix Z^T K Z, of the moves Z, measured in `unit`, that
        independent constraints leave, as those of a chain (D, L, U) without couplings.
        """
        how, w = self.cut, self.D.shape[-1]
        dense, n = system.dense(), len(how.interface) * w
        # a run is singular: so is this
        dense = torch.where(torch.isfinite(dense).all(-1).all(-1)[..., None, None], dense, 0.0)
        K, G = dense[..., :n, :n], dense[..., n:, :n]
        if unit is not None:
            units = unit.repeat(*(1,) * (unit.ndim - 1), len(how.interface))
            K, G = units[..., :, None] * K * units[..., None, :], G * units[..., None, :]
        if how.multipliers:
            Z = torch.linalg.svd(G).Vh[..., int(self.held.sum()) :, :].mT
            K = Z.mT @ K @ Z
        more = -K.shape[-1] % w if K.shape[-1] else w
        K = pad(K, (0, more, 0, more)) + torch.diag_embed(
            pad(K.new_zeros(K.shape[-1]), (0, more), value=1.0)
        )
        return _block_pivots(K, w)

    def _interface(self) -> Interface | None:
        """With no right-hand sides; None where there is none."""
        none = self.D.new_zeros(self.D.shape[-3] + self.cut.multipliers, self.D.shape[-1])
        return condense(self.cut, none, *self._parts)[0]

    def detach(self) -> FrameworkSystem:
        midside = None if self.midside is None else self.midside.detach()
        tied = None if self.tied is None else self.tied.detach()
        parts = {name: getattr(self, name).detach() for name in "DUL"}
        return replace(self, **parts, midside=midside, tied=tied)


def _block_pivots(K: Tensor, w: int) -> tuple[Tensor, Tensor, Tensor]:
    """Pivot blocks (..., n, w, w) of a dense matrix, as a chain without couplings."""
    pivots = []
    while K.shape[-1]:
        A, B, C = K[..., :w, :w], K[..., :w, w:], K[..., w:, :w]
        pivots.append(A)
        K = K[..., w:, w:] - C @ torch.linalg.solve_ex(A, B)[0]
    D = torch.stack(pivots, -3)
    none = torch.zeros_like(D[..., 1:, :, :])
    return D, none, none
