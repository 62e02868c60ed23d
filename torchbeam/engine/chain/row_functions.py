"""Local functions of rows of the matrix: of a run of nodes, which is eliminated as it is made, of
nodes of the interface, and those of the transposed matrix. A midside node is eliminated with what
the node itself adds: to its rows an element of three nodes is one between two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ...math.block_tridiagonal import eliminated
from ...topology.framework_unknowns import masked
from ...topology.midside_nodes import condensed, following
from ...topology.protocols import Topology
from .layout import FLAGS
from .local_functions import LocalFunctions
from .local_problem import Fields


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
class RowFunctions:
    """Functions of rows, of what the functions of nodes and of elements give."""

    local: LocalFunctions

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
        sizes = self.sizes(fields, _of_row(fields, "inertia"), row.left)
        pivot = self.local.pivot(D - L @ fields["ahead"])
        return row.blocks | pivot | _eliminated(D, U, -row.asked, L, fields) | sizes

    def interface(self, held: bool, **fields: Tensor) -> Fields:
        """The row of a node that joints hold, which push it (w): D, L and U (w, w), what is asked
        of it (`rhs`, w); sizes, and for a reaction its whole row and balance, as in `row`.
        """
        row = self._whole_row(held, fields)
        sizes = self.sizes(fields, _of_row(fields, "inertia"), row.left)
        return {"D": row.D, "L": row.L, "U": row.U, "rhs": -row.asked} | row.blocks | sizes

    def _whole_row(self, held: bool, fields: Fields) -> WholeRow:
        balance, D = _of_row(fields, "balance"), _of_row(fields, "D")
        asked = _of_row(fields, "asked") + fields["own.balance"]
        U, L = fields["right.U"], fields["left.L"]
        if "push" in fields:
            balance, asked = balance + fields["push"], asked + fields["push"]
        blocks, left = {}, balance
        if held:
            free = fields["free_here"]
            blocks = {"rows": torch.cat((L, D, U), -1), "asked": asked}
            left, asked = balance * free, asked * free
            D, L, U = _masked_row(D, L, U, fields)
        return WholeRow(D, L, U, asked, left, blocks)

    def sizes(self, fields: Fields, inertia: Tensor | None, left: Tensor) -> Fields:
        """The largest force and moment in a node's terms, and left of its balance (w) beyond
        rounding; whether a body is near what it touches, and passes through it.
        """
        p = self.local.model.space.dims.position
        terms = torch.stack(self.local.terms(fields.get("own.load"), inertia)).abs()
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
        if not self.local.searches:
            return sizes
        square = left.clamp(min=0).square()
        return sizes | {"square_force": square[:p].sum(), "square_moment": square[p:].sum()}

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

    def transposed_row(
        self, held: bool, rhs: Tensor, backward: bool = False, **fields: Tensor
    ) -> Fields:
        """A row of the elimination of the transposed matrix, see `row`, for what moves are asked
        for (w); where supports are near, also for what their balances are (`push_` before, here,
        after).
        """
        D, below, above, rhs = self._transposed_whole_row(held, rhs, fields)
        if backward:
            below, above = above, below
        return _eliminated(D.mT, above, rhs, below, fields)

    def transposed_interface(self, held: bool, rhs: Tensor, **fields: Tensor) -> Fields:
        """As `interface`, of the transposed matrix."""
        D, below, above, rhs = self._transposed_whole_row(held, rhs, fields)
        return {"D": D.mT, "L": below, "U": above, "rhs": rhs}

    def _transposed_whole_row(
        self, held: bool, rhs: Tensor, fields: Fields
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """D as it is, what couples the transposed row to the one before and to the next, and what
        is asked of it (w).
        """
        D = fields["own.D"] + fields["left.D"] + fields["right.D"]
        below, above = fields["left.U"].mT, fields["right.L"].mT
        if held:
            pushes = (fields[f"push_{name}"] for name in ("before", "here", "after"))
            rhs = rhs + sum(
                (block @ push[:, None])[:, 0]
                for block, push in zip((below, D.mT, above), pushes, strict=True)
            )
            rhs = rhs * fields["free_here"]
            D, below, above = _masked_row(D, below, above, fields)
        return D, below, above, rhs

    def push(self, reaction_bar: Tensor, free: Tensor) -> Fields:
        """What the cotangent of a reaction is to the balance of its node (w)."""
        return {"push": (1 - free) * reaction_bar}

    def balance_bar(self, move: Tensor, push: Tensor, free: Tensor) -> Fields:
        """Cotangent of a node's balance (w), from the solution of the transposed rows."""
        return {"balance_bar": push - free * move}


def _eliminated(D: Tensor, U: Tensor, rhs: Tensor, L: Tensor, fields: Fields) -> Fields:
    """What is left of a row (D, U, L), of which `rhs` (w) is asked, see `eliminated`."""
    rhs, y = rhs[:, None], fields["y"][:, None]
    if "side" in fields:
        rhs = torch.cat((rhs, torch.zeros_like(D)), -1)
        y = torch.cat((y, fields["side"]), -1)
    ahead, y = eliminated(D, U, rhs, L, fields["ahead"], y)
    side = {"side": y[:, 1:]} if "side" in fields else {}
    return {"ahead": ahead, "y": y[:, 0]} | side


def total(*parts: Tensor | None) -> Tensor | None:
    """Of those that are there."""
    there = [x for x in parts if x is not None]
    return sum(there[1:], there[0]) if there else None


def _of_row(fields: Fields, name: str) -> Tensor | None:
    """Of a row's node and the elements on either side."""
    return total(*(fields.get(f"{side}.{name}") for side in ("own", "left", "right")))


def _masked_row(D: Tensor, L: Tensor, U: Tensor, fields: Fields) -> tuple[Tensor, Tensor, Tensor]:
    """A row of the matrix, see `masked`."""
    before, free, after = (fields[f"free_{name}"] for name in ("before", "here", "after"))
    return (
        D * free[:, None] * free + torch.diag_embed(1 - free),
        L * free[:, None] * before,
        U * free[:, None] * after,
    )


@dataclass(frozen=True)
class MidsideFunctions:
    """Functions of a midside node; rows: those of the rows that it is a part of."""

    rows: RowFunctions

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
        inertia = total(fields.get("own.inertia"), element.get("m.inertia"))
        sizes = self.rows.sizes(fields, inertia, left)
        outputs |= self.rows.local.pivot(D[1]) | sizes
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
        return self.rows.local.element_assembly.topology

    def _blocks(self, fields: Fields) -> tuple[Tensor, ...]:
        """(D, U, L, far upper, far lower) of one element, with D of its midside node's own."""
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

    def transposed_condense(self, held: bool, rhs: Tensor, **fields: Tensor) -> Fields:
        """As `condense`, of the transposed matrix, for what moves are asked for of the midside node
        (w): the blocks of the ends as they are, not transposed, and what is added to what is asked
        of them; where a support holds it, also for what its balance is (`push`).
        """
        D, U, L, *far = self._blocks(fields)
        sides = torch.zeros_like(D[:2, 0])
        if held:
            free, push = _between_free(fields["free"]), fields["push"][:, None]
            rhs = (rhs + (D[1].mT @ push)[:, 0]) * free[1]
            sides = torch.stack(((L[0].mT @ push)[:, 0], (U[1].mT @ push)[:, 0]))
            D, U, L, *far = masked(self._element, free, D, U, L, *far)
        D, L, U, middle = condensed(self._element, D.mT, L.mT, U.mT, *(x.mT for x in reversed(far)))
        ends, own = middle.condense(
            torch.stack((torch.zeros_like(rhs), rhs, torch.zeros_like(rhs)))
        )
        outputs = {"U": U[0].mT, "L": L[0].mT, "own": own[0]}
        for k, (side, by) in enumerate(zip("ij", (middle.by_i, middle.by_j), strict=True)):
            outputs |= {
                f"{side}.D": D[k].mT,
                f"by_{side}": by[0],
                f"rhs_{side}": ends[k] + sides[k],
            }
        return outputs

    def transposed_restore(
        self, own: Tensor, by_i: Tensor, by_j: Tensor, before: Tensor, after: Tensor
    ) -> Fields:
        """As `restore`, of the transposed matrix, from the cotangents of its ends' balances (w)."""
        return self.restore(own, by_i, by_j, -before, -after)


def _between_free(free: Tensor) -> Tensor:
    """(3, w) of an element's nodes, whose ends are free."""
    return torch.stack((torch.ones_like(free), free, torch.ones_like(free)))
