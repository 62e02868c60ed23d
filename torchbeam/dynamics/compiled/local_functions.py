"""Local functions of an implicit step, the midpoint's as they are: what one node and one element do, by named fields.

They are those of `local_problem`; an element condenses its stress. A chain's balance and its blocks are the sums of both.

Fields have no axes of the batch: of a node's `node.k`, `common.k` and `support.k` (the tensors of `NodeConstants`, `Common` and
`SupportConstants`, in order), position, rotation, velocity, spin and internal states at the start, u and m; of an element's
`element.k`, the stress, and the same of its nodes, behind `i.` and `j.`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.status import BROKEN, DIVERGED, SUCCESS
from ...math.block_tridiagonal import eliminated
from ...nodal.balance import Linearisation, dstress, mixed, restrained_forces, scaled
from ...nodal.constitutive_law import times
from ...nodal.model import Model
from ...solvers.newton import converged
from ...state.state import State
from ..midpoint import MidpointProblem
from ..step_element import ElementBalance
from .chain_constants import filled
from .local_problem import INTERNAL, ElementKind, Fields, LocalProblems, NodeKind


@dataclass(frozen=True)
class LocalFunctions(LocalProblems):
    """Functions of nodes, of elements, of rows of the chain, of samples; and those of the adjoint."""

    # Functions of a node

    def predictor(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """u and m to start from."""
        problem, _ = self.of_node(fields, kind)
        x = problem.predictor()
        return {"u": x.u[0], "m": x.m[0]}

    def node(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """Balance (w) of the node's inertia and loads, its derivative D (w, w); both terms apart."""
        problem, x = self.of_node(fields, kind)
        x = problem.apply_supports(x)  # they are; but so that derivatives know it
        way, inertia, load = problem.node_balance(x)
        _, (D,) = problem.node_tangent(way, inertia)
        load = load + torch.zeros_like(inertia.wrench)
        return {"balance": (inertia.wrench - load)[0], "D": D[0], "inertia": inertia.wrench[0],
                **({"load": load[0]} if self.model.scene.loads else {})}

    def update(self, kind: NodeKind, move: Tensor, **fields: Tensor) -> Fields:
        """u and m after a move (w), supports applied."""
        problem, x = self.of_node(fields, kind)
        after = problem.apply_supports(problem.update(x, move[None], x.stress))
        return {"u": after.u[0], "m": after.m[0]}

    def cosine(self, m: Tensor) -> Fields:
        """Of half the angle that a node has turned by at mid step."""
        return {"cosine": self.model.space.cosine(m)}

    def finish(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """The node at the end of the step, and the work done on it; `found` (w): the reaction of its support."""
        problem, x = self.of_node(fields, kind)
        reaction = x.u.new_zeros(0, self.model.space.unknowns) if kind.support is None else fields["found"][None]
        after = problem.finish(x, reaction)
        found = {name: getattr(after, name)[0] for name in self.NODE} | {"work": after.work}
        if INTERNAL in self.state:
            own = dict(zip(kind.acting, after.internal.split([self.internal[k] for k in kind.acting]), strict=True)
                       if after.internal is not None else ())
            still = fields[INTERNAL].split(self.internal)
            found[INTERNAL] = torch.cat([own.get(k, still[k]) for k in range(len(still))])
        return found | self.energies(problem, after)

    def energies(self, problem: MidpointProblem, after: State) -> Fields:
        """Those of a node at the end of the step: none are asked for."""
        return {}

    # Functions of an element

    def element(self, kind: ElementKind, **fields: Tensor) -> Fields:
        """What an element gives its nodes: balance (w), `asked` (w), the same with what its condensed stress adds, and the
        blocks D (w, w), each for i and j, U from i to j and L back; gap (k) and EC (k, p + 2 s), by which its stress follows
        the moves; inertia (w) for i and j, if it has any; the largest force, moment, gap and strain in it.
        """
        problem, x = self.of_element(fields, kind)
        x = problem.apply_supports(x)
        model = problem.model
        way, inertia, _ = problem.node_balance(x)
        element = problem.element_balance(x, way)
        tangent = problem.linearise(x, way, element, inertia)
        wrench = None if self.elements.coupling is None else inertia.wrench
        return self.condensed(model, element, model.own, tangent, wrench)

    def condensed(self, model: Model, element: ElementBalance, own: Tensor | float, tangent: Linearisation,
                  wrench: Tensor | None) -> Fields:
        """Fields of `element`, of which `own` is the eigenstrain, and `wrench` the inertia if it has any."""
        space, p = model.space, model.space.position
        balance = space.to_nodes(element.forces)
        asked = balance + space.to_nodes(tangent.pushed(element.gap))
        if wrench is not None:
            balance, asked = balance + wrench, asked + wrench
        forces, felt = [element.forces], [element.felt]
        if isinstance(own, Tensor):
            forces.append(restrained_forces(model, element.acting, own, model.length))
            felt.append(own)
        forces, felt = (torch.cat([x.expand(1, x.shape[-1]) for x in part], -2).abs() for part in (forces, felt))
        found = {"D": tangent.D, "balance": balance, "asked": asked, **({} if wrench is None else {"inertia": wrench})}
        found = {f"{side}.{name}": value[k] for name, value in found.items() for k, side in enumerate("ij")}
        return found | {
            "U": tangent.U[0], "L": tangent.L[0], "gap": element.gap[0], "E": tangent.E[0], "hB": tangent.hB[0],
            "force": forces[..., :p].amax(), "moment": forces[..., p:].amax(), "left_strain": element.gap.abs().amax(),
            "strain": felt.amax()}

    def stress(self, stress: Tensor, gap: Tensor, E: Tensor, move_i: Tensor, move_j: Tensor, **fields: Tensor) -> Fields:
        """The stress (k) after its nodes' moves."""
        C = filled(self.elements, lambda k: fields[f"element.{k}"][None]).C
        move = self.model.space.to_elements(torch.stack((move_i, move_j)))
        return {"stress": stress + dstress(C, E[None], gap[None], move)[0]}

    # Functions of the chain's rows

    def row(self, held: bool, **fields: Tensor) -> Fields:
        """A row of the elimination, from the fields of `node` (own.) and of the elements on either side, whose nodes j and i it
        is: ahead (w, w) and y (w), see `block_tridiagonal.eliminated`; the largest force and moment in the node's terms, and
        left of its balance. Where supports hold the node or its neighbours (`held`): with what is free (w, 1 or 0) of it, the
        node before and the next; and the whole rows (w, 3 w) and balance of the node, for a reaction.
        """
        p = self.model.space.position

        def total(name: str) -> Tensor:
            parts = [fields[f"{side}.{name}"] for side in ("own", "left", "right") if f"{side}.{name}" in fields]
            return sum(parts[1:], parts[0])

        balance, D = total("balance"), total("D")
        asked, U, L = total("asked") + fields["own.balance"], fields["right.U"], fields["left.L"]
        sides = [name for name in fields if name.endswith(".inertia")]
        terms = torch.stack(self.terms(fields.get("own.load"), total("inertia") if sides else None)).abs()
        found, left = {}, balance
        if held:
            before, free, after = (fields[f"free_{name}"] for name in ("before", "here", "after"))
            found = {"rows": torch.cat((L, D, U), -1), "asked": asked}
            left, asked = balance * free, asked * free
            D = D * free[:, None] * free + torch.diag_embed(1 - free)
            L, U = L * free[:, None] * before, U * free[:, None] * after
        ahead, y = eliminated(D, U, -asked[:, None], L, fields["ahead"], fields["y"][:, None])
        left = left.abs()
        return found | self.pivot(D - L @ fields["ahead"]) | {
            "ahead": ahead, "y": y[:, 0], "force": terms[:, :p].amax(), "moment": terms[:, p:].amax(),
            "left_force": left[:p].amax(), "left_moment": left[p:].amax()}

    def terms(self, load: Tensor | None, inertia: Tensor | None) -> list[Tensor]:
        """Those of a node's balance (w) that its largest are looked for in, beside the elements'."""
        return [x for x in (load, inertia) if x is not None]

    def pivot(self, block: Tensor) -> Fields:
        """What is asked of a pivot block (w, w) of the elimination: nothing in a step."""
        return {}

    def back(self, ahead: Tensor, y: Tensor, next: Tensor) -> Fields:
        """The move of a node, from that of the next."""
        return {"move": y - (ahead @ next[:, None])[:, 0]}

    def reaction(self, rows: Tensor, asked: Tensor, free: Tensor, before: Tensor, here: Tensor, after: Tensor) -> Fields:
        """The balance (w) of a support after the moves of the node before, of its own and of the next."""
        return {"reaction": (1 - free) * (asked + (rows @ torch.cat((before, here, after))[:, None])[:, 0])}

    # Functions of the adjoint

    def solution(self, position: Tensor, rotation: Tensor, after_position: Tensor, after_rotation: Tensor) -> Fields:
        """u and m of a step between two states of a node."""
        space = self.model.space
        turn = space.multiply(space.inverse(rotation), after_rotation)
        return {"u": (after_position - position) / 2, "m": space.sqrt(turn)}

    def pushed(self, gap: Tensor, hB: Tensor, **fields: Tensor) -> Fields:
        """What an element's strain gap asks of its nodes (w)."""
        C = filled(self.elements, lambda k: fields[f"element.{k}"][None]).C
        found = self.model.space.to_nodes((hB[None].mT @ times(C, gap[None, :, None]))[..., 0])
        return {"i": found[0], "j": found[1]}

    def transposed_row(self, held: bool, right: Tensor, **fields: Tensor) -> Fields:
        """A row of the elimination of the transposed matrix, see `row`, for what moves are asked for (w); where supports are
        near, also for what their balances are (`push_` before, here, after).
        """
        D = fields["own.D"] + fields["left.D"] + fields["right.D"]
        below, above = fields["left.U"].mT, fields["right.L"].mT
        if held:
            before, free, after = (fields[f"free_{name}"] for name in ("before", "here", "after"))
            pushes = (fields[f"push_{name}"] for name in ("before", "here", "after"))
            right = right + sum((block @ push[:, None])[:, 0] for block, push in zip((below, D.mT, above), pushes, strict=True))
            right = right * free
            D = D * free[:, None] * free + torch.diag_embed(1 - free)
            below, above = below * free[:, None] * before, above * free[:, None] * after
        ahead, y = eliminated(D.mT, above, right[:, None], below, fields["ahead"], fields["y"][:, None])
        return {"ahead": ahead, "y": y[:, 0]}

    def push(self, reaction_bar: Tensor, free: Tensor) -> Fields:
        """What the cotangent of a reaction is to the balance of its node (w)."""
        return {"push": (1 - free) * reaction_bar}

    def balance_bar(self, move: Tensor, push: Tensor, free: Tensor) -> Fields:
        """Cotangent of a node's balance (w), from the solution of the transposed rows."""
        return {"balance_bar": push - free * move}

    # Functions of a sample

    def judge(self, force: Tensor, moment: Tensor, strain: Tensor, left_force: Tensor, left_moment: Tensor,
              left_strain: Tensor, total: Tensor, longest: Tensor, exact: Tensor, tolerance: Tensor, before: Tensor,
              over: Tensor, done: Tensor, status: Tensor, iterations: Tensor) -> Fields:
        """What `newton` asks of an iteration's largest numbers: size of the residual, which samples are done or over,
        iterations, and the status of those that are not done (that of the first iteration, when `iterations` was 0).
        """
        size = scaled(left_force, left_moment, left_strain, *mixed(force, moment, total, longest), strain)
        finite = torch.isfinite(size)
        first = torch.where(finite, float(DIVERGED), float(BROKEN))
        going = over == 0
        done = torch.where(going & converged(size, before, exact != 0, tolerance), torch.ones_like(done), done)
        return {"before": size, "done": done, "over": ((done != 0) | ~finite).to(done),
                "status": torch.where(iterations == 0, first, status), "iterations": iterations + going.to(iterations)}

    def outcome(self, moving: Tensor, done: Tensor, status: Tensor, before: Tensor, cosine: Tensor, least: Tensor) -> Fields:
        """The status (that of `before` where a sample does not move): it has converged and no node has turned too far; and
        whether it moves on.
        """
        status = torch.where(done != 0, torch.where(cosine < least, float(DIVERGED), float(SUCCESS)), status)
        status = torch.where(moving != 0, status, before)
        return {"status": status, "moving": ((status == SUCCESS) & (moving != 0)).to(moving)}
