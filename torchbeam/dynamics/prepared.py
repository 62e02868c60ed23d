"""Prepared steppers: a scene whose numbers are what they were is not discretised again, nor looked
through.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import untracked
from ..core.remembered import LARGE, structure_of
from ..engine.chain.coverage import meaning
from ..engine.chain.replayed_step import ReplayedStep, Tapes, keeps_structure
from ..nodal.coordinates.planar import Planar
from ..nodal.coordinates.selection import coordinates
from ..nodal.later_model import LaterModel
from ..scene.scene import Scene
from .method import Midpoint
from .stepper import Stepper

KEPT = " prepared steppers"  # of a scene, which its copies and pickles go without
RECENT = 4  # of a scene
STRUCTURES = 64  # that are known; the one that was not asked for for longest goes first


class Prepared(NamedTuple):
    """A stepper, and copies of the scene's tensors as they were when it was made."""

    stepper: Stepper
    numbers: list[Tensor]


def prepared(scene: Scene, dt: float, method: str, **options: Any) -> Stepper:
    """Stepper(scene, dt, method, **options), whose model and native code are those of the scene's
    last one where it had the same options, and the scene has the same numbers, by whatever way it
    was written to. Made anew where a derivative by the scene may be recorded, and where the scene
    holds functions, whose surroundings may have changed.
    """
    tensors, steppers = scene.numbers, vars(scene).setdefault(KEPT, {})
    key = meaning(), method, *sorted(options.items())
    if (
        tensors is None
        or not untracked(tensors)
        or torch.is_inference_mode_enabled()
        or any(x.is_inference() for x in tensors)
    ):
        return Stepper(scene, dt, method, **options)
    if not all(isinstance(x, Hashable) for x in options.values()):  # for `Stepper` to refuse
        return Stepper(scene, dt, method, **options)
    found = steppers.pop(key, None)
    if found is None or not all(map(torch.equal, found.numbers, tensors)):
        # of a twin: the scene holds the stepper, which holds no scene that holds it
        numbers = _copied(tensors)
        found = Prepared(_of_structure(_twin(scene), numbers, dt, method, options), numbers)
        for oldest in [*steppers][: max(0, len(steppers) + 1 - RECENT)]:
            steppers.pop(oldest, None)
    steppers[key] = found
    return found.stepper.again(dt)


def _of_structure(
    scene: Scene, numbers: list[Tensor], dt: float, method: str, options: dict[str, Any]
) -> Stepper:
    """As Stepper(scene, dt, method, **options); where another scene of the same structure had one,
    natively, what numbers do not change is taken of that. numbers: copies of the scene's.
    """
    many = sum(x.numel() for x in numbers) > LARGE
    if many or scene.plane == "auto" or any(x.requires_grad for x in scene.numbers):
        return Stepper(scene, dt, method, **options)
    key = meaning(), torch.get_default_dtype(), method, *sorted(options.items())
    key = key, structure_of(scene, []), *[(x.stride(), x.device) for x in scene.numbers]
    try:
        known = _KNOWN.pop(key, None)
    except TypeError:  # a part has no hash
        return Stepper(scene, dt, method, **options)
    if known is not None:
        stepper = known.stepper_of(scene, numbers)
    else:
        stepper = Stepper(scene, dt, method, **options)
        if type(stepper.method) is not Midpoint or not keeps_structure(stepper.compiled):
            return stepper
        known = KnownStructure(stepper, Tapes(stepper.compiled, bool(options.get("lumped"))))
        for oldest in [*_KNOWN][: max(0, len(_KNOWN) + 1 - STRUCTURES)]:
            _KNOWN.pop(oldest, None)
    _KNOWN[key] = known
    return stepper


class KnownStructure(NamedTuple):
    """A stepper of one of the scenes of a structure, and tapes of how its constants are made."""

    known: Stepper
    tapes: Tapes

    def stepper_of(self, scene: Scene, numbers: list[Tensor]) -> Stepper:
        """Of another one."""
        known, plane = self.known, self.known.model.space.plane
        space = (
            coordinates(scene.beam, scene.topology, plane, scene.small)
            if plane is None
            else Planar.through(scene.beam, plane)  # its mass is looked at by the tape
        )
        model = LaterModel(scene, numbers, self.tapes.lumped, space)
        return known.of(model, ReplayedStep(model, self.tapes))


_KNOWN: dict[Hashable, KnownStructure] = {}  # no result depends on it


@torch.no_grad()
def _copied(tensors: Iterable[Tensor]) -> list[Tensor]:
    return [x.clone() for x in tensors]


def _twin(scene: Scene) -> Scene:
    """The same scene, that holds no steppers."""
    twin = object.__new__(Scene)
    vars(twin).update((name, value) for name, value in vars(scene).items() if name != KEPT)
    return twin
