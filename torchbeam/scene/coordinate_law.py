"""Base of laws along a joint's coordinate q that say by themselves what they resist by."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

from torch import Tensor

from ..core.leaves import Tree


class Travel(NamedTuple):
    """How coordinates have gone: q before and after (..., J) rad or m; memory (..., J, m) before;
    t (...) s, and dt (..., 1) s of a step, of whose middle t is, None = an equilibrium.
    """

    before: Tensor
    after: Tensor
    memory: Tensor
    t: Tensor
    dt: Tensor | None


class Response(NamedTuple):
    """load (..., J) N m or N against q, of a step what its work is counted by; its slope by q
    after; memory (..., J, m) after.
    """

    load: Tensor
    slope: Tensor
    memory: Tensor


class OwnLaw(Tree):
    """Base of such laws.

    Attributes:
        memory: how many numbers it keeps
        rows: how many axes its numbers have of their own: 1, of all joints of a scene
    """

    memory: ClassVar[int] = 0
    rows = 0

    def response(self, travel: Travel) -> Response:
        """Its response, of all joints; what those give that do not have it is not used."""
        raise NotImplementedError

    def damper(self, travel: Travel) -> Tensor | None:
        """(..., J) N m s/rad or N s/m of small motions; None = it has none."""
        return None


def rows(law: Any) -> int:
    """Own axes of a law's numbers."""
    return law.rows
