"""Local functions of pairs that may touch, see `TouchingPairs`; the six nodes of a pair are called
a, b, c, those of the place, and d, e, f, those of the piece.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...nodal.surface_pairs import SurfacePairs
from ...nodal.touching import OnePair, of_nodes
from ...topology.framework import Framework
from .chain_constants import filled
from .local_problem import Fields, LocalProblems, by_secants
from .node_kinds import PAIR_SIDES, PairKind

# blocks of a pair, with whose rows and columns they have
PAIR_BLOCKS = {f"{i}{j}": (i, j) for i in PAIR_SIDES for j in PAIR_SIDES}


@dataclass(frozen=True)
class PairFunctions(LocalProblems):
    """Functions of a pair."""

    def far_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """1 where it is too far to touch over the step."""
        problem, kinematics = self.of_pair(fields, kind)
        (near,) = problem.model.touching.near(None)
        motion = of_nodes(near.nodes, problem.touching_way(kinematics))
        return {"far": (near.pairs.slack(motion)[0] > 0).to(problem.t)}

    def pair(self, held: bool, kind: PairKind, **fields: Tensor) -> Fields:
        """What a pair gives its nodes: its push (w) on their balances, and blocks (w, w), those of
        each by the moves of each; `passed`, see `StepProblem.passed`. Where supports hold nodes
        (`held`), blocks of what is free of them, and a node's whole row (w, 6 w).
        """
        problem, kinematics = self.of_pair(fields, kind)
        problem = by_secants(problem, fields)
        touching, w = problem.model.touching, self.model.space.unknowns
        nodes = problem.TANGENT(problem.motion, kinematics)
        motion = problem.touching_motion(kinematics, nodes)
        (near,) = touching.near(motion)
        push = touching.loaded(problem.t.new_zeros(len(PAIR_SIDES), w), lambda: motion)
        blocks = touching.by_moves(near, motion)[0]
        passed = touching.passed(lambda: problem.touching_way(kinematics))
        outputs = {"passed": passed.to(push)}
        for k, side in enumerate(PAIR_SIDES):
            outputs[f"{side}.push"] = push[k]
            if held:
                outputs[f"{side}.row"] = torch.cat([*blocks[k]], -1)
        free = {side: fields[f"{side}.free"] for side in PAIR_SIDES} if held else {}
        for name, (row, column) in PAIR_BLOCKS.items():
            block = blocks[PAIR_SIDES.index(row), PAIR_SIDES.index(column)]
            outputs[name] = block * free[row][:, None] * free[column] if held else block
        return outputs

    def finish_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """Its work over the step."""
        problem, kinematics = self.of_pair(fields, kind)
        return {"work": problem.model.touching.work(lambda: problem.touching_way(kinematics))}

    def transposed_pair(self, held: bool, kind: PairKind, **fields: Tensor) -> Fields:
        """Blocks in the transposed matrix; where supports hold nodes, with what cotangents of their
        reactions are to the balances (`reaction`) of the nodes, what is asked of their moves
        (`asked`, w).
        """
        pushes = {side: fields.pop(f"{side}.reaction") for side in PAIR_SIDES if held}
        outputs = self.pair(held, kind, **fields)
        turned = {name: outputs[name[::-1]].mT for name in PAIR_BLOCKS}
        if not held:
            return turned
        asked = sum(push @ outputs[f"{side}.row"] for side, push in pushes.items())
        parts = asked.split(self.model.space.unknowns)
        return turned | {f"{side}.asked": x for side, x in zip(PAIR_SIDES, parts, strict=True)}

    def of_pair(self, fields: Fields, kind: PairKind) -> tuple[Any, Any]:
        """The problem of one pair, whose nodes have no loads, and how they move."""
        ends = self.of_ends(fields, kind, Framework(1, (), len(PAIR_SIDES)))
        pairs = filled(self.pairs, lambda k: fields[f"pair.{k}"][None])
        if not kind.surface and isinstance(pairs, SurfacePairs):
            pairs = pairs.curves
        if not kind.rubs:
            pairs = replace(pairs, friction=None, slip_speed=None)
        if not kind.damps:
            pairs = replace(pairs, damping=None)
        touching = OnePair(ends.rows.space, self.model.touching.moves.detach(), pairs)
        problem, x = self._problem(
            replace(ends.rows, touching=touching), None, ends.common, ends.given, ends.now
        )
        x = problem.apply_supports(x)
        return problem, problem.node_balance(x)[0]
