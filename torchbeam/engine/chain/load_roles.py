"""Roles of a model's loads in native steps: which are evaluated there, and which values are taken
from them beforehand.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from torch import Tensor

from ...core.leaves import FunctionOfTime, Tree, constant, own_leaves
from ...nodal.acting import ActingLoad
from ...nodal.line_loads import places, valued
from ...nodal.model import Model
from ...scene.effects import Input
from ...scene.effects.effect import of_library


class LoadRoles(NamedTuple):
    """What native steps make of a model's loads, by their numbers in it; the same in all models of
    one structure.

    acts   of `Model.acts`, those that are evaluated natively: by_place, whether each has values by
           place; plain: whether they are those of the load itself
    given  of the dead ones (`Model.loads`), those whose values nothing changes; asked: the others
    wants_support  whether a native one asks where the root's support stands; rests: whether that
           stands still
    given_eigenstrain  whether the beam's eigenstrain is the same at all times
    by_time  whether loads are evaluated at t in torch; asks: whether anything is
    """

    acts: tuple[int, ...]
    by_place: tuple[bool, ...]
    plain: tuple[bool, ...]
    given: tuple[int, ...]
    asked: tuple[int, ...]
    wants_support: bool
    rests: bool
    given_eigenstrain: bool
    by_time: bool
    asks: bool

    @classmethod
    def of(cls, model: Model) -> LoadRoles:
        scene, acts = model.scene, model.acts
        natively = [k for k, act in enumerate(acts) if act.reads or isinstance(act.node, tuple)]
        natively += [
            k
            for k, act in enumerate(acts)
            if k not in natively and (act.load.internal or _by_inputs(act.load))
        ]
        some = [acts[k] for k in natively]
        loads = [act.load for act in some]
        dead, asked = [], []
        for k, load in enumerate(model.loads[1]):
            if load not in loads:
                is_given = _given(load) and not (model.turning and load.wants_axes)
                (dead if is_given else asked).append(k)
        none = {name: model.length.new_zeros(size) for name, size in scene.inputs.items()}
        zero = model.length.new_zeros(())
        by_place = [act.load.at_sites(*places(model, act, zero, none)) is not None for act in some]
        valued = valued_at_rest(model, some)
        wants_support = any(load.wants_support for load in loads)
        rests = not scene.has_prescribed_motion and scene.root is None
        given_eigenstrain = all(_given(effect) for effect in scene.eigenstrains)
        by_time = bool(
            asked or any(map(_by_time, loads, by_place)) or (wants_support and not rests)
        )
        driven = any(map(_of_time, (*scene.joints, *scene.tendons)))
        asks = by_time or not given_eigenstrain or not rests or driven
        return cls(
            tuple(natively),
            tuple(by_place),
            tuple(load is known for load, known in zip(loads, valued, strict=True)),
            tuple(dead),
            tuple(asked),
            wants_support,
            rests,
            given_eigenstrain,
            by_time,
            asks,
        )


def valued_at_rest(model: Model, acts: Iterable[ActingLoad]) -> tuple[Any, ...]:
    """Loads with numbers in the place of functions of t and of inputs, none of which is other than
    0; themselves where they hold numbers alone.
    """
    none = {name: model.length.new_zeros(size) for name, size in model.scene.inputs.items()}
    return tuple(valued(model, act, model.length.new_zeros(()), none) for act in acts)


def _by_time(load: Any, by_place: bool) -> bool:
    """Whether what a load holds is asked at t."""
    return not unchanging(load) if by_place else _of_time(load)


def _of_time(tree: Any) -> bool:
    """Whether a function of t is among a tree's leaves, be it a tree itself (`tb.History`)."""
    return any(
        isinstance(leaf.value, FunctionOfTime) or _of_time(leaf.value)
        if isinstance(leaf.value, Tree)
        else leaf.axes is not None and callable(leaf.value)
        for leaf in own_leaves(tree)
    )


def unchanging(load: Any) -> bool:
    """Whether the values of a load by place are the same at all times and for all inputs."""
    return all(constant(leaf.value) for leaf in own_leaves(load) if leaf.axes is not None)


def _given(effect: Any) -> bool:
    """Whether an effect is one of the library's with numbers alone."""
    return of_library(effect) and constant(effect)


def _by_inputs(load: Any) -> bool:
    """Whether a load is one of the library's, and holds inputs beside plain numbers."""
    values = [leaf.value for leaf in own_leaves(load) if leaf.value is not None]
    return (
        of_library(load)
        and any(isinstance(x, Input) for x in values)
        and all(isinstance(x, (Tensor, Input)) for x in values)
        and not load.inputs
    )
