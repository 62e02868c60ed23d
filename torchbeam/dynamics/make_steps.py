"""Steps one after the other: one plan of them, made by native code as many at once as it takes, or
one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset
from ..core.functions_of_time import taken
from ..core.leaves import with_values
from ..core.status import SUCCESS
from ..core.validation import broadcast
from ..scene.effects import PerInterval
from ..state.reduced import whole_of
from ..state.state import State
from .composition import natively
from .failure import Failures
from .instants import exact, rounded
from .step_inputs import StepInputs, in_line
from .step_solver import Span

AT_ONCE = 256  # steps that native code is asked for, at most
ROOM = 2**18  # nodes, over samples and steps, of the states that native code makes at once
# samples, over steps, of which torch computes on one thread: behind what it divides, its other
# threads wait for more so busily that native ones get half of the cores
SERIAL = 2**15 - 1
# of a state, and their own axes: what native code may leave as it is
STILL = {"defect": 0, "straining": 2}


class StepPlan(NamedTuple):
    """Steps to be made: lengths dt s and the times t s (in double precision, if known) from which
    they go on, (K) of all samples or (K, ...) each its own; inputs: first, end -> those of these
    steps; active (...) bool: samples that are to move, None = all; wanted: whether the state after
    a step is asked for, None = each is.
    """

    dt: Tensor
    t: Tensor
    inputs: Callable[[int, int], StepInputs]
    active: Tensor | None = None
    wanted: list[bool] | None = None

    def part(self, first: int, end: int) -> StepPlan:
        """Some of the steps."""
        if end - first == len(self.dt):
            return self
        rows, wanted = slice(first, end), self.wanted
        return self._replace(
            dt=self.dt[rows],
            t=self.t[rows],
            wanted=None if wanted is None else wanted[rows],
            inputs=lambda i, j: self.inputs(first + i, first + j),
        )


class EndState(NamedTuple):
    """A state that steps have come to: public; in the space's coordinates, None = to be found of
    that. Each is made where it is asked for.
    """

    public: Callable[[], State]
    reduced: Callable[[], State] | None = None


class MadeSteps(NamedTuple):
    """The states that were asked for (time, ...), in the space's coordinates, made where they are
    asked for, and the last; iterations (steps, ...); whether the next step is to be made by itself.
    """

    states: Callable[[], State]
    last: EndState
    iterations: Tensor
    stopped: bool


def make_steps(stepper: Any, state: State, plan: StepPlan) -> Iterator[MadeSteps]:
    """The steps of a plan by a `Stepper`, from a public state on, some at a time. A sample whose
    step fails keeps its state, with a status, and makes none of those that follow.
    """
    done, steps, start = 0, len(plan.dt), EndState(lambda: state)
    size = AT_ONCE if stepper.compiled is not None else 1
    while done < steps:
        few = plan.part(done, min(done + size, steps))
        inputs = few.inputs(0, len(few.dt))
        made = _natively(stepper, start, few, inputs)
        if made is None:
            made = _one(stepper, start.public(), few, inputs)
        size = 1 if made.stopped else min(2 * len(made.iterations), AT_ONCE)
        done += len(made.iterations)
        start = made.last
        yield made


def states_after(stepper: Any, state: State, plan: StepPlan) -> State:
    """States (time, ...) that a plan asks for, public ones."""
    return stepper.model.space.to_public(
        whole_of([made.states() for made in make_steps(stepper, state, plan)])
    )


def last_state(
    stepper: Any, state: State, begins: Tensor, held: StepInputs, active: Tensor | None
) -> State:
    """The public state after steps of the usual length from `begins` (steps, ...) s on."""
    count, made = len(begins), None
    wanted = [False] * (count - 1) + [True]
    plan = StepPlan(stepper.dt.expand(count), begins, lambda i, j: held, active, wanted)
    for made in make_steps(stepper, state, plan):
        stepper.iterations = made.iterations[-1]
    return made.last.public()


def _one(stepper: Any, state: State, plan: StepPlan, inputs: StepInputs) -> MadeSteps:
    """The first step, by whatever makes it, in parts where it fails."""
    dt, begin = plan.dt[0], plan.t[0]
    t, counted = begin.to(state.t), exact(state.t, stepper.latest)
    before = (
        state if t.ndim == 0 else replace(state, t=torch.where(state.status == SUCCESS, t, state.t))
    )
    after = stepper.advance(
        before, inputs.one(0), active=plan.active, dt=dt, t=t if t.ndim == 0 else None
    )
    moved = (
        after.status == SUCCESS if plan.active is None else (after.status == SUCCESS) & plan.active
    )
    after = replace(after, t=rounded(torch.where(moved, begin + dt, counted), state.t.dtype))
    stepper.latest = after.t
    asked = 1 if plan.wanted is None else int(plan.wanted[0])
    states = lambda: stepper.reduced(after).map(lambda x: x[None][:asked])  # noqa: E731
    return MadeSteps(states, EndState(lambda: after), stepper.iterations[None], True)


def _natively(
    stepper: Any, reached: EndState, plan: StepPlan, inputs: StepInputs
) -> MadeSteps | None:
    """As many of the steps as native code makes at once and all samples make well; those that fail
    too where no failed step is made in parts, and nobody asks why. None where the first is to be
    made by itself.
    """
    if stepper.compiled is None:
        return None
    method, solver, dt, t = stepper.method, stepper.solver, plan.dt, plan.t
    if reached.reduced is None:
        start, _ = stepper.started(reached.public(), dt[0], inputs.at(0, method.INSTANT))
    else:
        start = reached.reduced()
    active = () if plan.active is None else (plan.active.shape,)
    shape = broadcast(
        "a scene, a state and inputs",
        stepper.scene.batch_shape,
        start.status.shape,
        dt.shape[1:],
        t.shape[1:],
        *active,
        *inputs.shapes,
    )
    scheme = method.alone(stepper.model, in_line(dt, shape).detach())
    if scheme is None:
        return None
    wanted, n = [True] * len(dt) if plan.wanted is None else plan.wanted, scheme.solves
    size = max(1, shape.numel() * stepper.model.node_count * n)
    every = _spacing(wanted) if n == 1 else 1
    most = min(ROOM // size, SERIAL // max(1, every * shape.numel()))
    count = min(len(dt), every * max(1, most))
    every, count = (every, count - count % every) if count >= every else (1, count)
    moving = start.status == SUCCESS
    moving = (moving if plan.active is None else moving & plan.active).expand(shape)
    values = inputs.of_solves(scheme, method.INSTANT, count, shape)

    span = Span(start, dt[:count], t[:count].to(dt), values, moving, last=not stepper.halvings)
    lasting = not stepper.halvings and stepper.failures is None
    result = natively(scheme, solver, span, count, every)
    if result is not None and result.every > 1 and not result.well:
        result = natively(scheme, solver, span, count)
    if result is None:
        return None
    stopped = not result.well and not lasting
    count = result.leading if stopped else count
    if not count:
        return None
    shape = result.status.shape[1:]  # functions of time may bring axes along
    now = in_line(t[:count], shape) + in_line(dt[:count], shape)
    status = start.status.expand(count, *shape)
    before = exact(start.t, stepper.latest)
    if result.well or stopped:
        now = torch.where(moving, now, before)
    else:
        now = torch.where((result.status == SUCCESS) & moving, now, before).cummax(0).values
        status = torch.where(moving, result.status, start.status)
    places = [k for k in range(count) if wanted[k]]
    asked = slice(0, len(places)) if result.every > 1 else _rows(places, count)

    def after(rows: Any, k: Any, *lead: int) -> State:
        fields = {name: _at(x, rows) for name, x in result.fields.items()}
        same = {
            name: x.expand((*lead, *shape, *x.shape[x.ndim - axes :]))
            for name, axes in STILL.items()
            if name not in fields and (x := getattr(start, name, None)) is not None
        }
        t = rounded(_at(now, k), start.t.dtype)
        return with_values(start, **fields, **same, t=t, status=_at(status, k))

    def reduced() -> State:
        return after(count // result.every - 1, count - 1)

    return MadeSteps(
        lambda: after(asked, _rows(places, count), len(places)),
        EndState(lambda: stepper.known(reduced(), well=False), reduced),
        result.iterations[:count],
        stopped,
    )


def _spacing(wanted: list[bool]) -> int:
    """So many steps lie from one that is wanted to the next, and from the first to the one before
    it; 1 where that differs.
    """
    first = wanted.index(True) + 1 if True in wanted else 1
    if first == 1:
        return 1
    return first if all(asked == (k % first == 0) for k, asked in enumerate(wanted, 1)) else 1


def _rows(places: list[int], count: int) -> slice | list[int]:
    """Rows at these places: by a slice, which copies nothing, where they are evenly spaced."""
    gaps = {b - a for a, b in pairwise(places)}
    if not places or len(gaps) > 1:
        return places
    step = min(gaps, default=1)
    return slice(0, count) if len(places) == count else slice(places[0], places[-1] + 1, step)


def _at(x: Tensor, rows: slice | list[int] | int) -> Tensor:
    """x[rows], itself where these are all of them."""
    return x if rows == slice(0, len(x)) else x[rows]


def part_of(few: BatchSubset, stepper: Any, inputs: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The stepper and inputs of some samples alone. Raises `NotSeparable`."""
    part = copy(stepper)
    part.model = few.gather(stepper.model)
    part.scene = part.model.scene
    part.solver = stepper.solver.of(part.model)
    part.iterations, part.failures, part._last = (
        None,
        None if stepper.failures is None else Failures(),
        None,
    )

    def taken_of(v: Any) -> Any:
        if isinstance(v, PerInterval):
            return few.gather(v)
        return (
            few.take(v, 1)
            if isinstance(v, Tensor)
            else lambda t: few.take(taken("an input's value", v(t), t), 1)
        )

    return part, {name: taken_of(v) for name, v in inputs.items()}


def without_parts(stepper: Any) -> Any:
    """The stepper that makes no failed step in parts, and keeps no failures."""
    other = copy(stepper)
    other.halvings, other.failures = 0, None
    return other
