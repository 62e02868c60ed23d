"""Couplings in native code, an `Interaction` of a scene each: kinds and local functions. Its nodes
are called a, b, c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

from torch import Tensor
from torch.nn.functional import pad

from ...equations.balance_problem import BalanceProblem
from ...nodal import interactions
from ...nodal.acting import ActingLoad
from ...nodal.conditions import Conditions
from ...nodal.model import Model
from ...topology.framework import Framework
from .chain_constants import CommonConditions
from .interaction_functions import FORCES, InteractionFunctions, Several, of_ends
from .local_problem import Ends, Fields
from .row_kinds import EndKind
from .sorts import OWN, PAIR_SIDES, Edge, Edges, Sort


class CouplingKind(NamedTuple):
    """What code of an `Interaction` depends on: what holds its nodes; its number among the loads in
    `CommonConditions`; its row of `Couplings.held`, () = it has no unknowns; the most numbers that
    one of a scene remembers.
    """

    ends: tuple[EndKind, ...]
    load: int
    held: tuple[float, ...] = ()
    kept: int = 0
    told: ClassVar[int] = 0

    sides = property(lambda self: PAIR_SIDES[: len(self.ends)])
    multiplied = property(lambda self: bool(self.held))


@dataclass(frozen=True)
class CouplingFunctions(InteractionFunctions):
    """Functions of a coupling."""

    @staticmethod
    def edges(model: Model) -> Edges:
        return tuple(Edge(act.nodes, act.unknowns or None) for act in model.scene.interactions)

    @staticmethod
    def kinds(model: Model, held: list[EndKind], several: Several) -> tuple[CouplingKind, ...]:
        w, kinds = model.space.unknowns, []
        for k, act in several.items():
            count = act.load.unknowns
            unknowns = tuple(float(j < count) for j in range(w)) if count else ()
            ends = tuple(held[node] for node in act.node)
            kinds.append(CouplingKind(ends, k, unknowns, model.scene.memory[1]))
        return tuple(kinds)

    @staticmethod
    def fields(model: Model) -> dict[str, tuple[int, ...]]:
        forces = dict.fromkeys(FORCES, (model.space.unknowns,))
        return forces | {"memory": (model.scene.memory[1],)}

    def balance(self, kind: CouplingKind, **fields: Tensor) -> Fields:
        """Its push (w) on the balances of its nodes, and its blocks (w, w), see `of_ends`."""
        problem, x = self.problem(fields, kind)
        unit = OWN if kind.multiplied else ""
        return of_ends(problem, x, problem.model.couplings, kind.sides, unit)

    def finish(self, kind: CouplingKind, **fields: Tensor) -> Fields:
        """Its work over the step, its forces, and what it remembers."""
        problem, x = self.problem(fields, kind)
        kinematics = problem.node_balance(problem.apply_supports(x))[0]
        outputs = {"work": problem.t.new_zeros(()) + problem.work(kinematics)}
        outputs |= {"force": fields["force"]} if kind.multiplied else {}
        if not kind.kept:
            return outputs
        after, motion = {"stress": x.stress}, problem.node_motion(kinematics)
        memory = problem.model.couplings.finished(after, motion, None, None).get("memory")
        memory = x.stress.new_zeros(1, 0) if memory is None else memory
        return outputs | {"memory": pad(memory[0], (0, kind.kept - memory.shape[-1]))}

    def solution(self, kind: CouplingKind, **fields: Tensor) -> Fields:
        """The unknown forces of a step (w), from those that have acted in it."""
        return {"force": fields["after_force"]}

    def problem(self, fields: Fields, kind: CouplingKind) -> tuple[BalanceProblem, Any]:
        """The problem of one coupling, whose nodes have no other loads, and its unknowns."""
        ends = self.problems.of_ends(fields, kind, Framework(1, (), len(kind.sides)))
        now = self._coupled(ends, ends.common.now, kind)
        values, own = ends.values, ()
        if kind.multiplied:
            held = fields["force"].new_tensor([kind.held])
            own, values = (held, held.new_ones(())), values | {"stress": fields["force"][None]}
        values |= {"memory": fields["memory"][None]} if kind.kept else {}
        rows = replace(ends.rows, couplings=interactions.Couplings(ends.rows.space, *own))
        problem, x = self.problems.problem(rows, None, ends.common, values, now)
        if ends.common.before is not None:
            before = self._coupled(ends, ends.common.before, kind)
            problem = replace(problem, before=before)
        return problem, x

    def _coupled(self, ends: Ends, shared: CommonConditions, kind: CouplingKind) -> Conditions:
        """Conditions with the interaction."""
        load, nodes = shared.loads[kind.load], tuple(range(len(kind.sides)))
        acting = ActingLoad(load, nodes, ends.rows.depends_on(load), None)
        return replace(ends.now, interactions=(acting,))


COUPLING = Sort("coupling", "coupling", "couplings", ("coupling_state",), sides=PAIR_SIDES,
                functions=CouplingFunctions, unknowns=True, kept="memory")  # fmt: skip
