"""Sensors of the supports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.functions_of_time import shared
from ..core.leaves import option
from ..nodal.conditions import conditions
from ..nodal.loads import external
from ..scene.effects import RootSpring
from ..scene.parts import Place, check_node
from ..state.state import State
from .sensor import XYZ, OfScene, Sensor


@dataclass(frozen=True, eq=False, repr=False)
class _OfRoot(Sensor):
    """what: of the root's load is read."""

    on: str | None = field(default=None, kw_only=True)
    of_part = True
    what: ClassVar[str]

    name = property(lambda self: f"{self._prefix}root {self.what}")
    labels = XYZ


@dataclass(frozen=True, eq=False, repr=False)
class RootForce(_OfRoot):
    """Force (..., 3) N of the support at node 0 on the beam, frame a, as the state has it (see
    `State`). A `RootSpring` beside it has its own, which `RootSpringLoad` reads.

    on: name of the beam, in a structure. ValueError without such a support.

    Examples:
        >>> tb.sensors.RootForce()(tb.equilibrium(scene))[2]  # N
        tensor(-2.)
    """

    what, unit = "force", "N"

    def read(self, state: Any) -> Tensor:
        return state.root.force


@dataclass(frozen=True, eq=False, repr=False)
class RootMoment(_OfRoot):
    """Moment (..., 3) N m of the support at node 0 on the beam, frame a, as the state has it (see
    `State`). A `RootSpring` beside it has its own, which `RootSpringLoad` reads.

    on: name of the beam, in a structure. ValueError without such a support.

    Examples:
        >>> tb.sensors.RootMoment()(tb.equilibrium(scene))  # N m
        tensor([0.0000, 1.8008, 0.0000])
    """

    what, unit = "moment", "N m"

    def read(self, state: Any) -> Tensor:
        return state.root.moment


@dataclass(frozen=True, eq=False, repr=False)
class RootReaction(_OfRoot):
    """Force and moment (..., 6) N and N m of the support at node 0 on the beam, frame a.

    They are the state's own (see `State`). A `RootSpring` beside it has its own, which
    `RootSpringLoad` reads. on: name of the beam, in a structure. ValueError without such a support.

    Examples:
        >>> tb.sensors.RootReaction()(tb.equilibrium(scene)).shape  # force N, moment N m
        torch.Size([6])
    """

    what, unit = "reaction", "N, N m"
    labels = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

    def read(self, state: Any) -> Tensor:
        return torch.cat(tuple(state.root), -1)


@dataclass(frozen=True, eq=False, repr=False)
class Reaction(Sensor):
    """Force and moment (..., 6) N and N m of one of the scene's supports on the beam, frame a.

    They are the state's own (see `State`).

    Args:
        support: its place in `scene.supports`, which are in the order given; in a structure also
            the node that it holds, (name, node) or a body's name

    Examples:
        >>> tb.sensors.Reaction(0)(tb.equilibrium(scene))[2]  # N of the clamp, then N m
        tensor(-2.)
    """

    support: Place = option(check_node)
    unit = "N, N m"
    labels = RootReaction.labels

    @property
    def name(self) -> str:
        at = self.support
        if isinstance(at, tuple):
            at = f"{at[0]} node {at[1]}"
        return f"reaction of {at if isinstance(at, str) else f'support {at}'}"

    def read(self, state: Any) -> Tensor:
        if not isinstance(state, State):
            raise ValueError(
                f"a state of type {type(state).__name__}, which has the load of the root alone, "
                "was given to Reaction; RootReaction reads it"
            )
        return torch.cat(tuple(state.reaction_of(self.support)), -1)


@dataclass(frozen=True, eq=False, repr=False)
class RootSpringLoad(OfScene):
    """Force and moment (..., 6) N and N m of an elastic clamp (`RootSpring`) on the beam, frame a.

    It is at the instant of the state. `RootReaction` has the components that a `Support` of node 0
    holds beside it.

    Raises:
        ValueError: for a scene without a RootSpring, or a state of another form.

    Examples:
        >>> sprung = tb.Scene(
        ...     beam,
        ...     [
        ...         tb.RootSpring(stiffness=(1e4, 1e4, 1e4, 5.0, 5.0, 5.0)),
        ...         tb.TipLoad(force=(0, 0, 1.0)),
        ...     ],
        ... )
        >>> tb.sensors.RootSpringLoad(sprung)(tb.equilibrium(sprung))[2]  # N
        tensor(-1.)
    """

    name = "load of the root spring"
    unit = "N, N m"
    labels = RootReaction.labels

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self._springs:
            raise ValueError(
                "a scene without a RootSpring was given to RootSpringLoad; one with it is wanted"
            )

    @property
    def _springs(self) -> tuple[RootSpring, ...]:
        return tuple(load for load in self.scene.loads if isinstance(load, RootSpring))

    def read(self, state: Any) -> Tensor:
        nodes = self.nodes(state)
        now = conditions(self.model, shared(state.t), {}, loads=self._springs)
        return self.model.space.embed(external(self.model, nodes, now)[..., 0, :])
