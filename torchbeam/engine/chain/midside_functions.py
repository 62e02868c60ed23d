"""Local functions of an element's midside node, which is eliminated with what the node itself adds:
to its rows an element of three nodes is one between two.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...topology.framework_unknowns import masked
from ...topology.midside_nodes import condensed, following
from ...topology.protocols import Topology
from .local_problem import Fields
from .row_functions import RowFunctions, total


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


def _between_free(free: Tensor) -> Tensor:
    """(3, w) of an element's nodes, whose ends are free."""
    return torch.stack((torch.ones_like(free), free, torch.ones_like(free)))
