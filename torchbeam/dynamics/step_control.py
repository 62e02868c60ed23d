"""Step control: lengths of steps, each sample's own, so that none has a larger error than it may.

The error of a step is told by step doubling: a whole step beside two halves, of which the halves go
on. The next length follows the last two errors (proportional and integral: Gustafsson 1991;
Soederlind 2002), the first one the scale of the motion (Hairer, Norsett and Wanner 1993, II.4, for
second-order equations). Some steps of one length are made at once; those behind one that is refused
are thrown away. A sample's steps do not depend on its neighbours'.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.status import SUCCESS, TOO_MANY, UNDERFLOW
from ..core.validation import concrete
from ..math.shapes import largest
from ..state.state import State
from .events import Events
from .instants import SHARE
from .make_steps import StepPlan, part_of, states_after, without_parts
from .step_inputs import inputs_by_sample
from .step_sequence import StepSequence, picked
from .stepper import Stepper
from .tolerance import Tolerance

SAFETY = 0.9
# tolerances that a step may be off by: runs by its halves, quarters, ... follow, see `adaptive`
LOCAL = 10.0
LARGEST, SMALLEST = 4.0, 0.2  # factors from one length to the next
LOST = 0.1  # the same where a step has no solution
LEAST_STEPS = 4  # between two stops
# steps over the whole time, at least, where anything is a function of time: a pulse is not to be
# stepped over
IN_TIME = 25
AT_ONCE = 16  # steps, at most
LEAST = {torch.float64: 1e-10, torch.float32: 1e-5}  # a step, of the time from begin to end


class Controlled(NamedTuple):
    """Steps that were found: sequence, status (...) and rejected steps (...); which event ended a
    sample (...), -1 = none, and in which step (...). The sequence goes one step further, where
    there is time left.
    """

    sequence: StepSequence
    status: Tensor
    rejected: Tensor
    event: Tensor
    met: Tensor


def controlled(
    stepper: Stepper,
    start: State,
    stops: Tensor,
    inputs: dict[str, Any],
    tolerance: Tolerance,
    order: int,
    most: int,
    first: float | None,
    events: Events,
) -> Controlled:
    """Steps from `start` (...) over the stops (n) s, at which steps end."""
    record = _Record(stops, start.status.shape)
    run = _Run(without_parts(stepper), inputs, stops, tolerance, order, most, events, record, start)
    run.h = (
        run.first_length() if first is None else torch.full_like(run.t, first).clamp(min=run.least)
    )
    while run.going.any():
        run.advance()
    return record.controlled(stops)


class _Record:
    """What is kept of all samples."""

    def __init__(self, stops: Tensor, shape: torch.Size) -> None:
        self.shape, count = shape, shape.numel()
        self.begin = stops[:1].expand(count)
        self.times, self.samples, self.numbers = [], [], []
        self.counts, self.rejected, self.status = (
            torch.zeros(count, dtype=torch.long, device=stops.device) for _ in range(3)
        )
        self.event, self.met = torch.full_like(self.counts, -1), torch.zeros_like(self.counts)

    def controlled(self, stops: Tensor) -> Controlled:
        most = largest(self.counts)
        instants = self.begin.expand(most + 1, -1).clone()
        for t, sample, number in zip(self.times, self.samples, self.numbers, strict=True):
            instants[number, sample] = t
        instants = instants.cummax(0).values
        counts, *others = (
            x.reshape(self.shape)
            for x in (self.counts, self.status, self.rejected, self.event, self.met)
        )
        return Controlled(
            StepSequence(instants.reshape(most + 1, *self.shape), counts, stops), *others
        )


class _Run:
    """The samples that are still on the way; tensors (...) of these."""

    def __init__(
        self,
        stepper: Stepper,
        inputs: dict[str, Any],
        stops: Tensor,
        tolerance: Tolerance,
        order: int,
        most: int,
        events: Events,
        record: _Record,
        start: State,
    ) -> None:
        self.stepper, self.inputs, self.stops, self.tolerance, self.order = (
            stepper,
            inputs,
            stops,
            tolerance,
            order,
        )
        self.most, self.events, self.record = most, events, record
        self.state, shape = start, start.status.shape
        self.place = torch.arange(shape.numel(), device=stops.device).reshape(shape)
        self.t = stops[0].expand(shape).clone()
        self.h = self.t
        self.ahead = torch.ones(shape, dtype=torch.long, device=stops.device)  # the stop ahead
        self.counts, self.tries = torch.zeros_like(self.ahead), torch.zeros_like(self.ahead)
        self.limit = torch.full_like(self.ahead, most + 1)  # steps, of one that has met an event
        self.before = torch.ones_like(self.t)  # error of the step before, of the tolerance
        self.refused = torch.zeros(shape, dtype=torch.bool, device=stops.device)
        self.going = start.status == SUCCESS
        self.values = events.values(start)
        self.size = torch.ones_like(self.ahead)  # steps at once
        moved = stepper._changes or any(callable(v) for v in inputs.values())
        self.longest = torch.full_like(
            self.t, float(stops[-1] - stops[0]) / IN_TIME if moved else math.inf
        )
        taken = stepper.method.longest(stepper.model)
        if taken is not None:
            # equal steps to a stop are longer by rounding
            self.longest = torch.minimum(self.longest, 0.999 * taken)
        # of which rounding moves the ends by no more than a share
        told = torch.finfo(stops.dtype).eps * stops.abs().max() / SHARE
        self.least = torch.maximum(LEAST[stops.dtype] * (stops[-1] - stops[0]), told)

    def first_length(self) -> Tensor:
        """A step over which the acceleration moves the beam by about the tolerance, found by a
        trial step that the velocity or, at rest, the time asked for allows.
        """
        state, motion = self.state, self.stops[-1] - self.stops[0]
        speed = torch.linalg.vector_norm(state.velocity, dim=-1).amax(-1)
        length = concrete(self.stepper.model.scene.beam.extent).detach()
        h = torch.where(
            speed > 0,
            torch.minimum(
                0.01 * length / speed.clamp(min=torch.finfo(speed.dtype).tiny), 1e-3 * motion
            ),
            1e-4 * motion,
        )
        h = torch.minimum(h, self.longest)
        after = self._series(state, h[None], self.t[None])[0]
        change = torch.linalg.vector_norm(after.velocity - state.velocity, dim=-1).amax(-1)
        wanted = (
            LOCAL * self.tolerance.position * h / change.clamp(min=torch.finfo(h.dtype).tiny)
        ).sqrt()
        return torch.where(
            torch.isfinite(wanted) & (after.status == SUCCESS), torch.minimum(wanted, 100 * h), h
        )

    def advance(self) -> None:
        """Some steps more, and lengths of the next."""
        self._compact()
        room = self.stops[self.ahead] - self.stops[self.ahead - 1]
        left = torch.where(self.going, self.stops[self.ahead] - self.t, room)
        wanted = torch.minimum(torch.minimum(self.h, room / LEAST_STEPS), self.longest)
        number = (left / wanted - 1e-6).ceil().clamp(min=1)
        size = torch.minimum(self.size, number.long())
        size = torch.minimum(size, (self.most - self.tries).clamp(min=1))
        h, K = left / number, int(size[self.going].max())
        k = torch.arange(K, device=h.device).reshape(-1, *(1,) * h.ndim)
        begins = self.t + k.clamp(max=(number.max() - 1).long()) * h
        # steps past the stop are made, but not taken
        begins = torch.minimum(begins, self.stops[self.ahead] - h)
        halves = torch.stack((begins, begins + h / 2), 1).reshape(2 * K, *h.shape)
        fine = self._series(self.state, (h / 2).expand(2 * K, *h.shape), halves)
        ends, starts = fine[1::2], self.state.map(lambda x: x[None])
        if K > 1:
            starts = starts.map(lambda x, y: torch.cat((x, y)), fine[1:-1:2])
        whole = self._series(starts, h.expand(1, K, *h.shape), begins[None])[0]
        error = self.tolerance.distance(whole, ends) / (2**self.order - 1) / LOCAL
        bad = (whole.status != SUCCESS) | (ends.status != SUCCESS)
        error = torch.where(bad, torch.inf, error)
        values = self.events.values(ends)
        crossed = (
            torch.full_like(k.expand(error.shape), -1)
            if values is None
            else self.events.crossed(self.values, values)
        )
        first = _leading((crossed < 0).reshape(K, *h.shape))
        met = (first < K) & (self.limit > self.most)
        event = crossed.gather(0, first.clamp(max=K - 1)[None])[0]
        limit = torch.where(met, self.counts + first + 2, self.limit)
        allowed = torch.minimum(size, limit - self.counts)
        taken = torch.minimum(_leading(error <= 1), allowed)
        met = met & (first < taken)
        self.limit = torch.where(met, limit, self.limit)
        self.record.event[self.place[met]] = event[met]
        self.record.met[self.place[met]] = (self.counts + first)[met]
        self._take(taken, begins, h, number, ends, values)
        self._adapt(taken, allowed, error, h)

    def _take(
        self, taken: Tensor, begins: Tensor, h: Tensor, number: Tensor, ends: State, values: Any
    ) -> None:
        """Go on from behind the steps that are `taken` (...)."""
        going, K = self.going, len(begins)
        taken = torch.where(going, taken, 0)
        k = torch.arange(K, device=h.device).reshape(-1, *(1,) * h.ndim)
        arrived = going & (taken == number.long())
        instants = begins + h
        instants = torch.where(arrived & (k == taken - 1), self.stops[self.ahead], instants)
        used = k < taken
        record, place = self.record, self.place.expand(instants.shape)
        record.times.append(instants[used])
        record.samples.append(place[used])
        record.numbers.append((self.counts + k + 1)[used])
        some = taken > 0
        at = (taken - 1).clamp(min=0)
        last = picked(ends, at)
        self.state = last.where(some, self.state)
        self.values = self.events.picked(values, at, some, self.values)
        self.t = torch.where(some, instants.gather(0, at[None])[0], self.t)
        self.counts = self.counts + taken
        self.ahead = self.ahead + arrived.long()
        record.counts[self.place] = self.counts
        done = self.ahead >= len(self.stops)
        self.ahead = self.ahead.clamp(max=len(self.stops) - 1)
        self.going = going & ~done & (self.counts < self.limit)

    def _adapt(self, taken: Tensor, allowed: Tensor, error: Tensor, h: Tensor) -> None:
        """Lengths of the next steps, from the largest error of those taken, or the one refused."""
        going, K, k = self.going, len(error), 1 / (self.order + 1)
        refused = going & (taken < allowed)
        at = torch.arange(K, device=h.device).reshape(-1, *(1,) * h.ndim)
        largest = torch.where(at < taken, error, 0.0).amax(0)
        wrong = error.gather(0, taken.clamp(max=K - 1)[None])[0]
        largest, wrong = largest.clamp(min=1e-8), wrong.clamp(min=1e-8)
        factor = SAFETY * largest ** (-0.8 * k) * self.before ** (0.2 * k)
        factor = torch.where(self.refused, factor.clamp(max=1.0), factor).clamp(SMALLEST, LARGEST)
        smaller = torch.where(
            torch.isfinite(wrong), (SAFETY * wrong**-k).clamp(SMALLEST, SAFETY), LOST
        )
        self.before = torch.where(taken > 0, largest, self.before)
        proposed = torch.where(refused, h * smaller, h * factor)
        # by a stop: what comes after it is not bound by that
        shortened = ~refused & (h < 0.9 * self.h)
        self.h = torch.where(shortened, torch.maximum(proposed, self.h), proposed)
        self.refused = refused
        record = self.record
        record.rejected[self.place] += torch.where(refused, 1, 0)
        self.tries = self.tries + taken + refused.long()
        under = going & refused & (self.h < self.least)
        many = self.going & ~under & (self.tries >= self.most)
        status = torch.where(under, UNDERFLOW, torch.where(many, TOO_MANY, SUCCESS))
        record.status[self.place] = torch.where(under | many, status, record.status[self.place])
        self.going = self.going & ~under & ~many
        # all were of use, and about as long as they may be
        well = (taken >= allowed) & (proposed < 1.25 * h)
        self.size = torch.where(
            well, (2 * self.size).clamp(max=AT_ONCE), (self.size // 2).clamp(min=1)
        )

    def _series(self, state: State, dt: Tensor, t: Tensor) -> State:
        """States after each step; samples that are not going stay."""
        inputs = inputs_by_sample(
            self.inputs, t + self.stepper.method.INSTANT * dt, self.stops
        ).part
        active = (self.going & (self.state.status == SUCCESS)).expand(dt.shape[1:])
        return states_after(self.stepper, state, StepPlan(dt, t, inputs, active))

    def _compact(self) -> None:
        """Leave out samples that have arrived, where that is worth it."""
        few = BatchSubset.worthwhile(self.going)
        if few is None:
            return
        try:
            self.stepper, self.inputs = part_of(few, self.stepper, self.inputs)
        except NotSeparable:
            return
        self.state, self.tolerance = few.gather(self.state), few.gather(self.tolerance)
        self.values = self.events.taken(self.values, few)
        for name in (
            "place",
            "t",
            "h",
            "ahead",
            "counts",
            "tries",
            "limit",
            "before",
            "refused",
            "size",
            "going",
            "longest",
        ):
            setattr(self, name, few.take(getattr(self, name), 0))


def _leading(mask: Tensor) -> Tensor:
    """How many (...) of the first of a mask (K, ...) hold without a gap."""
    return mask.long().cumprod(0).sum(0)
