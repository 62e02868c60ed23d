"""Stepper: one implicit step at a time, for environments, controllers and filters."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..checks import broadcast, concrete, count, step_size
from ..checks import tolerance as check_tolerance
from ..effects import Inputs
from ..newton import DIVERGED, LIMIT, SUCCESS, attach, dependencies, newton, wants_gradient
from ..nodal.alpha import Alpha, AlphaState
from ..nodal.model import Model
from ..nodal.step import Step
from ..rows import Rows, Whole
from ..scene import Scene
from ..state import State, completed, rest

METHODS = {"midpoint": Step, "generalized_alpha": Alpha}
QUICK = 12  # iterations of a step that can still be made in parts: one that takes more is quicker so
TURN = 1.2  # rad that a node may turn in one step; larger turns have more than one solution, and the wrong one gains energy


class Stepper:
    """Advances states of a scene by steps of `dt` seconds with the nodal form's implicit step.

    scene      what is simulated; its tensors may carry gradient. Stiffness, mass, damping and geometry are taken once, here:
               make another Stepper after a change of them, or for a second backward pass by them
    dt         s
    method     "midpoint": the mean-strain step (second order, unconditionally stable in practice, keeps momentum)
               "generalized_alpha": balance at the end of the step, high frequencies damped (second order; stress and reaction
               are then those at the end); the state remembers accelerations, `begin` starts them
    rho_inf    of generalized_alpha: what a step leaves of an infinitely fast motion, 1 (nothing is lost) to 0
    lumped     mass at the nodes alone, as the explicit form has it; by default neighbours are coupled, which makes the
               error of the translational inertia fourth order
    conserve   scale the velocities after each step so that the energy balance closes exactly: for long undamped runs
    tolerance  of the scaled residual, default 1e-8 in float64 and 1e-4 in float32
    iterations at most this many in a Newton solve (12 where its step can still be made in parts)
    halvings   a failed step is made again in 2, 4, ... 2^halvings parts

    Raises ValueError for an unknown method, a step that is not positive, or a scene that the nodal form does not take.
    """

    def __init__(self, scene: Scene, dt: float, method: str = "midpoint", *, lumped: bool = False,
                 tolerance: float | None = None, iterations: int = LIMIT, halvings: int = 6,
                 conserve: bool = False, rho_inf: float | None = None) -> None:
        if method not in METHODS:
            raise ValueError(f"method = {method!r} was given; {' or '.join(map(repr, METHODS))} is wanted")
        own = dict(conserve=conserve)
        if method == "generalized_alpha":
            if conserve:
                raise ValueError("conserve was given; generalized_alpha loses energy by design ('midpoint' takes it)")
            own = dict(rho_inf=0.8 if rho_inf is None else rho_inf)
            if not isinstance(own["rho_inf"], (int, float)) or not 0 <= own["rho_inf"] <= 1:
                raise ValueError(f"rho_inf = {rho_inf!r} was given; a number from 0 to 1 is wanted")
        elif rho_inf is not None:
            raise ValueError(f"rho_inf was given; {method!r} has none (generalized_alpha has)")
        self._step = partial(METHODS[method], **own)
        self.method = METHODS[method]
        self.scene = scene
        self.model = Model.of(scene, lumped)
        if conserve and scene.carried:
            raise ValueError("conserve with a frame or support that moves was given; what holds the beam still is wanted")
        if self.method is Alpha:
            unfit = {"a moving frame": scene.frame is not None, "a mass off its node": self.model.inertia.offset is not None,
                     "a load with internal states": self.model.internal_states > 0}
            for what, given in unfit.items():
                if given:
                    raise ValueError(f"{what} was given to generalized_alpha; 'midpoint' takes it")
        self.dt = torch.as_tensor(step_size("dt", dt), dtype=scene.dtype, device=scene.device)
        self.tolerance = None if tolerance is None else check_tolerance("tolerance", tolerance)
        self.limit = count("iterations", iterations)
        self.halvings = count("halvings", halvings, least=0)
        self.iterations: Tensor | None = None  # (...) of the last step

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> State:
        """The beam undeformed and at rest."""
        return rest(self.scene, batch_shape)

    def __call__(self, state: State, *, active: Tensor | None = None, dt: float | Tensor | None = None, **inputs: Any
                 ) -> State:
        """The state one step later.

        active  (...) bool: samples that are to move; the others, and those with a status other than 0, stay as they are
        dt      0-dim, another length for this step
        inputs  by name, (..., size): held over the step; by keyword, or all in a dictionary inputs={...}

        Loads that are functions of time are taken at mid step of the latest sample. Where Newton's method fails, or a node
        turns by more than 1.2 rad, the step of that sample is made again in 2, 4, ... smaller ones. If that fails too it keeps
        its state and gets a status (see `torchbeam.newton.STATUS`); its derivatives are those of standing still.
        """
        dt = self.dt if dt is None else torch.as_tensor(dt).to(self.dt)
        given = self.scene.tensors(inputs)
        broadcast("a scene, a state and inputs", self.scene.batch_shape, state.batch_shape,
                  *(value.shape[:-1] for value in given.values()))
        state = state if state.velocity.ndim == state.position.ndim else state.level()
        state = self.model.space.enter(completed(self.begin(state, dt, inputs=given), self.scene))
        moving = state.status == SUCCESS
        if active is not None:
            moving = moving & torch.as_tensor(active, dtype=torch.bool, device=moving.device)
        t = state.t.detach().amax()
        after, status, self.iterations = self._attempt(self.model, state, dt, t + self.method.INSTANT * dt, given, moving,
                                                       last=not self.halvings)
        failed = moving & (status == DIVERGED)
        if concrete(failed).any() and self.halvings:
            rows = Rows.few(failed)
            model, start, held = self.model, state, given
            try:
                if rows is not None:
                    model, start, held = rows.of(model), rows.of(start), rows.of(held, 1)
            except Whole:
                rows = None
            if rows is None:
                again, well, more = self._parts(model, start, dt, t, held, failed)
                after = again.where(well, after)
            else:
                again, well, more = self._parts(model, start, dt, t, held, rows.of(failed, 0))
                after = rows.put(after, again)
                well, more = (rows.put(torch.zeros_like(status), x.to(status), 0) for x in (well, more))
            status = torch.where(well > 0, SUCCESS, status)
            self.iterations = self.iterations + more
        return self.model.space.leave(replace(after, status=torch.where(moving, status, state.status)))

    def _parts(self, model: Model, start: State, dt: Tensor, t: Tensor, inputs: Inputs, failed: Tensor
               ) -> tuple[State, Tensor, Tensor]:
        """The step from time t of samples that have failed in one go, in 2, 4, ... parts: (state after, or before where that
        fails too; whether it went well; iterations).
        """
        after, counted = start, torch.zeros_like(failed, dtype=torch.long)
        left = failed
        for level in range(1, self.halvings + 1):
            parts, trial, good = 2**level, start, left
            for k in range(parts):
                now = t + (k + self.method.INSTANT) * dt / parts
                trial, status, iterations = self._attempt(model, trial, dt / parts, now, inputs, good,
                                                          last=level == self.halvings)
                counted = counted + torch.where(good, iterations, 0)
                good = good & (status == SUCCESS)
                if not concrete(good).any():
                    break
            after = trial.where(good, after)
            left = left & ~good
            if not concrete(left).any():
                break
        return after, failed & ~left, counted

    def begin(self, state: State, dt: float | Tensor | None = None, **inputs: Any) -> State:
        """`state` with what the method remembers beside it, and no more: the mean rates of a trial step by "midpoint"."""
        if isinstance(state, AlphaState):
            return state if self.method is Alpha else state.plain()
        if self.method is not Alpha:
            return state
        dt = self.dt if dt is None else torch.as_tensor(dt).to(self.dt)
        trial = copy(self)
        trial.method = trial._step = Step
        after = trial(state, dt=dt, **inputs)
        enter = self.model.space.enter
        rise = Step(self.model, enter(after), dt, dt, {}).strain - Step(self.model, enter(state), dt, dt, {}).strain
        return AlphaState.between(state, *self.model.space.motion(after.velocity - state.velocity, after.spin - state.spin),
                                  rise, dt)

    def _attempt(self, model: Model, state: State, dt: Tensor, t: Tensor, inputs: Inputs, moving: Tensor, last: bool
                 ) -> tuple[State, Tensor, Tensor]:
        """One Newton solve: (state after, of a failed sample before; status; iterations). Without `last`, parts can follow."""
        problem = self._step(model, state, dt, t, inputs)
        limit = self.limit if last else min(self.limit, QUICK)
        x, reaction, status, iterations = newton(problem, problem.guess(), moving, self.tolerance, limit)
        turned = self.model.space.cosine(x.m).amin(-1) < math.cos(TURN * problem.PART / 2)
        status = torch.where((status == SUCCESS) & turned, DIVERGED, status)
        good = moving & (status == SUCCESS)
        problem = replace(problem)  # what it had cached carries no gradient
        if wants_gradient(*dependencies(replace(problem), x)):
            x = type(x)(*(torch.where(good[..., None, None], a, b) for a, b in zip(x, problem.still(), strict=True)))
            if not concrete(good).all():  # nothing that failed samples hold reaches a derivative
                held = {name: torch.where(good[..., None], v, v.detach()) for name, v in inputs.items()}
                problem = replace(problem, start=state.where(good, state.detach()), inputs=held)
            x, reaction = attach(problem, x, good)
        after = problem.finish(x, reaction)
        return (after if concrete(good).all() else after.where(good, state)), status, iterations
