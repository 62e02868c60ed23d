"""Rest shape: what a state remembers of its beam, by which those of another are told apart."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ..core.derivatives import lasting, no_derivatives
from ..core.leaves import Mark
from ..math import quaternions as quat

HELD = " rest shape"  # of a beam: a name that begins with a space is this object's alone


class AtRest(NamedTuple):
    """Nodes at rest, see `RestShape`."""

    position: Tensor
    rotation: Tensor


class RestShape(AtRest, Mark):
    """Places (..., nodes, 3) m and section axes (..., nodes, 4) of nodes at rest, without
    derivatives; of samples that were taken from a batch those of all.
    """

    @classmethod
    def of(cls, beam: Any) -> RestShape | None:
        """One object for each beam; None within torch.func, where numbers are not to be had."""
        if functorch.peek_interpreter_stack() is not None:
            return None
        if HELD not in vars(beam):
            with lasting(), no_derivatives():
                vars(beam)[HELD] = cls(beam.nodes.detach(), beam.frames.detach())
        return vars(beam)[HELD]

    def of_nodes(self, nodes: slice) -> RestShape:
        """Of a part of a structure."""
        return RestShape(self.position[..., nodes, :], self.rotation[..., nodes, :])

    def steps(self) -> tuple[Tensor, Tensor]:
        """From each node to the next: distances (..., n) m and rotation vectors (..., n, 3) rad:
        where and which way a beam stands does not count.
        """
        q = self.rotation
        between = quat.multiply(quat.conjugate(q[..., :-1, :]), q[..., 1:, :])
        chords = self.position.diff(dim=-2)
        return torch.linalg.vector_norm(chords, dim=-1), quat.logarithm(between)

    @torch.no_grad()
    def differs(self, other: RestShape) -> str | None:
        """By how much at least, in words; None where a sample of the one is, but for rounding, as
        one of the other, or where they cannot be compared.
        """
        rounding = max(torch.finfo(x.position.dtype).eps for x in (self, other)) ** 0.5
        steps, others = self.steps(), [x.to(self.position) for x in other.steps()]
        if steps[0].shape[-1] != others[0].shape[-1] or not steps[0].shape[-1]:
            return None
        try:
            longer = (steps[0] - others[0]).abs().amax(-1) / others[0].sum(-1)
            turned = (steps[1] - others[1]).abs().amax((-2, -1))
        except RuntimeError:  # of other batches
            return None
        off = torch.maximum(longer, turned)
        if not off.numel() or not bool((off > rounding).all()):
            return None
        k = int(off.argmin())
        longer, turned = (float(x.expand_as(off).flatten()[k]) for x in (longer, turned))
        return (
            f"from one node to the next by up to {100 * longer:.2g} % of its length and "
            f"{turned:.2g} rad"
        )


torch.serialization.add_safe_globals([RestShape])
