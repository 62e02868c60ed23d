"""Finer runs of a user's function: shorter steps, or more elements, wherever it asks for a run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import torch

from ...dynamics.methods import METHODS
from ...dynamics.runs import default_step
from ...linear.critical import Critical
from ...linear.modes import Modes
from ...scene.beam import Beam
from ...scene.effects import RootSpring, Tendon
from ...scene.scene import Scene
from ...sensors.sensor import Sensor
from ...state.reduced import AT_NODES
from ...state.rest_shape import RestShape
from ...state.solution import Solution
from ...state.state import State
from ...statics.path import Path
from .reading import on_mesh
from .remesh import remesh

T = TypeVar("T")
BY_ELEMENT = "stress", "inelastic"  # fields of a state
READS = "outputs", "control"  # arguments that are functions of states
OWN = "rtol", "atol"  # of steps that control their own error


class NotRefined(ValueError):
    """A finer mesh would be another structure."""


@dataclass
class Finer:
    """How the calls of `on_request` run within `finer`: with steps shorter by `steps`, and with
    `elements` times the elements.

    as_drawn  results have the nodes of the user's mesh alone, for a model that reads them by their
              numbers; stress, which is of elements, is not a number
    scenes  of each run with more elements: as the user has it, as it is run
    states  as drawn, each with that of the finer mesh
    used  whether any run was asked for;  stepped, sprung  whether one had steps of a given length,
          a `RootSpring`, whose placeholders of rigid components `springs` multiplies
    """

    steps: int = 1
    elements: int = 1
    springs: float = 1
    as_drawn: bool = False
    scenes: list[tuple[Scene, Scene]] = field(default_factory=list)
    states: list[tuple[State, State]] = field(default_factory=list)
    used: bool = False
    stepped: bool = False
    sprung: bool = False

    now: ClassVar[ContextVar[Finer | None]] = ContextVar("now", default=None)

    def scene(self, scene: Scene) -> Scene:
        self.used = True
        if any(isinstance(effect, RootSpring) for effect in scene.effects):
            self.sprung = True
            if self.springs != 1:
                effects = [_firmer(effect, self.springs) for effect in scene.effects]
                scene = replace(scene, effects=effects)
        if self.elements == 1:
            return scene
        if any(_many_eyelets(effect, scene.beam) for effect in scene.effects):
            raise NotRefined(
                "the mesh was not refined: a Tendon goes through neighbouring nodes by their "
                "numbers, and a finer mesh without more eyelets is another structure; "
                "Tendon.along has an eyelet at each end of an element, of any mesh"
            )
        fine = remesh(scene, self.elements * scene.beam.element_count)
        self.scenes.append((scene, fine))
        return fine

    def run(
        self, call: Callable[..., T], scene: Any, given: Sequence[Any], options: Mapping[str, Any]
    ) -> T:
        """A call of a scene, or of a function that returns scenes. Its states, sensors and what it
        answers are those of the user's mesh.
        """
        if not isinstance(scene, Scene) and callable(scene):
            result = call(lambda *x: self.scene(scene(*x)), *given, **options)
            drawn = self.as_drawn and self.scenes
            return self._drawn(result, self.scenes[-1][0].beam) if drawn else result
        fine = self.scene(scene)
        if self.elements == 1:
            return call(fine, *given, **options)

        def moved(value: Any, reads: bool) -> Any:
            if isinstance(value, State):
                return next((other for drawn, other in self.states if drawn is value), value)
            if isinstance(value, Sensor):
                return on_mesh(value, scene, fine)
            if isinstance(value, (tuple, list)):
                return [moved(x, reads) for x in value]
            if reads and callable(value):
                return lambda x: value(self._drawn(x, scene.beam))
            return value

        given = [moved(x, True) for x in given]
        options = {n: moved(x, n in READS) for n, x in options.items()}
        result = call(fine, *given, **options)
        return self._drawn(result, scene.beam) if self.as_drawn else result

    def _drawn(self, result: Any, beam: Beam) -> Any:
        """What belongs to the user's nodes."""
        rows = slice(None, None, self.elements)
        if isinstance(result, State):
            changed = {name: getattr(result, name)[..., rows, :] for name in AT_NODES}
            for name in BY_ELEMENT:
                if (value := getattr(result, name)) is not None:
                    changed[name] = torch.full_like(value[..., rows, :], torch.nan)
            drawn = replace(result, **changed, rest_shape=RestShape.of(beam))
            self.states.append((drawn, result))
            return drawn
        if isinstance(result, Solution):
            return replace(result, states=self._drawn(result.state, beam))
        if isinstance(result, Path):
            return replace(result, state=self._drawn(result.state, beam))
        if isinstance(result, (Modes, Critical)):
            return replace(result, shape=result.shape[..., rows, :])
        return result

    def options(self, t: Any, options: dict[str, Any]) -> dict[str, Any]:
        """Those of `simulate`."""
        fixed = options.get("method") in (None, *METHODS) and options.get("form") is None
        if not fixed or any(options.get(name) is not None for name in OWN):
            return options
        self.stepped = True
        if self.steps == 1:
            return options
        step = options.get("step")
        step = default_step(torch.as_tensor(t).tolist()) if step is None else step
        return options | dict(step=step / self.steps)


def _many_eyelets(effect: Any, beam: Beam) -> bool:
    """Whether a tendon goes through three ends of elements in a row that numbers of nodes name."""
    if not isinstance(effect, Tendon) or effect.is_along(beam):
        return False
    steps = [abs(b - a) for a, b in itertools.pairwise(effect.nodes)]
    return any(a == b == beam.order for a, b in itertools.pairwise(steps))


def _firmer(effect: Any, factor: float) -> Any:
    """A `RootSpring` whose placeholders, numbers that are N/m and N m/rad at once, are larger."""
    if not isinstance(effect, RootSpring):
        return effect
    force, moment = effect.stiffness.split(3, -1)
    same = force[..., :, None] == moment[..., None, :]
    both = torch.cat((same.any(-1), same.any(-2)), -1)
    return replace(effect, stiffness=torch.where(both, factor, 1.0) * effect.stiffness)


@contextmanager
def finer(steps: int = 1, elements: int = 1, springs: float = 1) -> Iterator[Finer]:
    """Runs within are finer by these factors; with 1 they are watched alone."""
    here = Finer(steps, elements, springs)
    before = Finer.now.set(here)
    try:
        yield here
    finally:
        Finer.now.reset(before)
