"""Conditions of rows at one instant: what acts there, and what is prescribed. They are made here of
a model, for all of its rows; native code has those of one node, or of one element.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from torch import Tensor

from ..core.derivatives import cached
from ..scene.effects import Inputs, Pose
from .acting import ActingLoad
from .frame import FixedFrame, frame_of
from .joint_motion import NO_VALUES, JointValues
from .line_loads import valued
from .model import Model


class SupportConditions(NamedTuple):
    """Of a support of a row, where anything moves: fixed (w) 1 where it holds, else 0; pose:
    position (..., 3) and quaternion (..., 4), None = it does not move in frame a; motion: velocity
    (..., 3), absolute, frame a, and spin (..., 3), absolute, section axes, None = it is no clamp.
    """

    node: int
    fixed: Tensor
    pose: tuple[Tensor, Tensor] | None
    motion: tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class Conditions:
    """t and inputs: of functions that loads hold. velocities: of frame a, see
    `PrescribedMotion.frame`. dead (..., N+1, w): of loads that are summed already, 0.0 = none.
    eigenstrain (..., N or 1, k), 0.0 = none. supports: at the end of a step; none where nothing
    moves. root: where the support of node 0 stands, if a load asks. orientation: of frame a at this
    instant, None = it does not turn, or follows from a state. elements: of the beam. tendons
    (..., K, 1 or 2): tensions N or lengths m, see `Tendons.values`, None = there are none. between:
    loads that act between nodes, see `element_loads`; `node` of each are the stations along which
    it does. interactions: of several nodes, which are `node` of each.
    """

    t: Tensor
    inputs: Inputs
    frame: FixedFrame
    velocities: tuple[Tensor | None, Tensor | None]
    loads: tuple[ActingLoad, ...]
    dead: Tensor | float
    eigenstrain: Tensor | float
    supports: tuple[SupportConditions, ...]
    root: Pose | None
    orientation: Tensor | None
    elements: int
    joints: JointValues = NO_VALUES
    tendons: Tensor | None = None
    between: tuple[ActingLoad, ...] = ()
    interactions: tuple[ActingLoad, ...] = ()

    @cached
    def moving(self) -> tuple[ActingLoad, ...]:
        """Loads that depend on how the nodes stand or move."""
        return tuple(load for load in self.loads if load.reads)

    @cached
    def still(self) -> tuple[ActingLoad, ...]:
        """The others."""
        return tuple(load for load in self.loads if not load.reads)

    @property
    def internal_states(self) -> int:
        """How many numbers the loads remember."""
        return max(
            (load.internal.stop for load in self.loads if load.internal is not None), default=0
        )

    @cached
    def reads(self) -> frozenset[str]:
        """What the loads read of the nodes' motion."""
        acts = *self.loads, *self.between, *self.interactions
        return frozenset().union(*(act.reads for act in acts))


def conditions(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    end: Tensor | None = None,
    loads: tuple[Any, ...] | None = None,
) -> Conditions:
    """Of all of a model at t (...), its supports at the time `end` (...); loads: these of the
    scene's alone, without what the beam bends by itself, and what acts in joints and tendons,
    None = all.
    """
    acts, motion, eigenstrain = model.acts, model.prescribed_motion, 0.0
    joints, tendons = NO_VALUES, None
    if loads is None:
        eigenstrain = model.eigenstrain(t, inputs)
        until = t if end is None else end
        joints = model.joints.values(model.scene, t, inputs, until) or NO_VALUES
        tendons = model.tendons.values(model.scene, t, inputs, until)
    else:
        acts = tuple(act for act in acts if any(act.load is load for load in loads))
    acts = tuple(act._replace(load=valued(model, act, t, inputs)) for act in acts)
    asked = loads is None or any(act.load.wants_frame for act in acts)
    velocities = motion.frame(t) if asked else (None, None)
    root = motion.root_pose(t) if any(act.load.wants_support for act in acts) else None
    acts, between, interactions = split(acts)
    return Conditions(
        t,
        inputs,
        frame_of(model.space, *velocities),
        velocities,
        acts,
        0.0,
        eigenstrain,
        () if end is None else supports(model, end),
        root,
        None,
        model.scene.beam.element_count,
        joints,
        tendons,
        between,
        interactions,
    )


def split(acts: tuple[ActingLoad, ...]) -> tuple[tuple[ActingLoad, ...], ...]:
    """Those that act at nodes, those that act between those of elements, and interactions."""
    several = tuple(act for act in acts if isinstance(act.node, tuple))
    each = [act for act in acts if not isinstance(act.node, tuple)]
    at, between = (
        tuple(act for act in each if act.load.between_nodes is is_between)
        for is_between in (False, True)
    )
    return at, between, several


def supports(model: Model, end: Tensor) -> tuple[SupportConditions, ...]:
    """At the time `end`; none where nothing moves."""
    if not model.scene.has_prescribed_motion:
        return ()
    motion = model.prescribed_motion
    pairs = zip(model.scene.supports, model.constraints.fixed, strict=True)
    return tuple(
        SupportConditions(
            support.node,
            fixed,
            motion.pose(support, end) if support.moves else None,
            motion.absolute(support, end) if support.clamp else None,
        )
        for support, fixed in pairs
    )
