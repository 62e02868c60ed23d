"""Where tendons are, at one instant or over a step; and what is asked of a scene without any."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from torch import Tensor

from ..core.leaves import Tree
from .joint_motion import JointDrive


class Eyelets(NamedTuple):
    """Points (..., E, 3) m, frame a, and their levers from the nodes; zero on the ground."""

    p: Tensor
    lever: Tensor

    def mean(self, other: Eyelets) -> Eyelets:
        return Eyelets((self.p + other.p) / 2, (self.lever + other.lever) / 2)


class TendonMotion(NamedTuple):
    """Where forces act, where eyelets are after a step, and before (None = there is none); given
    (..., K) N or m; drive: how, as of joints; way() (..., N+1, p) m by which nodes move over a
    step, without the rounding of places, None = forces act at an instant; told (..., E, 2) of
    points with friction, see `rope.Grip`, None = nothing.
    """

    acting: Eyelets
    end: Eyelets
    start: Eyelets | None
    given: Tensor
    drive: JointDrive
    way: Callable[[], Tensor] | None = None
    told: Tensor | None = None


class NoTendons(Tree):
    """None: balances and tangents are those of nodes, elements and joints alone."""

    dissipative = False
    smooth = True
    stretches = ()

    def loaded(self, nodes: Tensor, motion: Callable[[], TendonMotion]) -> Tensor:
        """The nodes' balances (..., nodes, w), with the forces of these."""
        return nodes

    def matrix(
        self,
        matrix: Any,
        motion: Callable[[], TendonMotion],
        half: Callable[[], Tensor] | None = None,
        rate: float = 1.0,
    ) -> Any:
        """Their tangent, with that of these; half, rate: see `Joints.blocks`."""
        return matrix

    def told(self, motion: Callable[[], TendonMotion]) -> Tensor | None:
        """What an iteration tells the next one of friction (..., E, 2), see `rope.Grip`."""
        return None

    def values(self, tendons: tuple[Any, ...], t: Tensor, inputs: Any) -> Tensor | None:
        """Of a scene's tendons (..., K): the tension N or length m that is given, at t (...)."""
        return None

    def finished(
        self,
        motion: Callable[[], TendonMotion],
        work: Tensor | None = None,
        before: Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Fields of the state after a step; work (...) J so far, and theirs; before: the readings
        at its start, where forces act at its ends.
        """
        return {}
