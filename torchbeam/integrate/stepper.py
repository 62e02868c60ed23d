"""Stepper: one implicit step at a time, for environments, controllers and filters."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor

from ..checks import step_size
from ..effects import Inputs
from ..newton import DIVERGED, LIMIT, SUCCESS, attach, newton, wants_gradient
from ..nodal.model import Model
from ..nodal.step import Step
from ..scene import Scene
from ..state import State, rest

METHODS = ("midpoint",)
TURN = 1.2  # rad that a node may turn in one step; larger turns have more than one solution, and the wrong one gains energy
COS_QUARTER_TURN = math.cos(TURN / 4)


class Stepper:
    """Advances states of a scene by steps of `dt` seconds with the nodal form's implicit step.

    scene      what is simulated; its tensors may carry gradient
    dt         s
    method     "midpoint": the mean-strain step (second order, unconditionally stable in practice, keeps momentum)
    lumped     mass at the nodes alone, as the explicit form has it; by default neighbours are coupled, which makes the
               error of the translational inertia fourth order
    conserve   scale the velocities after each step so that the energy balance closes exactly: for long undamped runs
    tolerance  of the scaled residual, default 1e-8 in float64 and 1e-4 in float32
    iterations at most this many in a Newton solve;  halvings: a failed step is made again in 2, 4, ... 2^halvings parts

    Raises ValueError for an unknown method, a step that is not positive, or a scene that the nodal form does not take.
    """

    def __init__(self, scene: Scene, dt: float, method: str = "midpoint", *, lumped: bool = False,
                 tolerance: float | None = None, iterations: int = LIMIT, halvings: int = 6,
                 conserve: bool = False) -> None:
        if method not in METHODS:
            raise ValueError(f"method = {method!r} was given; {' or '.join(map(repr, METHODS))} is wanted")
        self.scene = scene
        self.dt = torch.as_tensor(step_size("dt", dt), dtype=scene.dtype, device=scene.device)
        self.model = Model.of(scene, lumped)
        self.tolerance, self.limit, self.halvings, self.conserve = tolerance, iterations, halvings, conserve
        self.iterations: Tensor | None = None  # (...) of the last step

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> State:
        """The beam undeformed and at rest."""
        return rest(self.scene, batch_shape)

    def __call__(self, state: State, *, active: Tensor | None = None, dt: Tensor | None = None, **inputs: Any) -> State:
        """The state one step later.

        active  (...) bool: samples that are to move; the others, and those with a status other than 0, stay as they are
        dt      0-dim, another length for this step
        inputs  by name, (..., size): held over the step

        Loads that are functions of time are taken at mid step of the latest sample. Where Newton's method fails, or a node
        turns by more than 1.2 rad, the step of that sample is made again in 2, 4, ... smaller ones. If that fails too it keeps
        its state and gets a status (see `torchbeam.newton.STATUS`); its derivatives are those of standing still.
        """
        dt = self.dt if dt is None else dt
        given = self.scene.tensors(inputs)
        state = state if state.velocity.ndim == state.position.ndim else state.level()
        moving = state.status == SUCCESS if active is None else (state.status == SUCCESS) & active
        t = state.t.detach().amax()
        after, status, self.iterations = self._attempt(state, dt, t + dt / 2, given, moving)
        failed = moving & (status == DIVERGED)
        for level in range(1, self.halvings + 1):
            if not failed.any():
                break
            parts, trial, left = 2**level, state, failed
            for k in range(parts):
                trial, again, iterations = self._attempt(trial, dt / parts, t + (k + 0.5) * dt / parts, given, left)
                self.iterations = self.iterations + torch.where(left, iterations, 0)
                left = left & (again == SUCCESS)
                if not left.any():
                    break
            after = trial.where(left, after)
            status = torch.where(left, SUCCESS, status)
            failed = failed & ~left
        return replace(after, status=torch.where(moving, status, state.status))

    def _attempt(self, state: State, dt: Tensor, t: Tensor, inputs: Inputs, moving: Tensor) -> tuple[State, Tensor, Tensor]:
        """One Newton solve: (state after, of a failed sample before; status; iterations)."""
        problem = Step(self.model, state, dt, t, inputs, self.conserve)
        x, reaction, status, iterations = newton(problem, problem.guess(), moving, self.tolerance, self.limit)
        status = torch.where((status == SUCCESS) & (x.m[..., 0].amin(-1) < COS_QUARTER_TURN), DIVERGED, status)
        good = moving & (status == SUCCESS)
        problem = replace(problem)  # what it had cached carries no gradient
        if wants_gradient(*self._tensors(problem)):
            x = type(x)(*(torch.where(good[..., None, None], a, b) for a, b in zip(x, problem.still(), strict=True)))
            if not good.all():  # nothing that failed samples hold reaches a derivative
                held = {name: torch.where(good[..., None], v, v.detach()) for name, v in inputs.items()}
                problem = replace(problem, start=state.where(good, state.detach()), inputs=held)
            x, reaction = attach(problem, x, good)
        after = problem.finish(x, reaction)
        return (after if good.all() else after.where(good, state)), status, iterations

    def _tensors(self, problem: Step) -> list[Any]:
        """Everything a step depends on, the loads as they come out of the users' functions."""
        model, state = self.model, problem.start
        return [problem.external(state.rotation), *(getattr(x, f.name) for x in (model, state) for f in fields(x))]
