"""What acts between nodes: how these move, as it sees it, and what a balance asks of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from torch import Tensor

from ..core.leaves import Tree
from .multipliers import Multipliers

Where = tuple[Tensor, Tensor]
Rates = Callable[[], tuple[Tensor, Tensor]]
# what an iteration tells the next one: of "tendons" (..., E, 2) of points with friction, see
# `rope.Grip`; of the points of "elements", "bodies" and "pairs" where surfaces rub (..., n, 6), see
# `contact_law.telling`
Told = Mapping[str, Tensor]
NOTHING: Told = {}


class NodeMotion(NamedTuple):
    """How nodes move over a step, or stand at an instant, in the space's coordinates.

    now     `Conditions`
    nodes   of what loads read: `Nodes` where forces act
    by      of what they read: their derivatives by the nodes' moves, see `loads.MotionJacobian`
    moved   at rest: the same by the moves and their rates
    after   position and rotation (..., N+1, *) after the step, or at the instant
    before  the same before the step; None = at an instant
    mean    whether forces act at the means of both; else after
    share   (...), as far as loads are raised; None = all
    resisting  whether what resists acts in full whatever the share is, see `LoadEffect.resists`
    dt      (...) s, None = laws of an instant, at rest
    moving  velocity and spin (..., N+1, *) before the step, or at the instant, as seen in frame a;
            None = at rest
    state   before the step, or near the instant: what is kept from step to step; None = nothing
    path    (..., N+1, p) m of nodes over the step, without the rounding of places
    way     `element_loads.Way` of the whole step
    half    half the spin of a node's end by that of its move (..., N+1, s, s); None = it is the end
            that moves
    rates   velocity and spin (..., N+1, *) before the step and after it, absolute, frame a; None =
            they are not known
    by_move  derivatives of those after it by the nodes' moves (..., N+1, w, w)
    acceleration  at an instant: of nodes, as `moving`; None = none, or not known
    told    by the last iteration
    """

    now: Any
    nodes: Callable[[frozenset[str]], Any]
    by: Callable[[frozenset[str]], dict[str, Tensor]]
    after: Where
    before: Where | None = None
    mean: bool = False
    share: Tensor | None = None
    resisting: bool = False
    dt: Tensor | None = None
    moving: Rates | None = None
    state: Any = None
    moved: Callable[[frozenset[str]], dict[str, Tensor]] | None = None
    path: Callable[[], Tensor] | None = None
    way: Callable[[], Any] | None = None
    half: Callable[[], Tensor] | None = None
    rates: Callable[[], tuple[Where, Where]] | None = None
    by_move: Callable[[], Tensor] | None = None
    acceleration: Rates | None = None
    told: Told = NOTHING

    @property
    def rate(self) -> float:
        """How far the ends move by a move."""
        return 2.0 if self.mean else 1.0

    def half_turns(self) -> Tensor | None:
        """`half`, as it is."""
        return None if self.half is None else self.half()

    def raised(self, x: Tensor) -> Tensor:
        """x (..., n, m) as far as loads are raised."""
        return x if self.share is None else self.share[..., None, None] * x

    def share_of(self, load: Any) -> Tensor | None:
        """(...), as far as an interaction is raised; None = all."""
        return None if self.resisting and load.resists else self.share

    def placed(self, place: Callable[[Tensor, Tensor], Any]) -> Placed:
        """Places of nodes, of their positions and rotations."""
        after = place(*self.after)
        before = None if self.before is None else place(*self.before)
        return Placed(before.mean(after) if self.mean else after, after, before, self)


class Placed(NamedTuple):
    """Places where forces act, after a step, and before it (None: no step); nodes' motion."""

    acting: Any
    end: Any
    start: Any
    of: NodeMotion


class BetweenNodes(Tree):
    """What acts between nodes; by itself nothing that does.

    present      whether there is something
    count        of rows of multipliers
    held_count   of constraints, whose forces are unknowns
    dissipative  whether energy is lost; smooth: whether residuals fall as smooth ones do
    has_friction whether there is friction that is taken at a step's end; limited: whether there
                 are limits
    inertia      of what is between nodes, see `JointInertia`; None = there is none
    """

    present = False
    count = 0
    held_count = 0
    dissipative = False
    smooth = True
    has_friction = False
    inertia = None
    limited = False
    stretches = ()  # see `Tendons`

    @property
    def multipliers(self) -> Multipliers:
        """Forces that are unknowns."""
        return Multipliers()

    def values(self, scene: Any, t: Tensor, inputs: Any, end: Tensor) -> Any:
        """What a scene gives at t (...), or at the `end` (...) of a step; None = nothing."""
        return None

    def efforts(self, now: Any) -> Tensor | None:
        """(..., n, p + 1) N and N m, a term that a balance is measured against where nothing else
        acts, under conditions; None = there is none.
        """
        return None

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        """The nodes' balances (..., N+1, w) with its forces; and gaps of elements with its own."""
        return nodes, gap

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        """The tangent of a balance with its own."""
        return matrix

    def mass(self, matrix: Any, motion: NodeMotion) -> Any:
        """A mass matrix with its own, at rest."""
        return matrix

    def damping(self, matrix: Callable[[], Any], motion: NodeMotion) -> Any:
        """A damping matrix with its own, at rest; None = it has none."""
        return None

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        """Fields of the state after a step, of which `stress` is known, with its own; over a step
        its work is added to `work` (...) J. before: the state at its start, where forces act at
        its ends; moving: see `NodeMotion`, after it.
        """
        return fields

    def telling(self, motion: NodeMotion) -> Told:
        """What an iteration tells the next one."""
        return {}

    def near_enough(self, motion: NodeMotion) -> Tensor | None:
        """(...) bool: whether parts may touch each other over the step; None = there are none."""
        return None

    def passed_through(self, motion: NodeMotion) -> Tensor | None:
        """(...) bool: whether parts pass through each other over the step; None = no parts."""
        return None
