"""Local functions that all interactions have in common: what follows from their blocks, see
`sorts`; and what each says of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

from torch import Tensor
from torch.nn.functional import pad

from ...nodal.acting import ActingLoad
from ...nodal.between_nodes import BetweenNodes
from ...nodal.model import Model
from ...scene.effects import Inputs
from .local_problem import Fields, LocalProblems
from .row_kinds import EndKind
from .sorts import LAST, OWN

GAPS = "gap_position", "gap_rotation"
FORCES = "force", "last_force", "after_force", "force_bar"  # of constraints
Several = dict[int, ActingLoad]  # loads that act on several nodes, by their numbers
Later = Callable[[], Tensor]


@dataclass(frozen=True)
class InteractionFunctions:
    """Local functions of one of `Rows.interactions`, row by row, see `LocalFunctions.of`; and what
    a model has of it: `edges` and `kinds`, by row.
    """

    problems: LocalProblems

    @staticmethod
    def possible(model: Model, held: list[EndKind]) -> tuple[Any, ...]:
        """All kinds that there may be, where rows come and go; held: what holds the nodes."""
        return ()

    @staticmethod
    def values(model: Model, t: Tensor, inputs: Inputs, end: Later) -> Fields:
        """By name what changes, of what `constants` are made: at t (...), or at a step's end."""
        return {}

    @staticmethod
    def constants(model: Model, values: Fields) -> Any:
        """A tree of its rows; None = it has none."""
        return None

    @staticmethod
    def fields(model: Model) -> dict[str, tuple[int, ...]]:
        """Shapes of what its functions read, beside constants and ends."""
        return {}


def is_block(name: str) -> bool:
    """Whether a field is a block, by its name."""
    return len(name) == 2


def pushed(push: Tensor, sides: tuple[str, ...], blocks: Tensor, own: str = "") -> Fields:
    """Pushes (n, q) on the ends at these sides, and blocks (m, m, q, q) of these and its own
    unknowns.
    """
    outputs = {f"{side}.push": x for side, x in zip(sides, push, strict=True)}
    pairs = product(enumerate((*sides, *own)), repeat=2)
    return outputs | {row + column: blocks[i, j] for (i, row), (j, column) in pairs}


def of_ends(
    problem: Any, x: Any, one: BetweenNodes, sides: tuple[str, ...], own: str = ""
) -> Fields:
    """`pushed` of the one that acts in a problem at unknowns x; with unknowns of its own also what
    its constraints are to change by (`rhs`, w), and the largest gap and turn.
    """
    x, w, rows = problem.apply_supports(x), problem.model.space.unknowns, len(sides) + len(own)
    kinematics, inertia, _ = problem.node_balance(x)
    motion = problem.node_motion(kinematics, problem.node_tangent(kinematics, inertia)[0])
    none = x.stress.new_zeros(len(sides), w, w)
    push, gap = one.balance(none[..., 0], x.stress.new_zeros(0, w), x.stress, motion)
    blocks = one.matrix(problem.model.topology.diagonal(none), x.stress, motion).tied
    blocks = none.new_zeros(rows**2, w, w) if blocks is None else blocks
    outputs = pushed(push, sides, blocks.unflatten(0, (rows, rows)), own)
    if not own:
        return outputs
    sizes = zip(GAPS, gap[0].abs().split(problem.model.space.dims[:2]), strict=True)
    return outputs | {"rhs": -gap[0]} | {name: size.amax() for name, size in sizes}


def free_blocks(**fields: Tensor) -> Fields:
    """Blocks of what is `free` (w) of supports at the ends."""
    outputs = {}
    for name, block in fields.items():
        if is_block(name):
            row, column = (fields.get(f"{end}.free") for end in name)
            block = block if row is None else block * row[: len(block), None]
            outputs[name] = block if column is None else block * column[: block.shape[1]]
    return outputs


def end_reaction(side: str, end_free: Tensor, **fields: Tensor) -> Fields:
    """What it adds to the reaction of the support (w) of the node at a side, by the blocks of that
    row, and the moves of what their columns are of.
    """
    push = 0.0
    for name, block in fields.items():
        if is_block(name):
            push = push + block @ fields[f"{name[1]}.move"][: block.shape[1]]
    return {"reaction": (1 - end_free) * pad(push, (0, len(end_free) - len(push)))}


def transposed(outputs: Fields, reactions: Fields) -> Fields:
    """Blocks in the transposed matrix; with what cotangents of reactions (w) are to the balances of
    the ends, by side, what is asked of the moves of the ends (`asked`), and of unknowns of its own
    (`rhs`).
    """
    blocks = {name: block for name, block in outputs.items() if is_block(name)}
    asked: Fields = {}
    for (row, column), block in blocks.items():
        if row in reactions and column != LAST:
            name = "rhs" if column == OWN else f"{column}.asked"
            asked[name] = asked.get(name, 0.0) + reactions[row][: len(block)] @ block
    return {name[::-1]: block.mT for name, block in blocks.items()} | asked
