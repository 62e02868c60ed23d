"""Pairs that may touch in native code: kinds and local functions, see `TouchingPairs`. The nodes of
a pair are called a, b, c, those of the place, and d, e, f, those of the piece.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

from torch import Tensor

from ...nodal.centreline import piece_nodes
from ...nodal.model import Model
from ...nodal.surface_pairs import SurfacePairs
from ...nodal.touching_forces import KnownPairs, OnePair, of_nodes
from ...topology.framework import Framework
from .chain_constants import filled
from .interaction_functions import InteractionFunctions, Several, pushed
from .layout import PAIRS
from .local_problem import Fields, far_fields, told_to
from .row_kinds import EndKind
from .sorts import PAIR_SIDES, Edge, Edges, Sort


class PairKind(NamedTuple):
    """What code of a pair that may touch depends on, see `TouchingPairs`: what holds its six nodes;
    its law, see `PairLaw`.
    """

    ends: tuple[EndKind, ...]
    has_friction: bool
    has_damping: bool
    surface: type | None
    has_taper: bool
    multiplied: ClassVar[bool] = False
    kept: ClassVar[int] = 0

    sides = property(lambda self: PAIR_SIDES)
    told = property(lambda self: int(self.has_friction))


@dataclass(frozen=True)
class PairFunctions(InteractionFunctions):
    """Functions of a pair."""

    @staticmethod
    def edges(model: Model) -> Edges:
        return tuple(map(Edge, getattr(model.touching, "nodes", ())))

    @staticmethod
    def kinds(model: Model, held: list[EndKind], several: Several) -> tuple[PairKind, ...]:
        """Of a model whose pairs are known."""
        if not isinstance(model.touching, KnownPairs):
            return ()
        return tuple(
            PairKind(tuple(held[node] for node in nodes), *law)
            for nodes, law in zip(model.touching.nodes, model.touching.laws, strict=True)
        )

    @staticmethod
    def possible(model: Model, held: list[EndKind]) -> tuple[PairKind, ...]:
        """None where none is near."""
        if not isinstance(model.touching, KnownPairs) or not model.touching.nodes:
            return ()
        possible = {}
        for touching in model.touching.each:
            points, pieces = (
                dict.fromkeys(tuple(held[node] for node in nodes) for nodes in rows)
                for rows in (piece_nodes(*touching.along), touching.pieces)
            )
            possible |= dict.fromkeys(
                PairKind(a + b, *touching.law) for a in points for b in pieces
            )
        return tuple(possible)

    @staticmethod
    def constants(model: Model, values: Fields) -> Any:
        return getattr(model.touching, "pairs", None)

    def far(self, kind: PairKind, **fields: Tensor) -> Fields:
        """1 where it is too far to touch over the step; `near`: where it is not."""
        problem, kinematics = self.problem(fields, kind)
        (near,) = problem.model.touching.near(None)
        way = problem.model.touching.way_of(problem.node_motion(kinematics))
        motion = of_nodes(near.nodes, way)
        return far_fields(near.pairs.far(motion)[0].to(problem.t))

    def balance(self, kind: PairKind, **fields: Tensor) -> Fields:
        """What a pair gives its nodes: its push (q) on their balances, and blocks (q, q), those of
        each by the moves of each, of the first q of w, see `coupled`; `passed_through`, see
        `StepProblem.passed_through`.
        """
        problem, kinematics = self.problem(fields, kind)
        problem = told_to(problem, "pairs", fields)
        touching, w = problem.model.touching, self.problems.model.space.unknowns
        nodes = problem.TANGENT(problem.motion, kinematics)
        motion = problem.node_motion(kinematics, nodes)
        (near,) = touching.near(None)
        push = touching.loaded(problem.t.new_zeros(len(PAIR_SIDES), w), motion)
        blocks = touching.by_moves(near, motion, touching.moves_of(motion))[0]
        through, q = touching.passed_through(motion), self.coupled(kind)
        outputs = pushed(push[:, :q], PAIR_SIDES, blocks[..., :q, :q])
        if "told" in fields:
            outputs["told"] = touching.telling(motion)["pairs"]
        return {"passed_through": through.to(push)} | outputs

    def coupled(self, kind: PairKind) -> int:
        """So many of a node's unknowns a pair pushes, and is moved by: without friction places
        alone.
        """
        space = self.problems.model.space
        return space.unknowns if kind.has_friction or kind.surface else space.dims.position

    def finish(self, kind: PairKind, **fields: Tensor) -> Fields:
        """Its work over the step."""
        problem, kinematics = self.problem(fields, kind)
        return {"work": problem.model.touching.work(problem.node_motion(kinematics))}

    def problem(self, fields: Fields, kind: PairKind) -> tuple[Any, Any]:
        """The problem of one pair, whose nodes have no loads, and how they move."""
        ends = self.problems.of_ends(fields, kind, Framework(1, (), len(PAIR_SIDES)))
        pairs = filled(self.problems.trees.between["pair"], lambda k: fields[f"pair.{k}"][None])
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


PAIR = Sort("pair", "pair", PAIRS, ("told pairs",), sides=PAIR_SIDES,
            functions=PairFunctions, far=True)  # fmt: skip
