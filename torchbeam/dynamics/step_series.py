"""Step series: steps of each sample's own lengths and times, as many at once as native code makes."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset
from ..core.functions_of_time import at_time, taken
from ..core.status import SUCCESS
from ..scene.effects import Inputs, PerInterval
from ..state.reduced import whole_of
from ..state.state import State
from .composed import natively
from .failure import Failures
from .stepper import Stepper


def series(stepper: Stepper, state: State, dt: Tensor, t: Tensor, inputs: Inputs, active: Tensor) -> State:
    """States (K, ...) after each of the steps dt (K, ...) s from the times t (K, ...) s on, of samples that are `active` (...).

    inputs  by name, (..., size) held over all, or (K, ..., size) of each step

    A sample whose step fails keeps its state, with a status, and makes none of those that follow.
    """
    made: list[State] = []
    while sum(len(part.t) for part in made) < len(dt):
        done = sum(len(part.t) for part in made)
        few = {name: x[done:] if x.ndim == dt.ndim + 1 else x for name, x in inputs.items()}
        part = _natively(stepper, state, dt[done:], t[done:], few, active)
        if part is None:
            now = {name: x[0] if x.ndim == dt.ndim + 1 else x for name, x in few.items()}
            before = replace(state, t=torch.where(state.status == SUCCESS, t[done], state.t))
            part = stepper.advance(before, now, active=active, dt=dt[done])
            kept = (part.status != SUCCESS) | ~active
            part = replace(part, t=torch.where(kept, state.t, t[done] + dt[done])).map(lambda x: x[None])
        made.append(part)
        state = part[-1]
    return whole_of(made)


def _natively(stepper: Stepper, state: State, dt: Tensor, t: Tensor, inputs: Inputs, active: Tensor) -> State | None:
    """The steps that native code makes at once; all of them where failed ones are not to be made in parts. None where the first
    is to be made by `Stepper.advance`.
    """
    if stepper.compiled is None:
        return None
    start = stepper.reduced(state)
    moving, K, shape = active & (start.status == SUCCESS), len(dt), active.shape
    alone = stepper.method.alone(stepper.model, dt)
    if alone is None:
        return None
    n = alone.solves
    if n > 1:
        inputs = {name: x.repeat_interleave(n, 0) if x.ndim == dt.ndim + 1 else x for name, x in inputs.items()}
    found = natively(alone, stepper.solver, start, dt, t, inputs, moving, last=not stepper.halvings, K=K)
    if found is None:
        return None
    count = K
    if stepper.halvings and not found.well:
        count = found.leading
        if not count:
            return None
    good = (found.status[:count] == SUCCESS).reshape(count, *shape) & moving
    reached = torch.where(good, t[:count] + dt[:count], start.t).cummax(0).values
    after = replace(start, **{name: x[:count] for name, x in found.fields.items()}, t=reached,
                    defect=start.defect.expand(count, *shape), status=torch.where(moving, found.status[:count], start.status))
    return stepper.model.space.to_public(after)


def inputs_by_sample(inputs: dict[str, Any], t: Tensor, stops: Tensor) -> Inputs:
    """Inputs by name at the times t (K, ...) s, of which values per interval change at the stops (n) s: what is held as it is,
    all else as (K, ..., size).
    """
    def value(name: str, v: Any) -> Any:
        if isinstance(v, PerInterval):
            values = v.value if isinstance(v.value, Tensor) else torch.as_tensor(v.value)
            values = values.to(stops).expand(*t.shape, *values.shape[-2:])
            interval = torch.bucketize(t, stops, right=True).sub(1).clamp(0, len(stops) - 2)
            return values.gather(-2, interval[..., None, None].expand(*t.shape, 1, values.shape[-1]))[..., 0, :]
        if not callable(v):
            return v
        found = at_time(lambda now: taken(f"the input {name!r}", v(now), stops), t)
        return found.expand(*t.shape, found.shape[-1])

    return {name: value(name, v) for name, v in inputs.items()}


def part_of(few: BatchSubset, stepper: Stepper, inputs: dict[str, Any]) -> tuple[Stepper, dict[str, Any]]:
    """The stepper and inputs of some samples alone. Raises `NotSeparable`."""
    part = copy(stepper)
    part.model = few.gather(stepper.model)
    part.scene = part.model.scene
    part.solver = stepper.solver.of(part.model)
    part.iterations, part.failures, part._last = None, Failures(), None

    def taken_of(v: Any) -> Any:
        if isinstance(v, PerInterval):
            return few.gather(v)
        return few.take(v, 1) if isinstance(v, Tensor) else lambda t: few.take(taken("an input's value", v(t), t), 1)

    return part, {name: taken_of(v) for name, v in inputs.items()}


def without_parts(stepper: Stepper) -> Stepper:
    """The stepper that makes no failed step in parts."""
    other = copy(stepper)
    other.halvings, other.failures = 0, Failures()
    return other


