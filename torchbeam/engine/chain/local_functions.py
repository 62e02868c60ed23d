"""Local functions of an implicit step, the midpoint's as they are: what one node and one element
do, by named fields.

They are those of `local_problem`; an element condenses its stress. The balance of all and its
blocks are the sums of both. The midside node of an element of three nodes is eliminated
(`condense`) with what the node itself adds: to its row an element of any order is one between two
nodes.

Fields have no axes of the batch: of a node's `node.k`, `common.k` and `support.k` (the tensors of
`NodeConstants`, `Common` and `SupportConstants`, in order), position, rotation, velocity, spin and
internal states at the start, u and m; of an element's `element.k` and the stress, with an axis of
its stations, and the same of its nodes, behind `i.` and `j.`, or `i.`, `m.`, `j.`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.status import BROKEN, DIVERGED, SUCCESS
from ...equations.balance_problem import BalanceProblem
from ...equations.step_problem import StepProblem
from ...math.block_tridiagonal import eliminated
from ...nodal import element_loads, loads
from ...nodal.balance import dstress, mixed, most_beyond, pushed_by, restrained_forces, scaled
from ...nodal.multipliers import measured
from ...solvers.newton import Length, converged, first_wait, step_length
from ...state.state import State
from ...topology.framework_unknowns import masked
from ...topology.midside_nodes import condensed, following
from ...topology.protocols import Topology
from .coupling_functions import CouplingFunctions
from .interaction_functions import transposed
from .joint_functions import JointFunctions
from .layout import FLAGS
from .local_problem import INTERNAL, Fields, far_fields, told_to, unbatched
from .node_kinds import ElementKind, NodeKind
from .pair_functions import PairFunctions
from .tendon_functions import TendonFunctions


class WholeRow(NamedTuple):
    """A row of the matrix, however it is eliminated: D, L, U (w, w); what is asked of it
    and left of its balance (w); where supports hold nodes, the whole row and balance by name.
    """

    D: Tensor
    L: Tensor
    U: Tensor
    asked: Tensor
    left: Tensor
    blocks: Fields


@dataclass(frozen=True)
class LocalFunctions(JointFunctions, TendonFunctions, PairFunctions, CouplingFunctions):
    """Functions of nodes, of elements, of rows of the chain, of samples; and those of the
    adjoint.
    """

    @property
    def loaded(self) -> bool:
        """Whether nodes have a term of loads."""
        return bool(self.model.scene.loads)

    @property
    def searches(self) -> bool:
        """Whether steps of Newton's method may be shortened."""
        return self.pairs is not None or any(load.touches for load in self.model.scene.loads)

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
                passed = problem.body_passed(kinematics)
                near = problem.body_near(kinematics)
                for name, flag in (("passed", passed), ("near", near)):
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

    def between(self, u: Tensor, m: Tensor, to_u: Tensor, to_m: Tensor, ratio: Tensor) -> Fields:
        """The unknowns of a node, so much of the way from u and m to others."""
        m = self.model.space.normalize(torch.lerp(m, to_m, ratio))
        return {"u": torch.lerp(u, to_u, ratio), "m": m}

    @staticmethod
    def part(x: Tensor, to: Tensor, ratio: Tensor) -> Fields:
        """The stress of an element, or multipliers, so much of the way from x."""
        return {"x": torch.lerp(x, to, ratio)}

    def cosine(self, m: Tensor) -> Fields:
        """Of half the angle that a node has turned by at mid step."""
        return {"cosine": self.model.space.cosine(m)}

    def finish(self, kind: NodeKind, **fields: Tensor) -> Fields:
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
            own = (
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
            fields_after[INTERNAL] = torch.cat([own.get(k, still[k]) for k in range(len(still))])
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
        (w) by node, if it has any; the largest force, moment, gap and strain in it.
        """
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        kinematics, inertia, load = problem.node_balance(x)
        element = problem.element_balance(x, kinematics)
        tangent, own = problem.tangent(x, kinematics, element, inertia), problem.eigenstrain
        wrench = None
        if self.elements.rows.coupling is not None:
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
        if isinstance(own, Tensor):
            forces.append(restrained_forces(model, element.acting, own, model.length))
            effective_strain.append(own)
        forces, effective_strain = (
            torch.cat([x.expand(self.order, x.shape[-1]) for x in part], -2).abs()
            for part in (forces, effective_strain)
        )
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
            "left_strain": most_beyond(element.constitutive_residual, problem.element.rounding),
            "strain": effective_strain.amax(),
        }

    # Functions of the loads between an element's nodes

    def far(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """1 where these loads do nothing; `near`: where they may."""
        problem, kinematics = self._between(fields, kind)
        return far_fields(problem.idle(kinematics).to(problem.t))

    def element_load(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """What they add to what `element` gives its nodes; the largest force and moment; in a step
        `passed`, see `StepProblem.passed`.
        """
        problem, kinematics = self._between(fields, kind)
        problem = told_to(problem, "elements", fields)
        parts = problem.element_loads(kinematics)
        D, U, L, *far = problem.element_load_matrix(kinematics).tensors
        wrench, p = problem.model.topology.scatter(parts), self.model.space.dims.position
        given = {"balance": -wrench, "asked": -wrench, "D": D}
        found = {
            f"{side}.{name}": value[k]
            for name, value in given.items()
            for k, side in enumerate(self.sides)
        }
        found |= {"far_U": far[0][0], "far_L": far[1][0]} if far else {}
        passed = problem.passed(kinematics)
        if "told" in fields:
            now = problem.conditions
            nodes = problem.nodes(kinematics)
            found["told"] = element_loads.telling(problem.model, nodes, now)["elements"]
        return found | {
            "U": U if far else U[0],
            "L": L if far else L[0],
            "force": wrench[..., :p].abs().amax(),
            "moment": wrench[..., p:].abs().amax(),
            **({} if passed is None else {"passed": passed.to(wrench)}),
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

    # Functions of an element's midside node

    def condense(self, held: bool, **fields: Tensor) -> Fields:
        """What an element of three nodes gives its ends without the one between, as one of two
        nodes does: from the fields of `node` of the midside node (own.) and those of the element
        (element.). With it own (w), by_i and by_j (w, w), see `restore`; the largest force and
        moment in the midside node's terms, and left of its balance. Where a support holds it
        (`held`): with what is free (w, 1 or 0) of it; and its whole rows (w, 3 w) and balance, for
        a reaction.
        """
        element = {
            name.removeprefix("element."): x
            for name, x in fields.items()
            if name.startswith("element.")
        }
        (D, U, L, *far), balance = self._blocks(fields), fields["own.balance"]
        asked = torch.stack((element["i.asked"], element["m.asked"] + balance, element["j.asked"]))
        left, rows = balance + element["m.balance"], torch.cat((L[0], D[1], U[1]), -1)
        outputs = {"rows": rows, "asked": asked[1]} if held else {}
        if held:
            free = _between_free(fields["free"])
            D, U, L, *far = masked(self._element, free, D, U, L, *far)
            left, asked = left * free[1], asked * free
        inertia = _total(fields.get("own.inertia"), element.get("m.inertia"))
        sizes = self._sizes(fields, inertia, left)
        outputs |= self.pivot(D[1]) | sizes
        D, U, L, middle = condensed(self._element, D, U, L, *far)
        ends, own = middle.condense(-asked)
        for k, (side, by) in enumerate(zip("ij", (middle.by_i, middle.by_j), strict=True)):
            same = f"{side}.balance", f"{side}.inertia"
            outputs |= {name: element[name] for name in same if name in element}
            outputs |= {f"{side}.D": D[k], f"{side}.asked": -ends[k], f"by_{side}": by[0]}
        return outputs | {"U": U[0], "L": L[0], "own": own[0]}

    @property
    def _element(self) -> Topology:
        """One."""
        return self.element_assembly.topology

    def _blocks(self, fields: Fields) -> tuple[Tensor, ...]:
        """(D, U, L, far upper, far lower) of one element, with D of its midside node's
        own.
        """
        D = torch.stack(
            (fields["element.i.D"], fields["element.m.D"] + fields["own.D"], fields["element.j.D"])
        )
        return (
            D,
            fields["element.U"],
            fields["element.L"],
            fields["element.far_U"][None],
            fields["element.far_L"][None],
        )

    def restore(
        self, own: Tensor, by_i: Tensor, by_j: Tensor, before: Tensor, after: Tensor
    ) -> Fields:
        """The move (w) of a midside node from those of its element's ends."""
        return {"move": following(own, by_i, by_j, before, after)}

    # Functions of rows

    def row(self, held: bool, backward: bool = False, **fields: Tensor) -> Fields:
        """A row of the elimination, from the fields of `node` (own.) and of the elements on either
        side, whose nodes j and i it is: ahead (w, w) and y (w), see `block_tridiagonal.eliminated`;
        the largest force and moment in the node's terms, and left of its balance. Where supports
        hold the node or its neighbours (`held`): with what is free (w, 1 or 0) of it, the node
        before and the next; and the whole rows (w, 3 w) and balance of the node, for a reaction.

        backward: of an elimination from the last node to the first, whose row before is that of the
        next node. With `side` (w, w), by which the row before follows from a node in front of all:
        that of this row.
        """
        row = self._whole_row(held, fields)
        D, L, U = (row.D, row.U, row.L) if backward else (row.D, row.L, row.U)
        right, y = -row.asked[:, None], fields["y"][:, None]
        if "side" in fields:
            right = torch.cat((right, torch.zeros_like(D)), -1)
            y = torch.cat((y, fields["side"]), -1)
        ahead, y = eliminated(D, U, right, L, fields["ahead"], y)
        sizes = self._sizes(fields, _of_row(fields, "inertia"), row.left)
        outputs = row.blocks | self.pivot(D - L @ fields["ahead"]) | {"ahead": ahead, "y": y[:, 0]}
        return outputs | ({"side": y[:, 1:]} if "side" in fields else {}) | sizes

    def interface(self, held: bool, **fields: Tensor) -> Fields:
        """The row of a node that joints hold, which push it (w): D, L and U (w, w), what is asked
        of it (`right`, w); sizes, and for a reaction its whole row and balance, as in `row`.
        """
        row = self._whole_row(held, fields)
        sizes = self._sizes(fields, _of_row(fields, "inertia"), row.left)
        return {"D": row.D, "L": row.L, "U": row.U, "right": -row.asked} | row.blocks | sizes

    def _whole_row(self, held: bool, fields: Fields) -> WholeRow:
        balance, D = _of_row(fields, "balance"), _of_row(fields, "D")
        asked, U, L = (
            _of_row(fields, "asked") + fields["own.balance"],
            fields["right.U"],
            fields["left.L"],
        )
        if "push" in fields:
            balance, asked = balance + fields["push"], asked + fields["push"]
        blocks, left = {}, balance
        if held:
            free = fields["free_here"]
            blocks = {"rows": torch.cat((L, D, U), -1), "asked": asked}
            left, asked = balance * free, asked * free
            D, L, U = _masked_row(D, L, U, fields)
        return WholeRow(D, L, U, asked, left, blocks)

    def _sizes(self, fields: Fields, inertia: Tensor | None, left: Tensor) -> Fields:
        """The largest force and moment in a node's terms, and left of its balance (w) beyond
        rounding; whether a body is near what it touches, and passes through it.
        """
        p = self.model.space.dims.position
        terms = torch.stack(self.terms(fields.get("own.load"), inertia)).abs()
        left = left.abs()
        if "own.rounding" in fields:
            left = left - fields["own.rounding"]
        sizes = {
            "force": terms[:, :p].amax(),
            "moment": terms[:, p:].amax(),
            "left_force": left[:p].amax(),
            "left_moment": left[p:].amax(),
            **{name: fields[f"own.{name}"] for name in FLAGS if f"own.{name}" in fields},
        }
        if not self.searches:
            return sizes
        square = left.clamp(min=0).square()
        return sizes | {"square_force": square[:p].sum(), "square_moment": square[p:].sum()}

    def terms(self, load: Tensor | None, inertia: Tensor | None) -> list[Tensor]:
        """Those of a node's balance (w) that its largest are looked for in, beside the
        elements'.
        """
        return [x for x in (load, inertia) if x is not None]

    def pivot(self, block: Tensor) -> Fields:
        """What is asked of a pivot block (w, w) of the elimination: nothing in a step."""
        return {}

    def back(
        self,
        ahead: Tensor,
        y: Tensor,
        next: Tensor,
        side: Tensor | None = None,
        first: Tensor | None = None,
    ) -> Fields:
        """The move of a node, from that of the next, and from that of the `first` in front of
        all.
        """
        move = y - (ahead @ next[:, None])[:, 0]
        return {"move": move if side is None else move - (side @ first[:, None])[:, 0]}

    def reaction(
        self, rows: Tensor, asked: Tensor, free: Tensor, before: Tensor, here: Tensor, after: Tensor
    ) -> Fields:
        """The balance (w) of a support after the moves of the node before, of its own and of the
        next.
        """
        return {
            "reaction": (1 - free)
            * (asked + (rows @ torch.cat((before, here, after))[:, None])[:, 0])
        }

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

    def transposed_condense(self, held: bool, right: Tensor, **fields: Tensor) -> Fields:
        """As `condense`, of the transposed matrix, for what moves are asked for of the midside node
        (w): the blocks of the ends as they are, not transposed, and what is added to what is asked
        of them; where a support holds it, also for what its balance is (`push`).
        """
        D, U, L, *far = self._blocks(fields)
        sides = torch.zeros_like(D[:2, 0])
        if held:
            free, push = _between_free(fields["free"]), fields["push"][:, None]
            right = (right + (D[1].mT @ push)[:, 0]) * free[1]
            sides = torch.stack(((L[0].mT @ push)[:, 0], (U[1].mT @ push)[:, 0]))
            D, U, L, *far = masked(self._element, free, D, U, L, *far)
        D, L, U, middle = condensed(self._element, D.mT, L.mT, U.mT, *(x.mT for x in reversed(far)))
        ends, own = middle.condense(
            torch.stack((torch.zeros_like(right), right, torch.zeros_like(right)))
        )
        outputs = {"U": U[0].mT, "L": L[0].mT, "own": own[0]}
        for k, (side, by) in enumerate(zip("ij", (middle.by_i, middle.by_j), strict=True)):
            outputs |= {
                f"{side}.D": D[k].mT,
                f"by_{side}": by[0],
                f"right_{side}": ends[k] + sides[k],
            }
        return outputs

    def transposed_restore(
        self, own: Tensor, by_i: Tensor, by_j: Tensor, before: Tensor, after: Tensor
    ) -> Fields:
        """As `restore`, of the transposed matrix, from the cotangents of its ends' balances (w)."""
        return self.restore(own, by_i, by_j, -before, -after)

    def transposed_row(
        self, held: bool, right: Tensor, backward: bool = False, **fields: Tensor
    ) -> Fields:
        """A row of the elimination of the transposed matrix, see `row`, for what moves are asked
        for (w); where supports are near, also for what their balances are (`push_` before, here,
        after).
        """
        D, below, above, right = self._transposed_whole_row(held, right, fields)
        if backward:
            below, above = above, below
        right, y = right[:, None], fields["y"][:, None]
        if "side" in fields:
            right = torch.cat((right, torch.zeros_like(D)), -1)
            y = torch.cat((y, fields["side"]), -1)
        ahead, y = eliminated(D.mT, above, right, below, fields["ahead"], y)
        return {"ahead": ahead, "y": y[:, 0]} | ({"side": y[:, 1:]} if "side" in fields else {})

    def transposed_interface(self, held: bool, right: Tensor, **fields: Tensor) -> Fields:
        """As `interface`, of the transposed matrix."""
        D, below, above, right = self._transposed_whole_row(held, right, fields)
        return {"D": D.mT, "L": below, "U": above, "right": right}

    def _transposed_whole_row(
        self, held: bool, right: Tensor, fields: Fields
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """D as it is, what couples the transposed row to the one before and to the next, and what
        is asked of it (w).
        """
        D = fields["own.D"] + fields["left.D"] + fields["right.D"]
        below, above = fields["left.U"].mT, fields["right.L"].mT
        if held:
            pushes = (fields[f"push_{name}"] for name in ("before", "here", "after"))
            right = right + sum(
                (block @ push[:, None])[:, 0]
                for block, push in zip((below, D.mT, above), pushes, strict=True)
            )
            right = right * fields["free_here"]
            D, below, above = _masked_row(D, below, above, fields)
        return D, below, above, right

    def transposed_interaction(self, name: str, held: bool, kind: Any, **fields: Tensor) -> Fields:
        """Of an interaction, see `interaction_functions.transposed`; of what has unknowns of its
        own with what cotangents ask of these: `force_bar`.
        """
        reactions = {side: fields.pop(f"{side}.reaction") for side in kind.sides if held}
        right = fields.pop("force_bar", None)
        outputs = transposed(getattr(self, name)(kind, **fields), reactions)
        if not kind.multiplied:
            return outputs
        right = right * right.new_tensor(kind.held)
        return outputs | {"right": right + outputs.get("right", 0.0)}

    def multiplier_update(self, force: Tensor, move: Tensor) -> Fields:
        """Forces of constraints (w) after they have changed."""
        return {"force": force + move}

    def push(self, reaction_bar: Tensor, free: Tensor) -> Fields:
        """What the cotangent of a reaction is to the balance of its node (w)."""
        return {"push": (1 - free) * reaction_bar}

    def balance_bar(self, move: Tensor, push: Tensor, free: Tensor) -> Fields:
        """Cotangent of a node's balance (w), from the solution of the transposed rows."""
        return {"balance_bar": push - free * move}

    # Functions of a sample

    def search(
        self,
        square_force: Tensor,
        square_moment: Tensor,
        longest: Tensor,
        iterations: Tensor,
        over: Tensor,
        merit: Tensor,
        share: Tensor,
        waited: Tensor,
        near: Tensor,
        best_near: Tensor,
        **judged: Tensor,
    ) -> Fields:
        """What becomes of the last step, see `Length`; `forth`: which samples do not take it back,
        `still`: which make no other one, `stays`: which do not go to the best; `best_near`: whether
        anything is near enough to touch at the best. judged: what `_converged` takes.
        """
        free = (over == 0) & (iterations > 0) & ~self._converged(longest=longest, **judged)[1]
        free = free & ((near != 0) | (best_near != 0))
        patient = self.model.patient
        waited = torch.where(iterations > 0, waited, first_wait(patient))
        now = square_force * longest.square() + square_moment
        length = step_length(now, merit, share, waited, free, patient)
        outputs = {name: value.to(over) for name, value in length._asdict().items()}
        still, forth = torch.maximum(over, outputs["back"]), 1 - outputs["back"]
        outputs["stays"] = (length.ratio > 0).to(over)
        near = torch.where(length.worse, best_near, near)
        return outputs | {"still": still, "forth": forth, "best_near": near}

    def _converged(
        self,
        exact: Tensor,
        tolerance: Tensor,
        before: Tensor,
        foresee: Tensor | None = None,
        **sizes: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Size of the residual; whether it is small enough, see `converged`. sizes: what `_size`
        takes.
        """
        size = self._size(**sizes)
        if foresee is None and not self.model.smooth:
            foresee = size < 0  # never
        return size, converged(size, before, exact != 0, tolerance, foresee)

    def _size(
        self,
        force: Tensor,
        moment: Tensor,
        strain: Tensor,
        left_force: Tensor,
        left_moment: Tensor,
        left_strain: Tensor,
        total: Tensor,
        longest: Tensor,
        **joints: Tensor,
    ) -> Tensor:
        """The scaled residual; joints: the largest gap and turn of joints, and the size of what
        they connect.
        """
        size = scaled(
            left_force, left_moment, left_strain, *mixed(force, moment, total, longest), strain
        )
        return self.with_gaps(size, joints)

    def judge(
        self,
        before: Tensor,
        over: Tensor,
        done: Tensor,
        status: Tensor,
        iterations: Tensor,
        back: Tensor | None = None,
        ratio: Tensor | None = None,
        **judged: Tensor,
    ) -> Fields:
        """What `newton` asks of an iteration's largest numbers: size of the residual, which samples
        are done or over, iterations, the status of those that are not done (that of the first
        iteration, when `iterations` was 0). judged: what `_converged` takes.
        """
        size, ends = self._converged(before=before, **judged)
        finite = torch.isfinite(size)
        first = torch.where(finite, float(DIVERGED), float(BROKEN))
        going = over == 0
        done = torch.where(going & ends, torch.ones_like(done), done)
        length = None
        if back is not None:
            length = Length(back, back != 0, ratio, back, back, back)
        return {
            "before": size if length is None else length.before(before, size),
            "done": done,
            "over": ((done != 0) | ~finite).to(done),
            "status": torch.where(iterations == 0, first, status),
            "iterations": iterations + going.to(iterations),
        }

    def with_gaps(self, size: Tensor, joints: Fields) -> Tensor:
        """A scaled residual with the gaps of joints, if there are any, see `judge`."""
        if not joints:
            return size
        apart = joints["gap_position"] / joints["constraint_size"]
        return measured(size, torch.maximum(apart, joints["gap_rotation"]))

    def outcome(
        self,
        moving: Tensor,
        done: Tensor,
        status: Tensor,
        before: Tensor,
        cosine: Tensor,
        least: Tensor,
        passed: Tensor | None = None,
    ) -> Fields:
        """The status (that of `before` where a sample does not move): it has converged, and no node
        has turned too far or passed through what it is to touch; and whether it moves on.
        """
        lost = cosine < least if passed is None else (cosine < least) | (passed != 0)
        status = torch.where(done != 0, torch.where(lost, float(DIVERGED), float(SUCCESS)), status)
        status = torch.where(moving != 0, status, before)
        return {"status": status, "moving": ((status == SUCCESS) & (moving != 0)).to(moving)}


def _total(*parts: Tensor | None) -> Tensor | None:
    """Of those that are there."""
    there = [x for x in parts if x is not None]
    return sum(there[1:], there[0]) if there else None


def _of_row(fields: Fields, name: str) -> Tensor | None:
    """Of a row's node and the elements on either side."""
    return _total(*(fields.get(f"{side}.{name}") for side in ("own", "left", "right")))


def _between_free(free: Tensor) -> Tensor:
    """(3, w) of an element's nodes, whose ends are free."""
    return torch.stack((torch.ones_like(free), free, torch.ones_like(free)))


def _masked_row(D: Tensor, L: Tensor, U: Tensor, fields: Fields) -> tuple[Tensor, Tensor, Tensor]:
    """A row of the matrix, see `masked`."""
    before, free, after = (fields[f"free_{name}"] for name in ("before", "here", "after"))
    return (
        D * free[:, None] * free + torch.diag_embed(1 - free),
        L * free[:, None] * before,
        U * free[:, None] * after,
    )
