"""Local functions of joints, and of the nodes that they sit at: the interface between the runs of
nodes that are eliminated, see `topology.framework_system`.

A joint's two ends are called i and j, as those of an element; of the ground there are no fields.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .local_problem import Fields, LocalProblems
from .node_kinds import SIDES, JointKind

# blocks of a joint, with whose rows and columns they have: of an end, or "" of the joint
BLOCKS = {
    **{f"{i}{j}": (i, j) for i in SIDES[1] for j in SIDES[1]},
    **{f"{side}.force": (side, "") for side in SIDES[1]},
    **{f"{side}.constraint": ("", side) for side in SIDES[1]},
    "idle": ("", ""),
}


# what each is the transposed of
TRANSPOSED = {
    "ij": "ji",
    "ji": "ij",
    **{f"{side}.force": f"{side}.constraint" for side in SIDES[1]},
    **{f"{side}.constraint": f"{side}.force" for side in SIDES[1]},
}


@dataclass(frozen=True)
class JointFunctions(LocalProblems):
    """Functions of a joint."""

    def joint(self, held: bool, kind: JointKind, **fields: Tensor) -> Fields:
        """What a joint gives the nodes at its ends and its own row: its push (w) on their balances,
        by end; what its constraints are to change by
        (`right`, w); blocks (w, w), those of both ends by their
        moves (ii, ij, ji, jj), of an end by the joint's forces (`force`), of the constraints by
        an end's moves (`constraint`), and `idle`, 1 for forces that it has not; the largest gap and
        turn. Where supports hold nodes (`held`), blocks of what is free (w, 1 or 0) of the ends,
        and an end's whole row (w, 2 w or 3 w): by the moves of the ends and the forces.
        """
        problem, x = self.of_joint(fields, kind)
        x, joints, p = (
            problem.apply_supports(x),
            problem.model.joints,
            self.model.space.dims.position,
        )
        kinematics, inertia, _ = problem.node_balance(x)
        nodes, _ = problem.node_tangent(kinematics, inertia)
        half, motion = problem.half_turns(nodes), problem.joint_poses(kinematics)
        none = torch.zeros_like(x.stress[:0])
        still = x.stress.new_zeros(len(kind.sides), x.stress.shape[-1])
        push, gap = joints.balance(still, none, x.stress, lambda: motion)
        blocks = joints.blocks_of(motion, x.stress, None if half is None else half(), problem.RATE)
        gap, free = gap[0], {}
        if held:
            free = {side: fields[f"{side}.free"] for side in kind.sides}
        outputs = {"right": -gap, "idle": torch.diag_embed(1 - joints.held[0])}
        for k, side in enumerate(kind.sides):
            outputs[f"{side}.push"] = push[k]
            a = SIDES[1].index(side)
            own = {
                f"{side}{other}": blocks.stiffness[0, a, SIDES[1].index(other)]
                for other in kind.sides
            }
            own[f"{side}.force"] = blocks.force[0, a]
            if held:
                outputs[f"{side}.row"] = torch.cat([*own.values()], -1)
            own[f"{side}.constraint"] = blocks.constraint[0, a]
            for name, block in own.items():
                rows, columns = BLOCKS[name]
                block = block * free[rows][:, None] if rows in free else block
                outputs[name] = block * free[columns] if columns in free else block
        return outputs | {
            "gap_position": gap[:p].abs().amax(),
            "gap_rotation": gap[p:].abs().amax(),
        }

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
        return {
            "force": force
            + joints.held[0] * joints.driven(problem.joint_poses(kinematics)).effort[0]
        }

    def transposed_joint(self, held: bool, kind: JointKind, **fields: Tensor) -> Fields:
        """Blocks of a joint in the transposed matrix, by name as in `joint`, and what is asked of
        its forces (`right`, w): `force_bar`; where supports hold nodes, with what cotangents of
        their reactions are to the balances (`reaction`) of the ends, also what is asked of an end's
        moves (`asked`, w).
        """
        pushes = {side: fields.pop(f"{side}.reaction") for side in kind.sides if held}
        right = fields.pop("force_bar")
        outputs = self.joint(held, kind, **fields)
        blocks = {name: outputs[name] for name in BLOCKS if name in outputs}
        turned = {name: blocks[TRANSPOSED.get(name, name)].mT for name in blocks}
        asked = {}
        for side, push in pushes.items():
            *moves, force = (push @ outputs[f"{side}.row"]).split(len(right))
            right = right + force
            for end, part in zip(kind.sides, moves, strict=True):
                asked[end] = asked.get(end, 0.0) + part
        held_rows = right.new_tensor(kind.held)
        return (
            turned | {"right": right * held_rows} | {f"{end}.asked": x for end, x in asked.items()}
        )

    def joint_update(self, force: Tensor, move: Tensor) -> Fields:
        """The forces of a joint (w) after they have changed."""
        return {"force": force + move}

    def end_reaction(
        self, side: str, ends: tuple[str, ...], end_free: Tensor, **fields: Tensor
    ) -> Fields:
        """What a joint or a stretch of a tendon adds to the reaction of the support of the node at
        its `side` (w), by the moves of what its `row` has columns of: its nodes, and the
        change of its own unknowns.
        """
        moves = torch.cat([fields[f"{end}.move"] for end in ends])
        push = (fields[f"{side}.row"] @ moves[:, None])[:, 0]
        return {"reaction": (1 - end_free) * push}
