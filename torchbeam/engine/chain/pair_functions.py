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
from .interaction import PAIR
from .interaction_functions import transposed
from .local_problem import Fields, LocalProblems, by_secants, far_fields
from .node_kinds import PAIR_SIDES, PairKind


@dataclass(frozen=True)
class PairFunctions(LocalProblems):
    """Functions of a pair."""

    def far_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """1 where it is too far to touch over the step; `near`: where it is not."""
        problem, kinematics = self.of_pair(fields, kind)
        (near,) = problem.model.touching.near(None)
        motion = of_nodes(near.nodes, problem.touching_way(kinematics))
        return far_fields(near.pairs.far(motion)[0].to(problem.t))

    def pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """What a pair gives its nodes: its push (q) on their balances, and blocks (q, q), those of
        each by the moves of each, of the first q of w, see `coupled`; `passed`, see
        `StepProblem.passed`.
        """
        problem, kinematics = self.of_pair(fields, kind)
        problem = by_secants(problem, fields)
        touching, w = problem.model.touching, self.model.space.unknowns
        nodes = problem.TANGENT(problem.motion, kinematics)
        motion = problem.touching_motion(kinematics, nodes)
        (near,) = touching.near(motion)
        push = touching.loaded(problem.t.new_zeros(len(PAIR_SIDES), w), lambda: motion)
        blocks, q = touching.by_moves(near, motion)[0], self.coupled(kind)
        passed = touching.passed(lambda: problem.touching_way(kinematics))
        outputs = {"passed": passed.to(push)}
        outputs |= {f"{side}.push": x for side, x in zip(PAIR_SIDES, push[:, :q], strict=True)}
        for name in PAIR.blocks:
            row, column = map(PAIR_SIDES.index, name)
            outputs[name] = blocks[row, column, :q, :q]
        return outputs

    def coupled(self, kind: PairKind) -> int:
        """So many of a node's unknowns a pair pushes, and is moved by: without friction places
        alone.
        """
        dims = self.model.space.dims
        return self.model.space.unknowns if kind.rubs or kind.surface else dims.position

    def finish_pair(self, kind: PairKind, **fields: Tensor) -> Fields:
        """Its work over the step."""
        problem, kinematics = self.of_pair(fields, kind)
        return {"work": problem.model.touching.work(lambda: problem.touching_way(kinematics))}

    def transposed_pair(self, held: bool, kind: PairKind, **fields: Tensor) -> Fields:
        """See `interaction_functions.transposed`."""
        reactions = {side: fields.pop(f"{side}.reaction") for side in PAIR_SIDES if held}
        return transposed(self.pair(kind, **fields), reactions)

    def of_pair(self, fields: Fields, kind: PairKind) -> tuple[Any, Any]:
        """The problem of one pair, whose nodes have no loads, and how they move."""
        ends = self.of_ends(fields, kind, Framework(1, (), len(PAIR_SIDES)))
        pairs = filled(self.pairs, lambda k: fields[f"pair.{k}"][None])
        if isinstance(pairs, SurfacePairs):
            pairs = pairs.of(kind.surface)
        if not kind.rubs:
            pairs = replace(pairs, friction=None, slip_speed=None)
        if not kind.tapers:
            pairs = replace(pairs, taper=None)
        if not kind.damps:
            pairs = replace(pairs, damping=None)
        touching = OnePair(ends.rows.space, self.model.touching.moves.detach(), pairs)
        problem, x = self._problem(
            replace(ends.rows, touching=touching), None, ends.common, ends.given, ends.now
        )
        x = problem.apply_supports(x)
        return problem, problem.node_balance(x)[0]
