"""Functions of the motion that users wrote: the loads that have some, and what these read."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from ...core.leaves import AXES, own_leaves
from ...core.surroundings import Read, Surroundings, Unsteady, of_class
from ...nodal.model import Model
from .constants import of_library


def by_function(model: Model) -> list[Any]:
    """Loads that depend on the motion and are functions that a user wrote, or hold such."""
    loads = (*model.loads[0], *(load for load in model.loads[1] if load.internal))
    return [load for load in loads if not of_library(load) or any(one.axes is None for one in own_leaves(load))]


def surroundings(loads: list[Any]) -> Surroundings:
    """What functions of the motion that a user wrote read beside the motion. Raises Unsteady for what may change unnoticed."""
    reads: list[Read] = []
    for load in loads:
        own, functions = not of_library(load), {one.name for one in own_leaves(load) if one.axes is None}
        for one in fields(load):
            if one.name in functions or (own and AXES not in one.metadata):
                reads.append((one.name, lambda load=load, name=one.name: getattr(load, name)))
        reads += of_class(type(load))
    return Surroundings(reads)


def known(loads: list[Any]) -> Surroundings | None:
    """The same; None where that is not known."""
    try:
        return surroundings(loads)
    except Unsteady:
        return None
