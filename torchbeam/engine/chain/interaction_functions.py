"""Local functions that all interactions have in common: what follows from their blocks, see
`interaction`.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import pad

from .interaction import LAST, OWN
from .local_problem import Fields


def is_block(name: str) -> bool:
    """Whether a field is a block, by its name."""
    return len(name) == 2


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
    (`right`).
    """
    blocks = {name: block for name, block in outputs.items() if is_block(name)}
    asked: Fields = {}
    for (row, column), block in blocks.items():
        if row in reactions and column != LAST:
            name = "right" if column == OWN else f"{column}.asked"
            asked[name] = asked.get(name, 0.0) + reactions[row][: len(block)] @ block
    return {name[::-1]: block.mT for name, block in blocks.items()} | asked
