"""Local functions of joints, and of the nodes that they sit at: the interface between the runs of
nodes that are eliminated, see `topology.framework_system`.

A joint's two ends are called i and j, as those of an element; of the ground there are no fields.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...equations.balance_problem import BalanceProblem
from ...nodal.joint_motion import Factor, JointValues
from ...nodal.joints import Joints
from ...nodal.rows import Rows
from ...topology.framework import Framework
from .chain_constants import JointConstants, filled
from .interaction_functions import of_ends
from .local_problem import Fields, LocalProblems
from .node_kinds import JointKind
from .sorts import OWN, SIDES


@dataclass(frozen=True)
class JointFunctions:
    """Functions of a joint."""

    problems: LocalProblems

    def joint(self, kind: JointKind, **fields: Tensor) -> Fields:
        """What a joint gives the nodes at its ends and its own row: its push (w) on their balances,
        by end; what its constraints are to change by (`right`, w); its blocks (w, w), see
        `sorts`, its own being 1 for forces that it has not; the largest gap and turn.
        """
        problem, x = self.problem(fields, kind)
        return of_ends(problem, x, problem.model.joints, kind.sides, OWN)

    def finish_joint(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The joint at the end of the step: its forces (w), what is read of it, the work done by
        what acts in it.
        """
        problem, x = self.problem(fields, kind)
        reaction = x.u.new_zeros(len(problem.support_motions.nodes), x.stress.shape[-1])
        after = problem.finish(x, reaction)
        return {"force": after.stress[0], "joints": after.joints[0], "work": after.work}

    def joint_solution(self, kind: JointKind, **fields: Tensor) -> Fields:
        """The unknown forces of a step (w), from those that have acted in it (`after_force`)."""
        force = fields.pop("after_force")
        if not any(kind.prescribed or ()):
            return {"force": force}
        problem, x = self.problem(fields | {"force": force}, kind)
        kinematics, *_ = problem.node_balance(problem.apply_supports(x))
        joints = problem.model.joints
        placed = problem.node_motion(kinematics).placed(joints.pose)
        return {"force": force + joints.held[0] * joints.driven(placed).effort[0]}

    def problem(self, fields: Fields, kind: JointKind) -> tuple[BalanceProblem, Any]:
        """The same of one joint and the nodes at its ends, which have no loads."""
        at = {side: k for k, side in enumerate(kind.sides)}
        pair = tuple(at.get(side) for side in SIDES[1])
        ends = self.problems.of_ends(fields, kind, Framework(1, (), len(at), (pair,)))
        values = ends.values | {"stress": fields["force"][None], "joints": fields["joints"][None]}
        if "last_force" in fields:
            values["last_stress"] = fields["last_force"][None]
        constants = filled(self.problems.trees.joint, lambda k: fields[f"joint.{k}"][None])
        rows = replace(ends.rows, joints=self._alone(ends.rows, constants, kind))
        now = replace(ends.now, joints=JointValues(constants.effort, constants.coordinate))
        return self.problems.problem(rows, None, ends.common, values, now)

    def _alone(self, rows: Rows, constants: JointConstants, kind: JointKind) -> Joints:
        """The one joint between the nodes of rows."""
        joints, like = self.problems.model.joints, constants.c

        def known(k: int, factor: Factor) -> Factor:
            """With numbers where the kind has them: shifts, and zeros for parts that there are
            not.
            """
            parts = zip(*(row[k] for row in kind.parts), strict=True)
            matrices = factor.constant, *factor.fixed.unbind(-3)
            constant, *fixed = (
                _numbered(x, tuple(None if there else 0.0 for there in part))
                for x, part in zip(matrices, parts, strict=True)
            )
            shift = _numbered(factor.shift, kind.shifts[k])
            return replace(factor, constant=constant, shift=shift, fixed=torch.stack(fixed, -3))

        numbers = {
            name: like.new_tensor([getattr(kind, name)])
            for name in ("held", "angles", "travels", "second", "prescribed")
            if getattr(kind, name) is not None
        }
        numbers |= {} if constants.laws is None else {"laws": constants.laws}
        return replace(
            joints,
            space=rows.space,
            framework=rows.topology,
            v=known(0, constants.v),
            w=known(1, constants.w),
            c=constants.c,
            across=known(2, constants.across),
            moves=joints.moves.detach(),
            balls=replace(constants.balls, at=(0,)) if kind.ball else None,
            behind=0,
            **numbers,
        )


def _numbered(x: Tensor, numbers: tuple[float | None, ...]) -> Tensor:
    """x (..., rows, n), in some rows a number."""
    rows = zip(x.unbind(-2), numbers, strict=True)
    return torch.stack([row if k is None else torch.full_like(row, k) for row, k in rows], -2)
