"""Prepared steppers: a scene that nothing was written to since is not discretised, nor looked through, again."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch.autograd import forward_ad

from ..core.leaves import Placeholder, leaves, with_values
from ..engine.chain.constants import of_library
from ..engine.chain.coverage import meaning
from ..scene.scene import Scene
from .stepper import Stepper

KEPT = "prepared steppers"  # on the scene; with a space in its name, copies and pickles go without it
RECENT = 4  # of a scene


class Prepared(NamedTuple):
    """A stepper, the tensors of the scene that it was made of, and how often these had been written to."""

    stepper: Stepper
    tensors: list[Tensor]
    versions: list[int]


def prepared(scene: Scene, dt: float, method: str, **options: Any) -> Stepper:
    """Stepper(scene, dt, method, **options), whose model and native code are those of the scene's last one where it had the
    same options, and no tensor of the scene was written to since. Made anew where a derivative by the scene may be recorded,
    and where the scene holds functions, whose surroundings may have changed.
    """
    tensors = _tensors(scene)
    if tensors is None:
        return Stepper(scene, dt, method, **options)
    known = vars(scene).setdefault(KEPT, {})
    key, versions = (meaning(), method, *sorted(options.items())), [x._version for x in tensors]
    found = known.pop(key, None)
    if found is None or found.versions != versions:
        # of a twin: the scene holds the stepper, which holds no scene that holds it
        found = Prepared(Stepper(with_values(scene), dt, method, **options), tensors, versions)
        for oldest in [*known][:max(0, len(known) + 1 - RECENT)]:
            known.pop(oldest, None)
    known[key] = found
    return found.stepper.again(dt)


def _tensors(scene: Scene) -> list[Tensor] | None:
    """Those that a scene holds; None where a stepper of it is not to be kept."""
    if torch.is_inference_mode_enabled() or forward_ad._current_level >= 0 or functorch.peek_interpreter_stack() is not None:
        return None
    values, recorded = [one.value for one in leaves(scene)], torch.is_grad_enabled()
    for x in values:
        if isinstance(x, Tensor):
            if (recorded and x.requires_grad) or x.is_inference() or functorch.is_functorch_wrapped_tensor(x):
                return None
        elif not isinstance(x, Placeholder):
            return None
    return [x for x in values if isinstance(x, Tensor)] if all(map(of_library, scene.effects)) else None
