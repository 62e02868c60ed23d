"""Local functions of joints, and of the nodes that they sit at: the interface between the runs of
nodes that are eliminated, see `topology.framework_system`.

A joint's two ends are called i and j, as those of an element; of the ground there are no fields.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from .interaction import OWN
from .interaction_functions import of_ends
from .local_problem import Fields, LocalProblems
from .node_kinds import JointKind


@dataclass(frozen=True)
class JointFunctions(LocalProblems):
    """Functions of a joint."""

    def joint(self, kind: JointKind, **fields: Tensor) -> Fields:
        """What a joint gives the nodes at its ends and its own row: its push (w) on their balances,
        by end; what its constraints are to change by (`right`, w); its blocks (w, w), see
        `interaction`, its own being 1 for forces that it has not; the largest gap and turn.
        """
        problem, x = self.of_joint(fields, kind)
        return of_ends(problem, x, problem.model.joints, kind.sides, OWN)

    def finish_joint(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The joint at the end of the step: its forces (w), what is read of it, the work done by
        what acts in it.
        """
        problem, x = self.of_joint(fields, kind)
        reaction = x.u.new_zeros(len(problem.support_motions.nodes), x.stress.shape[-1])
        after = problem.finish(x, reaction)
        return {"force": after.stress[0], "joints": after.joints[0], "work": after.work}

    def joint_solution(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The unknown forces of a step (w), from those that have acted in it (`after_force`)."""
        force = fields.pop("after_force")
        if not any(kind.prescribed or ()):
            return {"force": force}
        problem, x = self.of_joint(fields | {"force": force}, kind)
        kinematics, *_ = problem.node_balance(problem.apply_supports(x))
        joints = problem.model.joints
        placed = problem.node_motion(kinematics).placed(joints.pose)
        return {"force": force + joints.held[0] * joints.driven(placed).effort[0]}
