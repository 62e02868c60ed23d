"""Steps of a method, from its solves: one after the other, means of several series, and smaller
steps where one fails.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.leaves import with_values
from ..core.status import SUCCESS
from ..core.validation import concrete
from ..engine.chain.method_functions import mixtures
from ..engine.chain.steps import Steps
from ..math.shapes import broadcast_shapes
from ..nodal.model import Model
from ..state.reduced import AT_NODES, REMEMBERED
from ..state.state import State
from .method import WHOLE, Composition, Scheme
from .step_inputs import together
from .step_solver import Span, StepResult, StepSolver

# fields whose mean is taken
LINEAR = (*AT_NODES, "reaction", "work", "frame", *REMEMBERED)


def step(solver: StepSolver, model: Model, span: Span) -> StepResult:
    """A step of the model, or of a part of its batch."""
    result_of_all = None
    for scheme, samples in solver.method.schemes(model, span.dt):
        who = span.moving if samples is None else span.moving & samples
        result = _mean(scheme, solver, model, span._replace(moving=who))
        result_of_all = (
            result
            if result_of_all is None
            else StepResult(
                result.state.where(who, result_of_all.state),
                torch.where(who, result.status, result_of_all.status),
                torch.where(who, result.iterations, result_of_all.iterations),
            )
        )
    return result_of_all


def _mean(scheme: Scheme, solver: StepSolver, model: Model, span: Span) -> StepResult:
    """The mean of compositions; a sample has failed where one of them has."""
    state, dt, _, inputs, moving, _ = span
    if scheme.solves > 1 and solver.compiled is not None and model is solver.model:
        values = inputs(solver.method.INSTANT)
        shape = broadcast_shapes(
            solver.compiled.batch, moving.shape, *(x.shape[:-1] for x in values.values())
        )
        moved = moving.expand(shape)
        values = together([inputs], scheme.instants(solver.method.INSTANT), shape)
        result = natively(scheme, solver, span._replace(inputs=values, moving=moved))
        if result is not None:
            good = moved & (result.status == SUCCESS)
            after = replace(state, **result.fields, t=torch.where(good, state.t + dt, state.t))
            return StepResult(
                after if concrete(good).all() else after.where(good, state),
                result.status,
                result.iterations,
            )
    good, begin, ends, status, iterations = moving, state, [], None, 0
    for composition in scheme.compositions:
        result = _composed(composition, solver, model, span._replace(state=begin, moving=good))
        if len(scheme.compositions) == 1:
            return result
        ends.append(vars(result.state))
        status = result.status if status is None else torch.where(good, result.status, status)
        iterations = iterations + torch.where(good, result.iterations, 0)
        good = good & (status == SUCCESS)
        begin = replace(state, stress=result.state.stress)  # what the next one starts from
    after = replace(result.state, **_weighted(scheme, model, ends))
    return StepResult(after.where(good, state), status, iterations)


def _weighted(
    scheme: Scheme, model: Model, ends: list[dict[str, Tensor | None]]
) -> dict[str, Tensor]:
    """The weighted mean of states, by the names of the fields that have one."""
    after = {
        name: sum(weight * end[name] for weight, end in zip(scheme.weights, ends, strict=True))
        for name in LINEAR
        if ends[0].get(name) is not None
    }
    after["rotation"] = model.space.normalize(after["rotation"])
    if "frame" in after:
        after["frame"] = after["frame"] / after["frame"].norm(dim=-1, keepdim=True)
    return after


def _composed(composition: Composition, solver: StepSolver, model: Model, span: Span) -> StepResult:
    """Solves one after the other, those of a sample until one fails."""
    (state, dt, t, inputs, moving, last), instant = span, solver.method.INSTANT
    if composition is WHOLE:
        return solver.solve(model, span._replace(t=t + instant * dt, inputs=inputs(instant)))
    now, good, reaction = state, moving, 0.0
    status = iterations = None
    for share, at in zip(composition.fractions, composition.instants(instant), strict=True):
        now, solve_status, count = solver.solve(
            model, Span(now, share * dt, t + at * dt, inputs(at), good, last)
        )
        status = solve_status if status is None else torch.where(good, solve_status, status)
        iterations = count if iterations is None else iterations + torch.where(good, count, 0)
        good = good & (solve_status == SUCCESS)
        reaction = reaction + share * now.reaction
        if not concrete(good).any():
            break
    after = replace(now, t=state.t + dt, reaction=reaction)
    return StepResult(
        after if concrete(good).all() else after.where(good, state), status, iterations
    )


def natively(
    scheme: Scheme, solver: StepSolver, span: Span, K: int | None = None, every: int = 1
) -> Steps | None:
    """A step, or K of dt and t (K), or (K, ...), by native code, see `CompiledStep`; None where
    they are to be made eagerly. The reaction is the mean over the step, the stress that of the last
    solve.
    """
    state, dt, t, inputs, moving, _ = span
    if K is not None and t.ndim > 1 and dt.ndim == 1 and solver.compiled.takes_time:
        dt = dt.reshape(-1, *(1,) * (t.ndim - 1))
    if scheme.solves == 1:
        middle = t + solver.method.INSTANT * dt if solver.compiled.takes_time else None
        dt = dt[0] if K is not None and dt.stride() == (0,) else dt  # the same of all
        return solver.natively(span._replace(dt=dt, t=middle), K, every)
    if moving is None:
        shape = broadcast_shapes(
            solver.compiled.batch, state.batch_shape, *(x.shape[:-1] for x in inputs.values())
        )
        moving = (state.status == SUCCESS).expand(shape)
    span = span._replace(dt=dt, moving=moving)
    if len(scheme.compositions) == 1:
        return _in_a_row(scheme, solver, span, K)
    if solver.extrapolating is not None:
        return _in_a_row(scheme, solver.extrapolating, span, K)
    if K is None:
        return _extrapolated(scheme, solver, span)
    steps: list[Steps] = []
    for k in range(K):
        rows = slice(k * scheme.solves, (k + 1) * scheme.solves)
        values = {name: x[rows] if x.ndim > moving.ndim + 1 else x for name, x in inputs.items()}
        result = _extrapolated(scheme, solver, Span(state, dt[k], t[k], values, moving, span.last))
        if result is None:
            return None
        state = with_values(state, **result.fields)
        if not result.well:
            moving = moving & (result.status == SUCCESS)
        steps.append(result)
    return _stacked(steps)


def _stacked(steps: list[Steps]) -> Steps:
    """Steps one after the other as one of K; a sample that failed has its status from then on."""
    fields = {name: torch.stack([step.fields[name] for step in steps]) for name in steps[0].fields}
    status, well = torch.stack([step.status for step in steps]), all(step.well for step in steps)
    for k in range(1, 1 if well else len(steps)):
        status[k] = torch.where(status[k - 1] == SUCCESS, status[k], status[k - 1])
    return Steps(fields, status, torch.stack([step.iterations for step in steps]), well)


def _extrapolated(scheme: Scheme, solver: StepSolver, span: Span) -> Steps | None:
    """One step by the mean of compositions, by a call of native code each."""
    state, inputs, moving = span.state, span.inputs, span.moving
    ends, status, iterations, good, done, begin = [], None, 0, moving, 0, state
    for composition in scheme.compositions:
        rows = slice(done, done := done + len(composition.fractions))
        values = {name: x[rows] if x.ndim > moving.ndim + 1 else x for name, x in inputs.items()}
        part = span._replace(state=begin, inputs=values, moving=good)
        result = _in_a_row(Scheme((composition,)), solver, part, None)
        if result is None:
            return None
        ends.append(result)
        begin = with_values(state, stress=result.fields["stress"])
        status = result.status if status is None else torch.where(good, result.status, status)
        iterations = iterations + result.iterations
        good = good if result.well else good & (result.status == SUCCESS)
    fields = ends[-1].fields | _weighted(scheme, solver.model, [end.fields for end in ends])
    well = all(end.well for end in ends)
    if not well:
        axes = {name: x.ndim - good.ndim for name, x in fields.items()}
        fields = {
            name: torch.where(good[(..., *(None,) * axes[name])], x, getattr(state, name))
            for name, x in fields.items()
        }
    return Steps(fields, status, iterations, well)


def _in_a_row(scheme: Scheme, solver: StepSolver, span: Span, K: int | None) -> Steps | None:
    """A step, or K, by one call of native code: of a composition, or by a solver that extrapolates
    of the mean of WHOLE and another one.
    """
    state, dt, t = span[:3]
    # first: axes before that of the solves
    n, first, fractions = scheme.solves, 0 if K is None else 1, scheme.fractions
    middle = mixture = None
    if solver.compiled.takes_time:
        t, length = torch.broadcast_tensors(t, dt)
        instants = scheme.instants(solver.method.INSTANT)
        middle = (t.unsqueeze(first) + _times(instants, length, first)).flatten(0, first)
    # then one length, and one tangent, is that of all
    alike = dt.ndim == 0 and K is None and len({*fractions}) == 1
    length = dt * fractions[0] if alike else _times(fractions, dt, first).flatten(0, first)
    if len(scheme.compositions) > 1:
        mixture = dt.new_tensor(mixtures(n - 1, scheme.weights)).repeat(K or 1, 1)
    result = solver.natively(span._replace(dt=length, t=middle), (K or 1) * n, mixture=mixture)
    if result is None:
        return None
    series = {name: x.unflatten(0, (-1, n)) for name, x in result.fields.items()}
    fields = {name: x[:, -1] for name, x in series.items()}
    weights, share = (dt.new_tensor(x) for x in (scheme.weights_of_solves, fractions))
    fields["reaction"] = _summed(weights * share, series["reaction"])
    if mixture is not None:
        done = torch.cat((state.work.expand_as(result.fields["work"][:1]), result.fields["work"]))
        each = done.diff(dim=0).unflatten(0, (-1, n))
        fields["work"] = state.work + _summed(weights, each).cumsum(0)
    status = result.status.unflatten(0, (-1, n))[:, -1]
    if not result.well:
        fields = _before_failing(fields, status == SUCCESS, state)
    iterations = result.iterations.unflatten(0, (-1, n)).sum(1)
    if K is None:
        fields, status = {name: x[0] for name, x in fields.items()}, status[0]
        iterations = iterations[0]
    return Steps(fields, status, iterations, result.well)


def _summed(weights: Tensor, x: Tensor) -> Tensor:
    """The sum over the solves of x (K, n, ...), with weights (n)."""
    return (weights.view(-1, *(1,) * (x.ndim - 2)) * x).sum(1)


def _before_failing(fields: dict[str, Tensor], good: Tensor, state: State) -> dict[str, Tensor]:
    """Fields after steps (K, ...), where a step has not gone well (good (K, ...)) those before it,
    not those amid its solves.
    """

    def restored(name: str, x: Tensor) -> Tensor:
        rows, before = [], getattr(state, name)
        for well, after in zip(good, x, strict=True):
            before = torch.where(well[(..., *(None,) * (after.ndim - well.ndim))], after, before)
            rows.append(before)
        return torch.stack(rows)

    return {name: restored(name, x) for name, x in fields.items()}


def _times(values: tuple[float, ...], x: Tensor, first: int) -> Tensor:
    """values (n) times x (...), (n, ...); or, first = 1, times x (K, ...), (K, n, ...)."""
    return x.new_tensor(values).view(-1, *(1,) * (x.ndim - first)) * x.unsqueeze(first)


def in_parts(
    solver: StepSolver, model: Model, span: Span, halvings: int
) -> tuple[State, Tensor, Tensor]:
    """The step of samples that have failed in one go (`moving`), in 2, 4, ... 2^halvings parts:
    (state after, or before where that fails too; whether it went well; iterations), those few by
    themselves where that is faster.
    """
    state, dt, t, inputs, failed, last = span
    few = BatchSubset.worthwhile(failed)
    if few is not None:
        try:
            part, start = few.gather((model, state))
            held = inputs.map(
                lambda values: {name: few.take(value, 1) for name, value in values.items()}
            )
            dt, t = few.take(dt, 0), few.take(t, 0)
            few_of = Span(start, dt, t, held, few.take(failed, 0), last)
            after, well, counted = _in_parts(solver, part, few_of, halvings)
            none = torch.zeros(failed.shape, dtype=torch.long, device=failed.device)
            return (
                few.scatter(state, after),
                few.put(none, well.long(), 0) > 0,
                few.put(none, counted, 0),
            )
        except NotSeparable:
            pass
    return _in_parts(solver, model, span, halvings)


def _in_parts(
    solver: StepSolver, model: Model, span: Span, halvings: int
) -> tuple[State, Tensor, Tensor]:
    after, dt, t, inputs, failed, _ = span
    counted, left = torch.zeros_like(failed, dtype=torch.long), failed
    for level in range(1, halvings + 1):
        parts, trial, good = 2**level, span.state, left
        for k in range(parts):
            held, now = inputs.part(k / parts, 1 / parts), t + k * dt / parts
            trial, status, iterations = step(
                solver, model, Span(trial, dt / parts, now, held, good, level == halvings)
            )
            counted = counted + torch.where(good, iterations, 0)
            good = good & (status == SUCCESS)
            if not concrete(good).any():
                break
        after = trial.where(good, after)
        left = left & ~good
        if not concrete(left).any():
            break
    return after, failed & ~left, counted
