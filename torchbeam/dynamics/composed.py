"""Steps of a method, from its solves: one after the other, means of several series, and smaller steps where one fails."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.status import SUCCESS
from ..core.validation import concrete
from ..math.shapes import broadcast_shapes
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..state.state import State
from .compiled.step import Steps
from .held_inputs import HeldInputs, together
from .method import WHOLE, Composition, Scheme
from .step_solver import Made, StepSolver

LINEAR = ("position", "rotation", "velocity", "spin", "reaction", "work", "frame", "internal")  # fields whose mean is taken


def step(solver: StepSolver, model: Model, state: State, dt: Tensor, t: Tensor, inputs: HeldInputs, moving: Tensor, last: bool
         ) -> Made:
    """A step over dt from t on of the model, or of a part of its batch. Without `last`, its parts can follow."""
    made = None
    for scheme, own in solver.method.schemes(model, dt):
        who = moving if own is None else moving & own
        found = _mean(scheme, solver, model, state, dt, t, inputs, who, last)
        made = found if made is None else Made(found.state.where(who, made.state), torch.where(who, found.status, made.status),
                                               torch.where(who, found.iterations, made.iterations))
    return made


def _mean(scheme: Scheme, solver: StepSolver, model: Model, state: State, dt: Tensor, t: Tensor, inputs: HeldInputs,
          moving: Tensor, last: bool) -> Made:
    """The mean of compositions; a sample has failed where one of them has."""
    first, *others = scheme.compositions
    made = _composed(first, solver, model, state, dt, t, inputs, moving, last)
    if not others:
        return made
    good, ends, status, iterations = moving, [made.state], made.status, made.iterations
    for one in others:
        good = good & (status == SUCCESS)
        made = _composed(one, solver, model, state, dt, t, inputs, good, last)
        ends.append(made.state)
        status, iterations = torch.where(good, made.status, status), iterations + torch.where(good, made.iterations, 0)
    after, space = {}, model.space
    for name in LINEAR:
        if getattr(state, name) is not None:
            after[name] = sum(weight * getattr(end, name) for weight, end in zip(scheme.weights, ends, strict=True))
    after["rotation"] = space.normalize(after["rotation"])
    if "frame" in after:
        after["frame"] = after["frame"] / after["frame"].norm(dim=-1, keepdim=True)
    return Made(replace(ends[0], **after).where(good & (status == SUCCESS), state), status, iterations)


def _composed(composition: Composition, solver: StepSolver, model: Model, state: State, dt: Tensor, t: Tensor,
              inputs: HeldInputs, moving: Tensor, last: bool) -> Made:
    """Solves one after the other, those of a sample until one fails."""
    instant = solver.method.INSTANT
    if composition is WHOLE:
        return solver.solve(model, state, dt, t + instant * dt, inputs(instant), moving, last)
    if solver.compiled is not None and model is solver.model:
        given = inputs(instant)
        shape = broadcast_shapes(solver.compiled.batch, moving.shape, *(x.shape[:-1] for x in given.values()))
        moved = moving.expand(shape)
        given = together([inputs], composition.instants(instant), shape)
        found = natively(composition, solver, state, dt, t, given, moved, last)
        if found is not None:
            good = moved & (found.status == SUCCESS)
            after = replace(state, **found.fields, t=torch.where(good, state.t + dt, state.t))
            return Made(after if concrete(good).all() else after.where(good, state), found.status, found.iterations)
    now, good, reaction = state, moving, 0.0
    status = iterations = None
    for share, at in zip(composition.shares, composition.instants(instant), strict=True):
        now, found, count = solver.solve(model, now, share * dt, t + at * dt, inputs(at), good, last)
        status = found if status is None else torch.where(good, found, status)
        iterations = count if iterations is None else iterations + torch.where(good, count, 0)
        good = good & (found == SUCCESS)
        reaction = reaction + share * now.reaction
        if not concrete(good).any():
            break
    after = replace(now, t=state.t + dt, reaction=reaction)
    return Made(after if concrete(good).all() else after.where(good, state), status, iterations)


def natively(composition: Composition, solver: StepSolver, state: State, dt: Tensor, t: Tensor, inputs: Inputs,
             moving: Tensor | None, last: bool, K: int | None = None, repeat: int = 1, every: int = 1) -> Steps | None:
    """A step of dt (...) from t (...) on, or K of dt (K) from t (K) on, by one call of native code; None where they are to be
    made eagerly. The reaction is the mean over the step, the stress that of the last solve.

    inputs  by name, held over all, or one for each solve, see `together`
    moving  (...) bool, of the whole batch's shape; None = all, of one step
    repeat  in place of K, see `CompiledStep`;  every: likewise
    """
    instant, n = solver.method.INSTANT, len(composition.shares)
    if n == 1:
        middle = t + instant * dt if solver.compiled.takes_time else None
        dt = dt[0] if K is not None and dt.stride() == (0,) else dt  # the same of all
        return solver.natively(state, dt, middle, inputs, moving, last, K, repeat, every)
    if repeat > 1:
        return None
    if moving is None:
        shape = broadcast_shapes(solver.compiled.batch, state.batch_shape, *(x.shape[:-1] for x in inputs.values()))
        moving = (state.status == SUCCESS).expand(shape)
    share = dt.new_tensor(composition.shares)
    first = 0 if K is None else 1  # axes before that of the solves
    middle = None
    if solver.compiled.takes_time:
        t, length = torch.broadcast_tensors(t, dt)
        middle = (t.unsqueeze(first) + _times(composition.instants(instant), length, first)).flatten(0, first)
    found = solver.natively(state, _times(composition.shares, dt, first).flatten(0, first), middle, inputs, moving, last,
                            (K or 1) * n)
    if found is None:
        return None
    series = {name: x.unflatten(0, (-1, n)) for name, x in found.fields.items()}
    fields = {name: x[:, -1] for name, x in series.items()}
    fields["reaction"] = (share.view(n, *(1,) * (series["reaction"].ndim - 2)) * series["reaction"]).sum(1)
    status, iterations = found.status.unflatten(0, (-1, n))[:, -1], found.iterations.unflatten(0, (-1, n)).sum(1)
    if K is None:
        fields, status, iterations = {name: x[0] for name, x in fields.items()}, status[0], iterations[0]
    return Steps(fields, status, iterations, found.well)


def _times(values: tuple[float, ...], x: Tensor, first: int) -> Tensor:
    """values (n) times x (...), (n, ...); or, first = 1, times x (K, ...), (K, n, ...)."""
    return x.new_tensor(values).view(-1, *(1,) * (x.ndim - first)) * x.unsqueeze(first)


def in_parts(solver: StepSolver, model: Model, state: State, dt: Tensor, t: Tensor, inputs: HeldInputs, failed: Tensor,
             halvings: int) -> tuple[State, Tensor, Tensor]:
    """The step of samples that have failed in one go, in 2, 4, ... 2^halvings parts: (state after, or before where that fails
    too; whether it went well; iterations), those few by themselves where that is faster.
    """
    few = BatchSubset.worthwhile(failed)
    if few is not None:
        try:
            part, start = few.gather((model, state))
            held = inputs.map(lambda given: {name: few.take(value, 1) for name, value in given.items()})
            after, well, counted = _in_parts(solver, part, start, few.take(dt, 0), few.take(t, 0), held, few.take(failed, 0),
                                              halvings)
            none = torch.zeros(failed.shape, dtype=torch.long, device=failed.device)
            return few.scatter(state, after), few.put(none, well.long(), 0) > 0, few.put(none, counted, 0)
        except NotSeparable:
            pass
    return _in_parts(solver, model, state, dt, t, inputs, failed, halvings)


def _in_parts(solver: StepSolver, model: Model, start: State, dt: Tensor, t: Tensor, inputs: HeldInputs, failed: Tensor,
              halvings: int) -> tuple[State, Tensor, Tensor]:
    after, counted, left = start, torch.zeros_like(failed, dtype=torch.long), failed
    for level in range(1, halvings + 1):
        parts, trial, good = 2**level, start, left
        for k in range(parts):
            held, now = inputs.part(k / parts, 1 / parts), t + k * dt / parts
            trial, status, iterations = step(solver, model, trial, dt / parts, now, held, good, last=level == halvings)
            counted = counted + torch.where(good, iterations, 0)
            good = good & (status == SUCCESS)
            if not concrete(good).any():
                break
        after = trial.where(good, after)
        left = left & ~good
        if not concrete(left).any():
            break
    return after, failed & ~left, counted
