"""Arguments that all ways to make a beam have: elements, order, where it starts, dtype."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ..core.arguments import count, instance
from ..core.memory import check_memory
from ..core.validation import (
    Value,
    as_tensor,
    axis_last,
    common_dtype,
    finite,
    positive,
    refusal,
    shown,
)
from ..core.warning import warn
from .curve import axes_along
from .section import Section
from .stations import STATIONS, Stations

# the last: a function of s, see `Beam.straight`
Sections = Section | Sequence[Section] | Callable[[Tensor], Section]

NUMBERS = 12  # at least, that an interval needs: node, axes of node and element, length


def intervals(elements: int, order: int) -> int:
    """Between nodes. Raises ValueError for fewer than one element, or another order than 1 or 2;
    MemoryError for more than there is memory for.
    """
    N = count("elements", elements) * check_order(order)
    check_memory(f"a beam of {elements} elements", NUMBERS * 8 * N, "fewer are wanted")
    return N


def check_order(order: int) -> int:
    """`order` if there are such elements; ValueError otherwise."""
    if type(order) is not int or order not in STATIONS:
        raise refusal(f"order = {shown(order)}", " or ".join(map(str, STATIONS)))
    return order


def placed(
    section: Sections, direction: Value, up: Value | None, root: Value, **sizes: Value
) -> tuple[list[Tensor], Tensor, Tensor]:
    """Arguments common to beams that start at a root: sizes by name, positive (those whose name
    begins with _ only take part in the dtype); axes (..., 3, 3) of the root; its position (..., 3).
    """
    for name, x in sizes.items():
        if not name.startswith("_") and (callable(x) or type(x).__name__ == "Input"):
            raise refusal(
                f"{name} as a function or an Input",
                "numbers (a Tendon has a length that changes in time)",
                are=True,
            )
    numbers = (direction, up, root, *sizes.values())
    dtype, device = dtype_with(section, *(x for x in numbers if not callable(x) and x is not None))
    known = [(name, x) for name, x in sizes.items() if not name.startswith("_")]
    values = [positive(name, as_tensor(x, dtype, device)) for name, x in known]

    def vector(name: str, value: Value) -> Tensor:
        return finite(name, axis_last(name, as_tensor(value, dtype, device), 3))

    direction, root = vector("direction", direction), vector("root", root)
    return values, axes_along(direction, None if up is None else vector("up", up)), root


def warn_of_batch(
    name: str, count: torch.Size, elements: int, order: int, section: Sections, *others: torch.Size
) -> None:
    """A warning where values have a batch axis as long as the elements, or the nodes, and nothing
    else has a batch: values along the beam were meant, most likely. elements: intervals between
    nodes.
    """
    batches = (*others, *([section.batch_shape] if isinstance(section, Section) else []))
    n = count[-1] if count else 1
    if n > 1 and n in (elements // order, elements, elements + 1) and not any(batches):
        warn(
            f"{name} with {n} values was given for {elements // order} elements: a batch of {n} "
            "beams, one value each; along one beam a function of s, or a torchbeam.Table of places "
            "and values, is wanted"
        )


def dtype_with(section: Sections, *values: Value) -> tuple[torch.dtype, torch.device]:
    """Of sections and values. Raises ValueError for no section, and where devices differ."""
    if isinstance(section, Stations):
        return common_dtype(*values, section.s, section.section.compliance)
    if callable(section):
        return common_dtype(*values)
    sections = tuple(section) if isinstance(section, Sequence) else (section,)
    for s in sections:
        instance("a section", s, Section)
    return common_dtype(*values, *(s.compliance for s in sections))
