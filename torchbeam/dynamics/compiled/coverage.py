"""What of scenes and steps native code does not take yet, by name."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from ...nodal.model import Model
from ...scene.effects import CustomLoad, LineLoad, PerElement
from ...solvers.compiled.trace import NotTraceable
from .step import CompiledStep

MISSING = "llvmlite is not installed: `pip install torchbeam[fast]`"


def refusal(model: Model, method: str, conserve: bool = False) -> str | None:
    """Why steps of a model are not compiled; None where they are. Functions that a user wrote are tried by `compiled_step`."""
    scene = model.scene
    reasons = {
        f"method {method!r}": method != "midpoint",
        "conserve": conserve,
        f"the device {scene.device}": scene.device.type != "cpu",
        "a frame that moves": scene.frame is not None,
        "a support or root that moves": scene.has_prescribed_motion or scene.root is not None,
        "a load with internal states": bool(model.internal_states),
        **{f"{type(load).__name__} along the beam with values of each element or node": True
           for load in model.loads[0] if by_place(load)},
    }
    return next((reason for reason, given in reasons.items() if given), None)


def by_place(load: Any) -> bool:
    """Whether a load that depends on the motion has values of its own in each element or node."""
    if isinstance(load, LineLoad):
        return any(isinstance(value, PerElement) for value in (load.force, load.moment))
    return isinstance(load, CustomLoad) and load.node is None and bool(load.values)


def compiled_step(model: Model, method: str, conserve: bool = False) -> CompiledStep:
    """Steps of a model by native code. Raises ValueError with the reason where there are none."""
    reason = refusal(model, method, conserve)
    if reason is None and find_spec("llvmlite") is None:
        reason = MISSING
    try:
        if reason is None:
            return CompiledStep(model)
    except NotTraceable as error:
        reason = str(error)
    raise ValueError(f"engine = 'compiled' was given, which does not take this scene ({reason}); 'eager' does")
