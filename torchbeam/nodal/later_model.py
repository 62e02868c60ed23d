"""Later model: one that is made where it is asked for; native steps of a known structure ask for
none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from torch import Tensor

from ..core.leaves import map_leaves
from ..scene.scene import Scene
from .coordinates.spatial import Spatial
from .discretise import discretise
from .model import Model


@dataclass(frozen=True, init=False)
class LaterModel(Model):
    """The model of a scene, of which the coordinates and the topology are known. It becomes a plain
    `Model` when anything else of it is asked for, by `numbers`, copies of the scene's as they were.
    """

    def __init__(
        self, scene: Scene, numbers: Sequence[Tensor], lumped: bool, space: Spatial
    ) -> None:
        later = dict(_numbers=numbers, _lumped=lumped)
        vars(self).update(scene=scene, space=space, topology=scene.topology, **later)

    def __getattr__(self, name: str) -> Any:
        if name not in FIELDS or "_lumped" not in vars(self):
            raise AttributeError(name)
        copies = dict(zip(map(id, self.scene.numbers), self._numbers, strict=True))
        scene = map_leaves(lambda value, axes: copies.get(id(value), value), self.scene)
        model = discretise(scene, self._lumped)
        vars(self).update((field, vars(model)[field]) for field in FIELDS - {"scene"})
        object.__setattr__(self, "__class__", Model)
        return vars(self)[name]


FIELDS = {field.name for field in fields(Model)}
