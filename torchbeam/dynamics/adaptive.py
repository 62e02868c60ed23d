"""Adaptive steps: a motion whose error is within a tolerance, as the solution itself tells by being
made with other steps.

1. Control (`step_control`): lengths of steps, each sample's own, by the local error of positions.
   An error that one step makes is no measure of what is off in the end: errors of phase add up over
   a run, those of modes that no step resolves do not. What the steps leave out must only be less
   than the tolerance here.
2. Proof: the same run by these steps, by their halves, their quarters, ..., all in many-step calls
   (`StepSequence`). The method is symmetric: the error of a run is a series in even powers of the
   step, if each is divided alike (Hairer, Norsett and Wanner 1993, II.8), so that two runs give one
   of an order two higher (Richardson's extrapolation of the whole run, by which nothing can become
   unstable: that of each step would raise an undamped mode far above the steps by 5/3 a step), and
   the next pair tells what that was worth. Modes of large amplitude come to lie within the steps as
   these shrink; of small ones it is seen that they do not matter.
3. A gradient is that of the last two runs, their steps as they are (frozen: shares of the time,
   should that change).

Friction in joints and tendons makes it of first order (`Method.order`), and an extrapolated run of
second. What an error is told by where forces have corners: `ErrorEstimate`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch.autograd import forward_ad

from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.status import SUCCESS, TOO_MANY
from ..core.validation import concrete
from ..scene.effects import PerInterval
from ..scene.prescribed_motion import PrescribedMotion
from ..state.solution import Event
from ..state.state import State
from .dense_output import between, extrapolated, with_means
from .error_estimate import ErrorEstimate
from .events import Events
from .step_control import Controlled, controlled
from .step_sequence import StepSequence, picked
from .stepper import Stepper
from .tolerance import Tolerance

CHECKS = 32  # instants, beside those asked for, at which the error is looked at
NEAR = 16  # instants about an event


class ErrorCheck(NamedTuple):
    """States (n, ...) at all times that were looked at; 2^level (...) parts of each step; the
    largest error (...) in units of the tolerance; how many of the instants asked for come before it
    is too large; status (...).
    """

    states: State
    level: Tensor
    error: Tensor
    good: Tensor
    status: Tensor


class AdaptiveRun(NamedTuple):
    """States (time, ...) at the instants asked for; where a sample stopped; steps; their check."""

    states: State
    event: Event | None
    steps: Controlled
    proof: ErrorCheck


@dataclass
class _Runs:
    """Runs by parts of the same steps, and what is taken from them near the instants t (n, ...)."""

    stepper: Stepper
    start: State
    inputs: dict[str, Any]
    estimate: ErrorEstimate

    def __post_init__(self) -> None:
        self.motion = PrescribedMotion(self.stepper.scene)

    def run(self, sequence: StepSequence, level: int, t: Tensor) -> list[State]:
        """States before, amid and after the step of the level above that t falls into; of level 0
        before and after.
        """
        n = sequence.bracket(t, max(level - 1, 0))
        numbers = [n, n + 1] if level == 0 else [2 * n, 2 * n + 1, 2 * n + 2]
        numbers = torch.minimum(torch.cat(numbers), sequence.counts * 2**level)
        states = sequence.states(self.stepper, self.start, self.inputs, level, numbers)
        return [states[k : k + len(t)] for k in range(0, len(numbers), len(t))]

    def own(
        self, sequence: StepSequence, level: int, t: Tensor, states: list[State]
    ) -> list[State]:
        """States before and after the step of the level itself."""
        if level == 0:
            return states
        first, middle, last = states
        second = sequence.bracket(t, level) % 2 == 1
        return [middle.where(second, first), last.where(second, middle)]

    def limit(self, coarse: list[State], fine: list[State], t: Tensor) -> State:
        """States at t, extrapolated where that helps; as they are where a sample has failed on the
        way.
        """
        first, middle, last = low, _, high = fine
        if self.estimate.limit is not None:
            low = extrapolated(coarse[0], first, self.estimate.order)
            high = extrapolated(coarse[1], last, self.estimate.order)
        width = high.t - low.t
        share = (t - low.t) / torch.where(width > 0, width, torch.ones_like(width))
        place = self.stepper.method.stress_at(self.stepper.model, width / 2)
        state = with_means(between(low, high, t, self.motion), middle, last, share, place)
        failed = sum(x.status for x in (*coarse, *fine))
        return state if not failed.any() else state.where(failed == SUCCESS, last)


def adaptive(
    stepper: Stepper,
    start: State,
    t: Tensor,
    inputs: dict[str, Any],
    tolerance: Tolerance,
    events: Events,
    most: int,
    first: float | None,
) -> AdaptiveRun:
    """A motion from `start` (...) at the instants t (n,) s."""
    stack = functorch.get_interpreter_stack() or ()
    if any(level.key() == torch._C._functorch.TransformType.Vmap for level in stack):
        raise ValueError(
            "rtol or atol was given within torch.func.vmap, where samples cannot have steps of "
            "their own; batch axes of the scene are wanted, or a step"
        )
    order = stepper.method.order(stepper.model)
    stops = t if any(isinstance(v, PerInterval) for v in inputs.values()) else t[[0, -1]]
    runs = _Runs(stepper, start, inputs, ErrorEstimate.of(stepper.model, order))
    with no_derivatives():
        plain = replace(runs, start=start.map(lambda x: x.detach()))
        steps = controlled(
            stepper, plain.start, stops.detach(), inputs, tolerance, order, most, first, events
        )
        times, count = _times(steps, t.detach()), len(t)
        proof = _proof(plain, steps, times, tolerance, count, most)
    states = proof.states
    if wants_gradient(t) or _recorded(runs, steps):
        sequence = steps.sequence.between(stops)
        states = _again(runs, sequence, proof.level, _times(steps._replace(sequence=sequence), t))
    event = _event(states[count + CHECKS :], steps, events, runs.motion)
    return AdaptiveRun(_held(states[:count], start, t, steps, proof, event), event, steps, proof)


def _times(steps: Controlled, t: Tensor) -> Tensor:
    """Instants (n, ...) at which the error is looked at: those asked for, some of the whole time,
    some about the events.
    """
    sequence, end = steps.sequence, steps.sequence.end
    index = (...,) + (None,) * end.ndim
    begin = sequence.instants[0]
    share = torch.linspace(0, 1, CHECKS + 1, dtype=t.dtype, device=t.device)[1:]
    times = [torch.minimum(t[index], end), begin + (end - begin) * share[index]]
    if (steps.event >= 0).any():
        low, high = ((steps.met + k).clamp(min=0).minimum(sequence.counts) for k in (-1, 2))
        low, high = (sequence.instants.gather(0, k[None])[0] for k in (low, high))
        share = torch.linspace(0, 1, NEAR, dtype=t.dtype, device=t.device)
        times.append(low + (high - low) * share[index])
    return torch.cat([x.expand(len(x), *end.shape) for x in times])


def _proof(
    runs: _Runs, steps: Controlled, times: Tensor, tolerance: Tolerance, count: int, most: int
) -> ErrorCheck:
    """Runs by ever smaller parts of the steps until the error is proved to be within tolerance."""
    sequence, counts = steps.sequence, steps.sequence.counts
    remaining = counts > 0
    level, status = torch.zeros_like(counts), steps.status.clone()
    error = torch.zeros_like(sequence.end)
    good = torch.full_like(counts, count)
    states = runs.start.map(lambda x: x.expand(len(times), *x.shape))
    coarse = runs.run(sequence, 0, times) if remaining.any() else []
    previous, before, now = None, torch.full_like(times, torch.inf), 0
    while remaining.any():
        now += 1
        coarse = runs.own(sequence, now - 1, times, coarse)
        fine = runs.run(sequence.only(remaining), now, times)
        limit = runs.limit(coarse, fine, times)
        pairs = (coarse[0], fine[0]), (coarse[1], fine[2])
        apart = torch.maximum(*(tolerance.distance(*pair) for pair in pairs))
        limits = None if previous is None else tolerance.distance(limit, previous)
        largest_error = runs.estimate(apart, before, limits)
        worst, broken = largest_error.amax(0), (fine[2].status != SUCCESS).any(0)
        spent = (worst > 1) & (counts * 2 ** (now + 1) > most)
        leaving = remaining & ((worst <= 1) | spent | broken)
        states = limit.where(leaving, states)
        level, error = torch.where(leaving, now, level), torch.where(leaving, worst, error)
        good = torch.where(
            leaving & spent, (largest_error[:count] <= 1).long().cumprod(0).sum(0), good
        )
        lost = torch.where(broken, fine[2].status.amax(0), torch.where(spent, TOO_MANY, SUCCESS))
        status = torch.where(leaving & (lost != SUCCESS), lost, status)
        remaining, previous, coarse, before = remaining & ~leaving, limit, fine, apart
    return ErrorCheck(states, level, error, good, status)


def _again(runs: _Runs, sequence: StepSequence, level: Tensor, times: Tensor) -> State:
    """The states of the proof, from each sample's last two runs, with recorded derivatives."""
    states = runs.start.map(lambda x: x.expand(len(times), *x.shape))
    for last in level.unique().tolist():
        if last > 0:
            part = sequence.only(level == last)
            coarse = runs.own(part, last - 1, times, runs.run(part, last - 1, times))
            limit = runs.limit(coarse, runs.run(part, last, times), times)
            states = limit.where(level == last, states)
    return states


def _recorded(runs: _Runs, steps: Controlled) -> bool:
    """Whether a derivative is wanted of what a step makes."""
    if functorch.peek_interpreter_stack() is not None or forward_ad._current_level >= 0:
        return True
    if not torch.is_grad_enabled():
        return False
    sequence = steps.sequence
    first = StepSequence(sequence.instants[:2], sequence.counts.clamp(max=1), sequence.stops)
    after = first.states(runs.stepper, runs.start, runs.inputs, 0, first.counts[None])
    return any(x.requires_grad for x in vars(after).values() if isinstance(x, Tensor))


def _event(
    near: State, steps: Controlled, events: Events, motion: PrescribedMotion
) -> Event | None:
    """The events at which samples stopped, from states (n, ...) about them."""
    if not events.functions:
        return None
    if not len(near.t):
        return Event(steps.event, torch.full_like(steps.sequence.end, torch.inf), None)
    number = steps.event
    with no_derivatives():
        values = concrete(events.values(near))
        change = (values[:, 1:].sign() * values[:, :-1].sign() <= 0) & (values[:, :-1] != 0)
        smallest = values.abs().argmin(1).clamp(max=change.shape[1] - 1)
        at = torch.where(change.any(1), change.long().argmax(1), smallest)  # (events, ...)
        # of those that are zero about there the first; one at least was in the step that was seen
        if len(values) > 1:
            here = change.any(1) | (
                torch.arange(len(values), device=number.device)[(...,) + (None,) * number.ndim]
                == number
            )
            ends = ([picked(near, k) for k in (place, place + 1)] for place in at)
            times = [
                events.zero(*pair, torch.full_like(number, k), motion)[0]
                for k, pair in enumerate(ends)
            ]
            first = torch.where(here, torch.stack(times), torch.inf).argmin(0)
            number = torch.where(number >= 0, first, number)
    at = at.gather(0, number.clamp(min=0)[None])[0]
    t, state = events.zero(*(picked(near, k) for k in (at, at + 1)), number, motion)
    return Event(number, torch.where(number >= 0, t, torch.inf), state)


def _held(
    states: State,
    start: State,
    t: Tensor,
    steps: Controlled,
    proof: ErrorCheck,
    event: Event | None,
) -> State:
    """States (time, ...) with the initial one first, stopped samples held, and their status."""
    index = (...,) + (None,) * proof.status.ndim
    times, first = t.detach()[index].expand(states.status.shape), start.map(lambda x: x[None])
    states = states.map(lambda x, y: torch.cat((y.expand(1, *x.shape[1:]), x[1:])), first)
    last = (proof.good - 1).clamp(min=0)
    k = torch.arange(len(t), device=t.device)[index]
    late = (k >= proof.good) | ((steps.status != SUCCESS) & (times > steps.sequence.end))
    if late.any() and (proof.good < len(t)).any():
        last_states = picked(states, last).map(lambda x: x[None])
        states = states.where(
            k < proof.good, last_states.map(lambda x: x.expand(len(t), *x.shape[1:]))
        )
    if event is not None and event.state is not None:
        stopped = (steps.event >= 0) & (times > concrete(event.t))
        states = event.state.map(lambda x: x[None].expand(len(t), *x.shape)).where(stopped, states)
    late[-1] |= proof.status != SUCCESS
    return replace(states, status=torch.where(late, proof.status, SUCCESS))
