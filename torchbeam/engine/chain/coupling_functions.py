"""Local functions of couplings: of an `Interaction` of a scene, whose nodes are called a, b, c."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor
from torch.nn.functional import pad

from ...equations.balance_problem import BalanceProblem
from ...nodal import interactions
from ...nodal.acting import ActingLoad
from ...nodal.conditions import Conditions
from ...topology.framework import Framework
from .chain_constants import CommonConditions
from .interaction_functions import of_ends
from .local_problem import Ends, Fields, LocalProblems
from .node_kinds import CouplingKind
from .sorts import OWN


@dataclass(frozen=True)
class CouplingFunctions:
    """Functions of a coupling."""

    problems: LocalProblems

    def coupling(self, kind: CouplingKind, **fields: Tensor) -> Fields:
        """Its push (w) on the balances of its nodes, and its blocks (w, w), see `of_ends`."""
        problem, x = self.problem(fields, kind)
        unit = OWN if kind.multiplied else ""
        return of_ends(problem, x, problem.model.couplings, kind.sides, unit)

    def finish_coupling(self, kind: CouplingKind, **fields: Tensor) -> Fields:
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

    def coupling_solution(self, kind: CouplingKind, **fields: Tensor) -> Fields:
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

    def _coupled(self, ends: Ends, alike: CommonConditions, kind: CouplingKind) -> Conditions:
        """Conditions with the interaction."""
        load, nodes = alike.loads[kind.load], tuple(range(len(kind.sides)))
        acting = ActingLoad(load, nodes, ends.rows.depends_on(load), None)
        return replace(ends.now, interactions=(acting,))
