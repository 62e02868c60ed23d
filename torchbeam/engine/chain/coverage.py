"""Which engine makes a scene's steps, and why: what native code does not take yet, by name."""

from __future__ import annotations

import os
import types
from collections.abc import Callable
from functools import cache, partial
from importlib.util import find_spec
from typing import Any, TypeVar

from ...core.arguments import choice
from ...core.function_dependencies import Dependencies, Unsteady
from ...core.leaves import own_leaves
from ...nodal.model import Model
from ...scene.effects.effect import is_own, parts_of
from ..compiler.trace import NotTraceable
from ..engine_use import slow_path
from .compiled_step import FUNCTIONS, CompiledStep
from .kept_programs import NOTHING
from .native import NotCompiled
from .touching_step import TouchingStep
from .user_functions import by_function, by_sample, dependencies_of, known

T = TypeVar("T")
ENGINES = ("auto", "eager", "compiled")
VARIABLE = "TORCHBEAM_ENGINE"  # of the environment: what "auto" means
MISSING = "llvmlite is not installed: `pip install llvmlite`"
VALUES = (
    "; numbers that change are wanted by tb.Load(values=), others in numbers, tensors, lists, "
    "dictionaries, modules of torch.nn or attributes of objects, which the function reads and "
    "does not write"
)


@cache
def installed() -> bool:
    """Whether the compiler's package is there."""
    return find_spec("llvmlite") is not None


def refusal(model: Model, method: str, conserve: bool = False, **options: Any) -> str | None:
    """Why steps of a model are not compiled; None where they are. Functions that a user wrote are
    tried by `compiled_step`.
    """
    scene = model.scene
    reasons = {
        f"method {method!r}": (method, conserve) not in FUNCTIONS,
        "conserve of what floats free": conserve and bool(model.free_pieces),
        f"the device {scene.device}": scene.device.type != "cpu",
    }
    return next((reason for reason, applies in reasons.items() if applies), None)


def why_eager(model: Model, method: str, **options: Any) -> str | None:
    """Why "auto" steps a model eagerly, in words that `describe` shows, and whether "compiled"
    takes it, which is tried; None where "auto" takes native code.
    """
    reason = refusal(model, method, **options) or (MISSING if not installed() else None)
    if reason is not None:
        return reason
    untraced = why_not_traced(model, method, **options)
    reason = (
        f"{VARIABLE} is 'eager'"
        if meaning() == "eager"
        else unsteady(model)
        if meaning() == "auto"
        else None
    )
    if reason is None or untraced is not None:
        return untraced
    return f"{reason}; 'compiled' takes it, as it is"


def unsteady(model: Model) -> str | None:
    """What a user's function of the motion reads that may change unnoticed, in words; None where
    there is none.
    """
    effects = by_function(model)
    if not effects:
        return None
    try:
        dependencies_of(effects)
    except Unsteady as reason:
        return (
            f"{effects[0].called} by a function of the motion that reads {reason}, which may "
            f"change{place(effects[0])}"
        )
    return None


def why_not_traced(model: Model, method: str, **options: Any) -> str | None:
    """Why what users wrote is not traced, by name and line, or what it raises; None where it is
    traced.
    """
    effects = by_function(model)
    try:
        if effects:
            _made(model, method, effects, **options)
    except Exception as error:
        return untraceable(effects[0], error)
    return None


def untraceable(load: Any, error: Exception) -> str:
    return f"{load.called} by a function of the motion: {error}{place(load)}"


def place(load: Any) -> str:
    """File and line of the first function that a load is made of, in brackets; of a class of the
    user's own its name.
    """
    functions = [
        leaf.value for leaf in own_leaves(load) if isinstance(leaf.value, types.FunctionType)
    ]
    if not functions:
        kinds = [type(part) for part in parts_of(load) if not is_own(part)]
        return f" (class {kinds[0].__qualname__} of {kinds[0].__module__})" if kinds else ""
    code = functions[0].__code__
    return f" ({code.co_filename}:{code.co_firstlineno})"


def meaning() -> str:
    """What "auto" means. Raises ValueError for another word than an engine in the environment."""
    return choice(VARIABLE, os.environ.get(VARIABLE) or "auto", ENGINES)


def compiled_step(model: Model, method: str, **options: Any) -> CompiledStep:
    """Steps of a model by native code. Raises ValueError with the reason where there are none."""
    reason = refusal(model, method, **options)
    if reason is None and not installed():
        reason = MISSING
    try:
        if reason is None:
            return _made(model, method, by_function(model), **options)
    except NotTraceable as error:
        reason = str(error)
    raise ValueError(refused(reason))


def automatic_step(
    model: Model, method: str, **options: Any
) -> tuple[CompiledStep | None, str | None]:
    """Steps of a model by native code where "auto" takes it; else None, and why it is to be said
    that steps are eager, None = that is meant: by the environment, or by the device. What a user's
    function raises, of the motion or of time, is raised by the eager step, before a word is said.
    """
    if model.scene.device.type != "cpu" or meaning() == "eager":
        return None, None
    reason = refusal(model, method, **options) or (MISSING if not installed() else None)
    if reason is not None:
        return None, reason
    effects, reason = by_function(model), unsteady(model) if meaning() == "auto" else None
    if reason is not None:
        return None, reason + VALUES
    try:
        return _made(model, method, effects, **options), None
    except Exception as error:
        return None, untraceable(effects[0], error) if effects else impossible(error)


def _made(model: Model, method: str, effects: list[Any], **options: Any) -> CompiledStep:
    step = partial(_of_known_pairs, method, effects, options)
    return TouchingStep(model, step) if model.touching.present else step(model)


def _of_known_pairs(
    method: str,
    effects: list[Any],
    options: dict[str, Any],
    model: Model,
    like: CompiledStep | None = None,
) -> CompiledStep:
    return by_sample(
        lambda around: CompiledStep(model, method, around=around, like=like, **options),
        model,
        known(effects),
    )


def natively(
    what: str,
    model: Model,
    reason: str | None,
    make: Callable[[Dependencies | None], T],
    required: bool,
) -> T | None:
    """What native code makes of a model, with what its functions read, unless there is a reason
    against it; else None, with a warning that `what` is slow where that is not meant. required:
    raises ValueError in its place.
    """
    effects = by_function(model)
    try:
        if reason is None and not required:
            reason = unsteady(model)
        if reason is None:
            around = (known if required else dependencies_of)(effects) if effects else NOTHING
            return by_sample(make, model, around)
    except NotTraceable as error:
        reason = untraceable(effects[0], error) if effects and not required else str(error)
    except NotCompiled as error:
        if required:
            raise
        given_up(error, what)
        return None
    except Exception:
        if required or not effects:
            raise
        return None  # of the user's function: raised eagerly, too
    if required:
        raise ValueError(refused(reason))
    slow_path(what, reason)
    return None


def refused(reason: str | None) -> str:
    """What is said where native code alone is wanted."""
    return f"engine = 'compiled' was given, which does not take this scene ({reason}); 'eager' does"


def given_up(error: Exception, what: str = "steps are made") -> None:
    """The warning about a compiler that failed."""
    slow_path(what, impossible(error))


def impossible(error: Exception) -> str:
    first = next(iter(str(error).splitlines()), "")
    return f"no native code could be made: {type(error).__name__}: {first}"
