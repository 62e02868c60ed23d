"""What of scenes and steps native code does not take yet, by name."""

from __future__ import annotations

from importlib.util import find_spec

from ...nodal.model import Model
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
    }
    return next((reason for reason, given in reasons.items() if given), None)


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
