"""Finer runs of a user's function: shorter steps, or more elements, wherever it asks for a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch

from ...dynamics.methods import METHODS
from ...dynamics.runs import STEPS
from ...scene.effects import RootSpring
from ...scene.scene import Scene
from .remesh import remesh

OWN = "rtol", "atol"  # of steps that control their own error


@dataclass
class Finer:
    """How `simulate` and `equilibrium` run within `finer`: with steps shorter by `steps`, and with
    `elements` times the elements.

    scenes  of each run with more elements: as the user has it, as it is run
    used  whether any run was asked for;  stepped, sprung  whether one had steps of a given length,
          a `RootSpring`, whose placeholders of rigid components `springs` multiplies
    """

    steps: int = 1
    elements: int = 1
    springs: float = 1
    scenes: list[tuple[Scene, Scene]] = field(default_factory=list)
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
        fine = remesh(scene, self.elements * scene.beam.element_count)
        self.scenes.append((scene, fine))
        return fine

    def options(self, t: Any, options: dict[str, Any]) -> dict[str, Any]:
        """Those of `simulate`."""
        fixed = options.get("method") in (None, *METHODS) and options.get("form") is None
        if not fixed or any(options.get(name) is not None for name in OWN):
            return options
        self.stepped = True
        if self.steps == 1:
            return options
        return options | dict(step=_step(t, options.get("step")) / self.steps)


def _firmer(effect: Any, factor: float) -> Any:
    """A `RootSpring` whose placeholders, numbers that are N/m and N m/rad at once, are larger."""
    if not isinstance(effect, RootSpring):
        return effect
    force, moment = effect.stiffness.split(3, -1)
    same = force[..., :, None] == moment[..., None, :]
    both = torch.cat((same.any(-1), same.any(-2)), -1)
    return replace(effect, stiffness=torch.where(both, factor, 1.0) * effect.stiffness)


def _step(t: Any, step: float | None) -> float:
    """s, as `simulate` takes it where none is given."""
    if step is not None:
        return step
    t = torch.as_tensor(t, dtype=torch.float64)
    return min(t.diff().min(), (t[-1] - t[0]) / STEPS).item()


@contextmanager
def finer(steps: int = 1, elements: int = 1, springs: float = 1) -> Iterator[Finer]:
    """Runs within are finer by these factors; with 1 they are watched alone."""
    here = Finer(steps, elements, springs)
    before = Finer.now.set(here)
    try:
        yield here
    finally:
        Finer.now.reset(before)
