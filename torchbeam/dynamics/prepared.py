"""Prepared steppers: a scene whose numbers are what they were is not discretised again, nor looked
through.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import untracked
from ..core.remembered import keep
from ..engine.chain.coverage import meaning
from ..scene.scene import Scene
from .stepper import Stepper

KEPT = " prepared steppers"  # of a scene, which its copies and pickles go without
RECENT = 4  # of a scene


class Prepared(NamedTuple):
    """A stepper, and copies of the scene's tensors as they were when it was made."""

    stepper: Stepper
    numbers: list[Tensor]


def prepared(scene: Scene, dt: float, method: str, **options: Any) -> Stepper:
    """Stepper(scene, dt, method, **options), whose model and native code are those of the scene's
    last one where it had the same options, and the scene has the same numbers, by whatever way it
    was written to. Made anew where a derivative by the scene may be recorded, and where the scene
    holds functions, whose dependencies may have changed.
    """
    tensors, steppers = scene.numbers, vars(scene).setdefault(KEPT, {})
    key = meaning(), method, *sorted(options.items())
    if (
        tensors is None
        or not untracked(tensors)
        or torch.is_inference_mode_enabled()
        or any([x.is_inference() for x in tensors])
    ):
        return Stepper(scene, dt, method, **options)
    if not all(isinstance(x, Hashable) for x in options.values()):  # for `Stepper` to refuse
        return Stepper(scene, dt, method, **options)
    entry = steppers.pop(key, None)
    if entry is None or not all(map(torch.equal, entry.numbers, tensors)):
        # of a twin: the scene holds the stepper, which holds no scene that holds it
        entry = Prepared(Stepper(_twin(scene), dt, method, **options), _copied(tensors))
    return keep(steppers, key, entry, RECENT).stepper.again(dt)


@torch.no_grad()
def _copied(tensors: Iterable[Tensor]) -> list[Tensor]:
    return [x.clone() for x in tensors]


def _twin(scene: Scene) -> Scene:
    """The same scene, that holds no steppers."""
    twin = object.__new__(Scene)
    vars(twin).update(vars(scene))
    vars(twin).pop(KEPT, None)
    return twin
