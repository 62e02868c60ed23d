"""Accuracy on request: `simulate`, `equilibrium` and `modes` choose their mesh and steps. Within
`finer` they, and others that solve for a scene, run on meshes and steps that it chooses.
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.arguments import accuracy as check_accuracy
from ...core.arguments import instance
from ...core.remembered import keep, structure_of
from ...core.warning import warn
from ...dynamics import simulate as dynamics
from ...linear import critical, state_space
from ...linear import modes as linear
from ...scene.scene import Scene
from ...state import state as states
from ...state.solution import Solution
from ...state.state import State
from ...statics import equilibrium as statics
from ...statics import path as paths
from .converge import converge
from .convergence import Convergence
from .finer import Finer
from .remesh import remesh
from .setting import Setting

P = ParamSpec("P")
T = TypeVar("T")
LOG = logging.getLogger("torchbeam")
APART = 0.5  # of the largest number of a tensor: where a scene is further off a new search is made
POSITIONAL = "initial", "method"
STRUCTURES, RECENT = 64, 8  # with choices, and choices of each; the oldest go first
SEARCHED = "initial", "inputs", "engine"  # options of `simulate` that the search runs with
# those that do not change what is computed
FREE = "throw", "checkpoint", "progress", "tolerance", "iterations", "halvings"


class Choice(NamedTuple):
    """What a search for `accuracy` found for a scene and other arguments with these numbers."""

    call: str
    accuracy: float
    values: tuple[Tensor, ...]
    setting: Setting
    error: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.call}, accuracy={self.accuracy:g}: {self.setting}, error {self.error:.1e}"

    def suits(self, values: list[Tensor]) -> bool:
        """Whether numbers of the same structure, or the first of them, are like these."""
        return all(
            bool(((new.detach() - old).abs() <= APART * old.abs().max()).all())
            for new, old in zip(values, self.values, strict=False)
            if old.numel() and old.is_floating_point()
        )


_CHOICES: dict[Hashable, tuple[Choice, ...]] = {}


def choices_of(scene: Scene) -> list[Choice]:
    """What was chosen for scenes like this one."""
    values: list[Tensor] = []
    structure = structure_of(scene, values)
    return [
        choice
        for (of, *_), recent in _CHOICES.items()
        for choice in recent
        if of == structure and choice.suits(values)
    ]


def shape(result: Any, scene: Scene) -> Tensor:
    """(..., 24) of a state or a solution: where its middle and its tip are, in lengths of the beam,
    and the axes there. Of a mesh without a node in the middle the mean of the two around it.
    """
    state, last = getattr(result, "state", result), scene.beam.node_count - 1
    places = state.position / scene.beam.length.detach().sum(-1)[..., None, None]
    x = torch.cat([places, state.axes.flatten(-2)], -1)
    middle = (x[..., last // 2, :] + x[..., last - last // 2, :]) / 2
    return torch.cat([middle, x[..., -1, :]], -1)


@wraps(dynamics.simulate)
def simulate(scene: Scene, t: Any, *given: Any, accuracy: Any = None, **options: Any) -> Solution:
    finer = Finer.now.get()
    if accuracy is None and finer is None:
        return dynamics.simulate(scene, t, *given, **options)
    options = dict(**dict(zip(POSITIONAL, given, strict=False)), **options)
    given = given[len(POSITIONAL) :]  # more than there may be, which are refused
    if accuracy is None:
        return finer.run(dynamics.simulate, scene, (t, *given), finer.options(t, options))
    inspect.signature(dynamics.simulate).bind(scene, t, *given, **options)  # or unknown keywords
    for name, value in options.items():
        if name not in (*SEARCHED, *FREE) and value is not None:
            raise ValueError(
                f"{name} was given with accuracy, which chooses how to simulate; one of them is "
                "wanted"
            )
    if isinstance(initial := options.get("initial"), State):
        raise ValueError(
            "a state of one mesh was given as initial with accuracy, which chooses the mesh; a "
            "function of the scene that gives one, as tb.equilibrium, is wanted"
        )

    def search() -> Convergence:
        searched = {name: options[name] for name in SEARCHED if name in options}
        return converge(scene, t, shape, accuracy, progress=_log, **searched)

    if isinstance(accuracy, Convergence) and accuracy.settings.method is None:
        raise ValueError(
            "what tb.converge gave without t was given as accuracy of a motion; one with t, which "
            "chooses a step too, is wanted"
        )
    instants = tuple(torch.as_tensor(t).detach().flatten().tolist())
    asked = instants, initial, options.get("inputs")
    setting = _setting("simulate", scene, accuracy, asked, search)
    scene = remesh(scene, **setting.mesh)
    if callable(initial):
        options["initial"] = initial(scene)
    return dynamics.simulate(scene, t, **setting.steps, **options)


@wraps(statics.equilibrium)
def equilibrium(scene: Scene, *, accuracy: Any = None, **options: Any) -> State:
    return _static(statics.equilibrium, "initial", shape, scene, accuracy, options)


@wraps(linear.modes)
def modes(scene: Scene, *given: Any, accuracy: Any = None, **options: Any) -> linear.Modes:
    options |= dict(zip(("state", "count"), given, strict=False))
    return _static(
        linear.modes, "state", lambda modes: modes.eigenvalue.abs(), scene, accuracy, options
    )


def _static(
    call: Callable[..., T],
    of_mesh: str,
    read: Callable[..., Tensor],
    scene: Scene,
    accuracy: Any,
    options: dict[str, Any],
) -> T:
    """A call without t; of_mesh: its option that belongs to one mesh."""
    if accuracy is None:
        return _run(call, scene, (), options)
    if options.get(of_mesh) is not None:
        raise ValueError(
            f"{of_mesh} was given with accuracy, which chooses the mesh; one of them is wanted"
        )

    def search() -> Convergence:
        return converge(
            scene,
            None,
            read,
            accuracy,
            solve=lambda remeshed: call(remeshed, **options),
            progress=_log,
        )

    setting = _setting(call.__name__, scene, accuracy, options, search)
    return call(remesh(scene, **setting.mesh), **options)


def _run(call: Callable[..., T], scene: Any, given: Sequence[Any], options: Mapping[str, Any]) -> T:
    """As it is asked for, or as `finer` has it."""
    finer = Finer.now.get()
    if finer is None:
        return call(scene, *given, **options)
    return finer.run(call, scene, given, options)


def _watched(call: Callable[P, T]) -> Callable[P, T]:
    """A call of a scene that `finer` runs on other meshes."""

    @wraps(call)
    def run(scene: Any, *given: Any, **options: Any) -> T:
        return _run(call, scene, given, options)

    return cast(Callable[P, T], run)


critical_load = _watched(critical.critical_load)
linearize = _watched(state_space.linearize)
path = _watched(paths.path)
rest = _watched(states.rest)


def _setting(
    call: str, scene: Scene, accuracy: Any, asked: Any, search: Callable[[], Convergence]
) -> Setting:
    """As was found before for what is `asked` of a scene like this one, or by a search."""
    if isinstance(accuracy, Convergence):
        return accuracy.settings
    check_accuracy("accuracy", accuracy)
    instance("a scene", scene, Scene)
    values: list[Tensor] = []
    key = structure_of(scene, values), call, float(accuracy), structure_of(asked, values)
    if any(functorch.is_functorch_wrapped_tensor(x) for x in values):
        raise ValueError(
            "accuracy = a number was given within torch.func, where nothing can be tried; what "
            "tb.converge gives is wanted"
        )
    try:
        recent = _CHOICES.get(key, ())
    except TypeError:  # a part has no hash
        key, recent = None, ()
    choice = next((choice for choice in recent if choice.suits(values)), None)
    if choice is None:
        best = search()
        known = tuple(x.detach().clone() for x in values)
        choice = Choice(call, float(accuracy), known, best.settings, best.error, best.notes)
        if key is not None:
            keep(_CHOICES, key, (choice, *recent[: RECENT - 1]), STRUCTURES)
    if choice.error > accuracy:
        warn(f"accuracy = {accuracy:g} was not reached. {' '.join(choice.notes)}")
    return choice.setting


def _log(done: int, setting: Setting) -> None:
    LOG.info("accuracy: run %d, %s", done + 1, setting)
