"""Internal states of loads: those of a state, and as rows of nodes, which native code has."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...nodal.acting import ActingLoad


class InternalStates:
    """Of the loads that act natively on so many nodes."""

    def __init__(self, acts: tuple[ActingLoad, ...], nodes: int) -> None:
        self.acts, self.nodes = [act for act in acts if act.internal is not None], nodes

    def rows(self, internal: Tensor) -> Tensor:
        """Those of a state (..., z) as rows of nodes (..., N+1, Z): of each load in turn, zeros
        where it does not act.
        """
        states = []
        for act in self.acts:
            rows = internal[..., act.internal].unflatten(-1, (-1, act.load.internal))
            nodes = self._nodes_of(act)
            states.append(pad(rows, (0, 0, nodes.start, self.nodes - nodes.stop)))
        return torch.cat(states, -1)

    def of_rows(self, rows: Tensor) -> Tensor:
        """The inverse."""
        parts = rows.split([act.load.internal for act in self.acts], -1)
        states = {
            act.internal.start: x[..., self._nodes_of(act), :].flatten(-2)
            for act, x in zip(self.acts, parts, strict=True)
        }
        return torch.cat([states[first] for first in sorted(states)], -1)

    def _nodes_of(self, act: ActingLoad) -> slice:
        """Those that a load acts on."""
        if isinstance(act.node, slice):
            return act.node
        return slice(0, self.nodes) if act.node is None else slice(act.node, act.node + 1)
