"""Base of sensors that ask what a scene's effects do at the instant of a state."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ..core.arguments import instance
from ..core.leaves import option
from ..nodal.coordinates.spatial import Spatial
from ..nodal.discretise import discretise
from ..nodal.loads import Nodes
from ..nodal.model import Model
from ..scene.scene import Scene
from ..state.state_check import of_mesh
from .sensor import Sensor

check_scene = partial(instance, wanted=Scene)


@dataclass(frozen=True, eq=False, repr=False)
class OfScene(Sensor):
    """scene  whose effects they are; `nodes` raises ValueError for a state of another form."""

    scene: Scene = option(check_scene, name="a scene")
    model: Model = field(init=False, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "model", discretise(self.scene))

    def nodes(self, state: Any) -> Nodes:
        """How its nodes move, as loads see them."""
        state = of_mesh(state, self.scene, f"{type(self).__name__}: a state")
        return nodes_of(self.model.space, self.model.space.to_reduced(state))


def nodes_of(space: Spatial, state: Any) -> Nodes:
    """The same of a state in the coordinates of a space."""
    spin = space.to_frame(state.rotation, state.spin)
    motion = state.position, state.rotation, state.velocity, spin
    return Nodes(*motion, state.frame, state.internal)
