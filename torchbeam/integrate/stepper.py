"""Stepper: one implicit step at a time, for environments, controllers and filters."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor

from ..checks import step_size
from ..nodal.model import Model
from ..nodal.step import Step
from ..scene import Scene
from ..state import State, rest
from ..newton import LIMIT, attach, newton, wants_gradient

METHODS = ("midpoint",)


class Stepper:
    """Advances states of a scene by steps of `dt` seconds with the nodal form's implicit step.

    scene      what is simulated; its tensors may carry gradient
    dt         s
    method     "midpoint": the mean-strain step (second order, unconditionally stable in practice, keeps momentum)
    lumped     mass at the nodes alone, as the explicit form has it; by default neighbours are coupled, which makes the
               error of the translational inertia fourth order
    tolerance  of the scaled residual, default 1e-8 in float64 and 1e-4 in float32; iterations: at most this many a step

    Raises ValueError for an unknown method, a step that is not positive, or a scene that the nodal form does not take.
    """

    def __init__(self, scene: Scene, dt: float, method: str = "midpoint", *, lumped: bool = False,
                 tolerance: float | None = None, iterations: int = LIMIT) -> None:
        if method not in METHODS:
            raise ValueError(f"method = {method!r} was given; {' or '.join(map(repr, METHODS))} is wanted")
        self.scene = scene
        self.dt = torch.as_tensor(step_size("dt", dt), dtype=scene.dtype, device=scene.device)
        self.model = Model.of(scene, lumped)
        self.tolerance, self.limit = tolerance, iterations
        self.iterations: Tensor | None = None  # (...) of the last step

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> State:
        """The beam undeformed and at rest."""
        return rest(self.scene, batch_shape)

    def __call__(self, state: State, *, active: Tensor | None = None, dt: Tensor | None = None, **inputs: Any) -> State:
        """The state one step later.

        active  (...) bool: samples that are to move; the others, and those with a status other than 0, stay as they are
        dt      0-dim, another length for this step
        inputs  by name, (..., size): held over the step

        A sample whose step fails keeps its state and gets a status (see `STATUS`); its gradient is that of standing still.
        """
        problem = Step(self.model, state, self.dt if dt is None else dt, self.scene.tensors(inputs))
        outcome = newton(problem, problem.guess(), self.tolerance, self.limit)
        self.iterations = outcome.iterations
        moving = state.status == 0
        if active is not None:
            moving = moving & active
        good = moving & (outcome.status == 0)
        x, reaction = outcome.x, outcome.reaction
        problem = replace(problem)  # what it had cached carries no gradient
        if wants_gradient(*self._tensors(problem)):
            x = type(x)(*(torch.where(good[..., None, None], a, b) for a, b in zip(x, problem.still(), strict=True)))
            x, reaction = attach(problem, x)
        after = problem.finish(x, reaction)
        if not good.all():
            after = after.map(lambda new, old: torch.where(good[(...,) + (None,) * (new.ndim - good.ndim)], new, old), state)
        return replace(after, status=torch.where(moving, outcome.status, state.status))

    def _tensors(self, problem: Step) -> list[Any]:
        """Everything a step depends on, the loads as they come out of the users' functions."""
        model, state = self.model, problem.start
        return [problem.external(state.rotation), *(getattr(x, f.name) for x in (model, state) for f in fields(x))]
