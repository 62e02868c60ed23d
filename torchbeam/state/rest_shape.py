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


class Between(NamedTuple):
    """From each node to the next, see `RestShape`."""

    distances: Tensor
    turns: Tensor


class RestShape(Between, Mark):
    """From each node to the next, at rest: distances (..., n) m and rotation vectors (..., n, 3)
    rad of the section axes, without derivatives; of samples that were taken from a batch those of
    all. Where and which way a beam stands does not count, nor what it is made of.
    """

    @classmethod
    def of(cls, beam: Any) -> RestShape | None:
        """One object for each beam; None within torch.func, where numbers are not to be had."""
        if functorch.peek_interpreter_stack() is not None:
            return None
        if HELD not in vars(beam):
            with lasting(), no_derivatives():
                q, chords = beam.frames.detach(), beam.nodes.detach().diff(dim=-2)
                between = quat.multiply(quat.conjugate(q[..., :-1, :]), q[..., 1:, :])
                distances = torch.linalg.vector_norm(chords, dim=-1)
                vars(beam)[HELD] = cls(distances, quat.logarithm(between))
        return vars(beam)[HELD]

    def of_nodes(self, nodes: slice) -> RestShape:
        """Of a part of a structure."""
        rows = slice(nodes.start, nodes.stop - 1)
        return RestShape(self.distances[..., rows], self.turns[..., rows, :])

    def differs(self, other: RestShape) -> str | None:
        """By how much at least, in words; None where a sample of the one is, but for rounding, as
        one of the other, or where they cannot be compared.
        """
        distances, turns = (x.to(self.distances) for x in (other.distances, other.turns))
        if distances.shape[-1] != self.distances.shape[-1]:
            return None
        try:
            longer = (self.distances - distances).abs().amax(-1) / distances.sum(-1)
            turned = (self.turns - turns).abs().amax((-2, -1))
        except RuntimeError:  # of other batches
            return None
        off = torch.maximum(longer, turned)
        rounding = max(torch.finfo(x.dtype).eps for x in (self.turns, other.turns)) ** 0.5
        if not off.numel() or not bool((off > rounding).all()):
            return None
        k = int(off.argmin())
        longer, turned = (float(x.expand_as(off).flatten()[k]) for x in (longer, turned))
        return (
            f"from one node to the next by up to {100 * longer:.2g} % of its length and "
            f"{turned:.2g} rad"
        )


torch.serialization.add_safe_globals([RestShape])
