"""Local functions of pairs that may touch, see `TouchingPairs`; the six nodes of a pair are called
a, b, c, those of the place, and d, e, f, those of the piece.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ...nodal.surface_pairs import SurfacePairs
from ...nodal.touching_forces import OnePair, of_nodes
from ...topology.framework import Framework
from .chain_constants import filled
from .interaction_functions import pushed
from .local_problem import Fields, LocalProblems, far_fields, told_to
from .node_kinds import PairKind
from .sorts import PAIR_SIDES


@dataclass(frozen=True)
class PairFunctions:
    """Functions of a pair."""

    problems: LocalProblems

    def far_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """1 where it is too far to touch over the step; `near`: where it is not."""
        problem, kinematics = self.problem(fields, kind)
        (near,) = problem.model.touching.near(None)
        way = problem.model.touching.way_of(problem.node_motion(kinematics))
        motion = of_nodes(near.nodes, way)
        return far_fields(near.pairs.far(motion)[0].to(problem.t))

    def pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """What a pair gives its nodes: its push (q) on their balances, and blocks (q, q), those of
        each by the moves of each, of the first q of w, see `coupled`; `passed`, see
        `StepProblem.passed`.
        """
        problem, kinematics = self.problem(fields, kind)
        problem = told_to(problem, "pairs", fields)
        touching, w = problem.model.touching, self.problems.model.space.unknowns
        nodes = problem.TANGENT(problem.motion, kinematics)
        motion = problem.node_motion(kinematics, nodes)
        (near,) = touching.near(None)
        push = touching.loaded(problem.t.new_zeros(len(PAIR_SIDES), w), motion)
        blocks = touching.by_moves(near, motion, touching.moves_of(motion))[0]
        passed, q = touching.passed(motion), self.coupled(kind)
        outputs = pushed(push[:, :q], PAIR_SIDES, blocks[..., :q, :q])
        if "told" in fields:
            outputs["told"] = touching.telling(motion)["pairs"]
        return {"passed": passed.to(push)} | outputs

    def coupled(self, kind: PairKind) -> int:
        """So many of a node's unknowns a pair pushes, and is moved by: without friction places
        alone.
        """
        space = self.problems.model.space
        return space.unknowns if kind.has_friction or kind.surface else space.dims.position

    def finish_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """Its work over the step."""
        problem, kinematics = self.problem(fields, kind)
        return {"work": problem.model.touching.work(problem.node_motion(kinematics))}

    def problem(self, fields: Fields, kind: PairKind) -> tuple[Any, Any]:
        """The problem of one pair, whose nodes have no loads, and how they move."""
        ends = self.problems.of_ends(fields, kind, Framework(1, (), len(PAIR_SIDES)))
        pairs = filled(self.problems.trees.pair, lambda k: fields[f"pair.{k}"][None])
        if isinstance(pairs, SurfacePairs):
            pairs = pairs.of(kind.surface)
        if not kind.has_friction:
            pairs = replace(pairs, friction=None, slip_speed=None)
        if not kind.has_taper:
            pairs = replace(pairs, taper=None)
        if not kind.has_damping:
            pairs = replace(pairs, damping=None)
        touching = OnePair(ends.rows.space, self.problems.model.touching.moves.detach(), pairs)
        problem, x = self.problems.problem(
            replace(ends.rows, touching=touching), None, ends.common, ends.values, ends.now
        )
        x = problem.apply_supports(x)
        return problem, problem.node_balance(x)[0]
