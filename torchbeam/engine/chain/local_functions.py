"""Local functions of an implicit step, the midpoint's as they are: what one node and one element
do, by named fields.

They are those of `local_problem`; an element condenses its stress. The balance of all and its
blocks are the sums of both.

Fields have no axes of the batch: of a node's `node.k`, `common.k` and `support.k` (the tensors of
`NodeConstants`, `Common` and `SupportConstants`, in order), position, rotation, velocity, spin and
internal states at the start, u and m; of an element's `element.k` and the stress, with an axis of
its stations, and the same of its nodes, behind `i.` and `j.`, or `i.`, `m.`, `j.`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...equations.balance_problem import BalanceProblem
from ...equations.step_problem import StepProblem
from ...nodal import element_loads, loads
from ...nodal.balance import dstress, most_strains, pushed_by, restrained_forces
from ...state.state import State
from .interaction_functions import transposed
from .interaction_sorts import INTERACTIONS
from .local_problem import (
    INELASTIC,
    INTERNAL,
    Fields,
    LocalProblems,
    acting_loads,
    far_fields,
    told_to,
)
from .own_batch import unbatched
from .row_kinds import ElementKind, NodeKind
from .sample_functions import SampleFunctions
from .sorts import ELEMENT, LOAD, NODE, Sort


@dataclass(frozen=True)
class LocalFunctions(LocalProblems):
    """Functions of nodes, of elements and of what acts between nodes; and those of the adjoint."""

    def of(self, sort: Sort) -> Any:
        """The functions of something between nodes: its `balance`, `finish`, what becomes of it at
        the end, and `far`, whether it does nothing, where it asks so.
        """
        return sort.functions(self)

    def balance(self, sort: Sort) -> Callable[..., Fields]:
        """The function of the balance of a sort of rows."""
        own = {NODE: self.node, ELEMENT: self.element, LOAD: self.element_load}
        return own[sort] if sort in own else self.of(sort).balance

    def far(self, sort: Sort) -> Callable[..., Fields]:
        """The function that says whether a row does nothing."""
        return self.far_element_load if sort is LOAD else self.of(sort).far

    def finished(self, sort: Sort, kind: Any, **fields: Tensor) -> Fields:
        """A row at the end of the step."""
        own = {NODE: self.finish_node, ELEMENT: self.finish_element, LOAD: self.finish_element_load}
        return (own[sort] if sort in own else self.of(sort).finish)(kind, **fields)

    def points_told(self, sort: Sort, kind: Any) -> int:
        """At how many points of a row an iteration tells the next one something."""
        if sort is NODE:
            acting = acting_loads(kind, self.trees.node.now.loads, self.trees.common.now.loads)
            return sum(load.rubbing_points for load in acting)
        if sort is LOAD:
            acting = (self.trees.common.now.loads[k] for k in kind.loads)
            return sum(load.points for load in acting if load.rubs)
        return 0 if sort is ELEMENT else kind.told

    @property
    def samples(self) -> SampleFunctions:
        """Functions of a sample."""
        return SampleFunctions(self.model)

    @property
    def loaded(self) -> bool:
        """Whether nodes have a term of loads."""
        return bool(self.model.scene.loads)

    @property
    def searches(self) -> bool:
        """Whether steps of Newton's method may be shortened."""
        far = [self.trees.between[x.constants] is not None for x in INTERACTIONS if x.far]
        return any(far) or any(load.touches for load in self.model.scene.loads)

    # Functions of a node

    def predictor(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """u and m to start from."""
        problem, _ = self.of_node(fields, kind)
        x = problem.predictor()
        return {"u": x.u[0], "m": x.m[0]}

    def node(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """Balance (w) of the node's inertia and loads, its derivative D (w, w); both terms
        apart.
        """
        problem, x = self.of_node(fields, kind)
        problem = told_to(problem, "bodies", fields)
        x = problem.apply_supports(x)  # they are; but so that derivatives know it
        kinematics, inertia, load = problem.node_balance(x)
        matrix, w = problem.node_tangent(kinematics, inertia)[1], self.model.space.unknowns
        load, D = unbatched(load + x[0].new_zeros(1, w), 2)[0], x[0].new_zeros(w, w)
        terms = {} if inertia is None else {"inertia": inertia.wrench[0]}
        balance = -load if inertia is None else inertia.wrench[0] - load
        if self.loaded:
            terms["load"] = load
        if isinstance(problem, StepProblem):
            terms["rounding"] = problem.rounding[0]
            if self.model.bodies_touch:
                through = problem.body_passed_through(kinematics)
                near = problem.body_near(kinematics)
                for name, flag in (("passed_through", through), ("near", near)):
                    terms[name] = balance.new_zeros(()) if flag is None else flag.to(balance)
        if "told" in fields:
            now = problem.conditions
            terms["told"] = loads.telling(problem.model, problem.nodes(kinematics), now)["bodies"]
        return {"balance": balance, "D": D if matrix is None else D + matrix.diagonal[0], **terms}

    def update(self, kind: NodeKind, move: Tensor, **fields: Tensor) -> Fields:
        """The unknowns of a node after a move (w), supports applied."""
        problem, x = self.of_node(fields, kind)
        after = problem.apply_supports(problem.update(x, move[None], x.stress))
        return {name: value[0] for name, value in zip(after._fields, after[:2], strict=False)}

    def cosine(self, m: Tensor) -> Fields:
        """Of half the angle that a node has turned by at mid step."""
        return {"cosine": self.model.space.cosine(m)}

    def finish_node(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """The node at the end of the step, and the work done on it; `found` (w): the reaction of
        its support.
        """
        problem, x = self.of_node(fields, kind)
        reaction = (
            x.u.new_zeros(0, self.model.space.unknowns)
            if kind.support is None
            else fields["found"][None]
        )
        after = problem.finish(x, reaction)
        fields_after = {name: getattr(after, name)[0] for name in self.NODE} | {"work": after.work}
        if INTERNAL in self.state:
            states = (
                {}
                if after.internal is None
                else dict(
                    zip(
                        kind.acting,
                        unbatched(after.internal, 1).split([self.internal[k] for k in kind.acting]),
                        strict=True,
                    )
                )
            )
            still = fields[INTERNAL].split(self.internal)
            fields_after[INTERNAL] = torch.cat([states.get(k, still[k]) for k in range(len(still))])
        return fields_after | self.energies(problem, after)

    def energies(self, problem: StepProblem, after: State) -> Fields:
        """Those of a node at the end of the step: none are asked for."""
        return {}

    # Functions of an element

    def element(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """What an element gives its nodes: balance (w), `asked` (w), the same with what its
        condensed stress adds, and the blocks D (w, w), each by node, U from i to j and L back, or
        between i, m and j (2, w, w), far_U and far_L then from i to j and back; gap (stations, k)
        and E (stations, k, numbers of a station), by which its stress follows the moves; inertia
        (w) by node, if it has any; the largest force, moment, strain, curvature and gap in it.
        """
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        kinematics, inertia, load = problem.node_balance(x)
        element = problem.element_balance(x, kinematics)
        tangent, strain = problem.tangent(x, kinematics, element, inertia), problem.eigenstrain
        wrench = None
        if self.trees.element.rows.coupling is not None:
            wrench = (
                inertia.wrench
                if inertia is not None
                else None
                if isinstance(load, float)
                else -load
            )
        model, p, assembly = problem.model, self.model.space.dims.position, problem.model.assembly
        balance = assembly.to_nodes(element.forces)
        asked = balance + assembly.to_nodes(
            pushed_by(tangent.force_operator, tangent.stiffness, element.constitutive_residual)
        )
        if wrench is not None:
            balance, asked = balance + wrench, asked + wrench
        forces, effective_strain = [element.forces], [element.effective_strain]
        if isinstance(strain, Tensor):
            forces.append(restrained_forces(model, element.acting, strain, model.length))
            effective_strain.append(strain)
        forces, effective_strain = (
            torch.cat([x.expand(self.order, x.shape[-1]) for x in part], -2).abs()
            for part in (forces, effective_strain)
        )
        left = most_strains(element.constitutive_residual, problem.element.rounding)
        D, U, L, *far = tangent.matrix.tensors
        found = {
            "D": D,
            "balance": balance,
            "asked": asked,
            **({} if wrench is None else {"inertia": wrench}),
        }
        found = {
            f"{side}.{name}": value[k]
            for name, value in found.items()
            for k, side in enumerate(self.sides)
        }
        if far:
            found |= {"far_U": far[0][0], "far_L": far[1][0]}
        return found | {
            "U": U if far else U[0],
            "L": L if far else L[0],
            "gap": element.constitutive_residual,
            "E": tangent.strain_by_move,
            "hB": tangent.force_operator,
            "force": forces[..., :p].amax(),
            "moment": forces[..., p:].amax(),
            **dict(zip(("left_strain", "left_curvature"), left, strict=True)),
            **dict(zip(("strain", "curvature"), most_strains(effective_strain), strict=True)),
        }

    def finish_element(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """The element at the end of the step, of what it remembers."""
        if INELASTIC not in self.element_state:
            return {}
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        kinematics = problem.motion.kinematics(x.u, x.m)
        return problem.crept(kinematics.position_end, kinematics.q_end)

    # Functions of the loads between an element's nodes

    def far_element_load(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """1 where these loads do nothing; `near`: where they may."""
        problem, kinematics = self._between(fields, kind)
        return far_fields(problem.idle(kinematics).to(problem.t))

    def element_load(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """What they add to what `element` gives its nodes; the largest force and moment; in a step
        `passed_through`, see `StepProblem.passed_through`.
        """
        problem, kinematics = self._between(fields, kind)
        problem = told_to(problem, "elements", fields)
        parts = problem.element_loads(kinematics)
        D, U, L, *far = problem.element_load_matrix(kinematics).tensors
        wrench, p = problem.model.topology.scatter(parts), self.model.space.dims.position
        outputs = {"balance": -wrench, "asked": -wrench, "D": D}
        found = {
            f"{side}.{name}": value[k]
            for name, value in outputs.items()
            for k, side in enumerate(self.sides)
        }
        found |= {"far_U": far[0][0], "far_L": far[1][0]} if far else {}
        through = problem.passed_through(kinematics)
        if "told" in fields:
            now = problem.conditions
            nodes = problem.nodes(kinematics)
            found["told"] = element_loads.telling(problem.model, nodes, now)["elements"]
        return found | {
            "U": U if far else U[0],
            "L": L if far else L[0],
            "force": wrench[..., :p].abs().amax(),
            "moment": wrench[..., p:].abs().amax(),
            **({} if through is None else {"passed_through": through.to(wrench)}),
        }

    def finish_element_load(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """The work that they do over the step."""
        problem, kinematics = self._between(fields, kind)
        return {"work": problem.work(kinematics)}

    def _between(self, fields: Fields, kind: ElementKind) -> tuple[BalanceProblem, Any]:
        problem, x = self.of_element(fields, kind, between=True)
        return problem, problem.node_balance(problem.apply_supports(x))[0]

    # Functions of an element's stress

    def stress(self, stress: Tensor, gap: Tensor, E: Tensor, **fields: Tensor) -> Fields:
        """The stress (stations, k) after the moves of its nodes, `i.move` and so on (w)."""
        moves = torch.stack([fields[f"{side}.move"] for side in self.sides])
        C = self.element_constants(fields).C
        return {"stress": stress + dstress(C, E, gap, self.element_assembly.to_elements(moves))}

    # Functions of its row, see `RowFunctions`

    def terms(self, load: Tensor | None, inertia: Tensor | None) -> list[Tensor]:
        """Those of a node's balance (w) that its largest are looked for in, beside the
        elements'.
        """
        return [x for x in (load, inertia) if x is not None]

    def pivot(self, block: Tensor) -> Fields:
        """What is asked of a pivot block (w, w) of the elimination: nothing in a step."""
        return {}

    # Functions of the adjoint

    def solution(self, **fields: Tensor) -> Fields:
        """u and m of a step between two states of a node; fields: what is of it, and of the state
        after (`after_`).
        """
        way, turn = self.moved(fields)
        return {"u": way / 2, "m": self.model.space.sqrt(turn)}

    def moved(self, fields: Fields) -> tuple[Tensor, Tensor]:
        """How far a node went in a step, and how it turned."""
        position, rotation = self.end(fields)
        space = self.model.space
        return position - fields["position"], space.multiply(
            space.inverse(fields["rotation"]), rotation
        )

    def end(self, fields: Fields) -> tuple[Tensor, Tensor]:
        """Position and rotation to which the step's equations belong."""
        return fields["after_position"], fields["after_rotation"]

    def pushed(self, gap: Tensor, hB: Tensor, **fields: Tensor) -> Fields:
        """What an element's strain gap asks of its nodes (w)."""
        pushed = self.element_assembly.to_nodes(
            pushed_by(hB, self.element_constants(fields).C, gap)
        )
        return dict(zip(self.sides, pushed, strict=True))

    def transposed_interaction(self, sort: Sort, held: bool, kind: Any, **fields: Tensor) -> Fields:
        """Of an interaction, see `interaction_functions.transposed`; of what has unknowns of its
        own with what cotangents ask of these: `force_bar`.
        """
        reactions = {side: fields.pop(f"{side}.reaction") for side in kind.sides if held}
        rhs = fields.pop("force_bar", None)
        outputs = transposed(self.balance(sort)(kind, **fields), reactions)
        if not kind.multiplied:
            return outputs
        rhs = rhs * rhs.new_tensor(kind.held)
        return outputs | {"rhs": rhs + outputs.get("rhs", 0.0)}

    def multiplier_update(self, force: Tensor, move: Tensor) -> Fields:
        """Forces of constraints (w) after they have changed."""
        return {"force": force + move}
