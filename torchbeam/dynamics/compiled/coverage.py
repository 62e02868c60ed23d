"""Which engine makes a scene's steps, and why: what native code does not take yet, by name."""

from __future__ import annotations

import os
import warnings
from dataclasses import fields
from importlib.util import find_spec
from typing import Any

from ...core.arguments import choice
from ...core.leaves import AXES, own_leaves
from ...core.surroundings import Read, Surroundings, Unsteady, of_class
from ...nodal.model import Model
from ...solvers.compiled.trace import NotTraceable
from .constants import of_library
from .step import FUNCTIONS, CompiledStep

ENGINES = ("auto", "eager", "compiled")
VARIABLE = "TORCHBEAM_ENGINE"  # of the environment: what "auto" means
MISSING = "llvmlite is not installed: `pip install torchbeam[fast]`"
TAKES = "; 'compiled' takes it"


def refusal(model: Model, method: str, conserve: bool = False, **options: Any) -> str | None:
    """Why steps of a model are not compiled; None where they are. Functions that a user wrote are tried by `compiled_step`."""
    scene = model.scene
    reasons = {
        f"method {method!r}": (method, conserve) not in FUNCTIONS,
        f"the device {scene.device}": scene.device.type != "cpu",
    }
    return next((reason for reason, given in reasons.items() if given), None)


def why_eager(model: Model, method: str, **options: Any) -> str | None:
    """Why "auto" steps a model eagerly, in words that `describe` shows; None where it takes native code."""
    return _decision(model, method, **options)[0]


def _decision(model: Model, method: str, **options: Any) -> tuple[str | None, Surroundings | None]:
    """See `why_eager`; where it is None, what users' functions read (None = that is not known)."""
    reason = refusal(model, method, **options)
    if reason is None and find_spec("llvmlite") is None:
        reason = MISSING
    if reason is not None:
        return reason, None
    if meaning() == "eager":
        return f"{VARIABLE} is 'eager'{TAKES}", None
    own = by_function(model)
    try:
        return None, surroundings(own)
    except Unsteady as reason:
        if meaning() == "compiled":
            return None, None
        return f"{own[0].called} by a function of the motion that reads {reason}, which may change{TAKES}, as it is", None


def why_not_traced(model: Model, method: str, **options: Any) -> str | None:
    """Why what users wrote is not traced, by name and line, or what it raises; None where it is traced. To be asked where
    `why_eager` is None.
    """
    own = by_function(model)
    try:
        if own:
            CompiledStep(model, method, around=known(own), **options)
    except Exception as reason:
        return f"{own[0].called} by a function of the motion: {reason}"
    return None


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


def meaning() -> str:
    """What "auto" means. Raises ValueError for another word than an engine in the environment."""
    return choice(VARIABLE, os.environ.get(VARIABLE) or "auto", ENGINES)


def compiled_step(model: Model, method: str, **options: Any) -> CompiledStep:
    """Steps of a model by native code. Raises ValueError with the reason where there are none."""
    reason = refusal(model, method, **options)
    if reason is None and find_spec("llvmlite") is None:
        reason = MISSING
    try:
        if reason is None:
            return CompiledStep(model, method, around=known(by_function(model)), **options)
    except NotTraceable as error:
        reason = str(error)
    raise ValueError(f"engine = 'compiled' was given, which does not take this scene ({reason}); 'eager' does")


def automatic_step(model: Model, method: str, **options: Any) -> CompiledStep | None:
    """Steps of a model by native code where "auto" takes it. What fails in the compiler is warned of, and made eagerly."""
    reason, around = _decision(model, method, **options)
    if reason is not None:
        return None
    try:
        return CompiledStep(model, method, around=around, **options)
    except NotTraceable:
        return None
    except Exception as error:
        given_up(error)
        return None


def given_up(error: Exception, what: str = "steps are made") -> None:
    """The warning about a compiler that failed."""
    first = next(iter(str(error).splitlines()), "")
    warnings.warn(f"{what} eagerly, as no native code could be made: {type(error).__name__}: {first}", RuntimeWarning,
                  stacklevel=2)
