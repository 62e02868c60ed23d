"""Step sequence: steps of each sample's own lengths, kept; the states on the way, made again by
them, or by 2, 4, ... parts of each. With the lengths as they are, states are a smooth function of
everything that they were made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.leaves import Tree, leaf
from ..math.shapes import largest
from ..state.state import State
from .make_steps import AT_ONCE, ROOM, StepPlan, part_of, states_after
from .step_inputs import inputs_by_sample
from .stepper import Stepper


@dataclass(frozen=True)
class StepSequence(Tree):
    """Instants between steps, (most steps + 1, ...) s; of each sample the first counts + 1 (...) of
    them. stops (n) s: where inputs change.
    """

    instants: Tensor = leaf(0)
    counts: Tensor = leaf(0)
    stops: Tensor = leaf(0)

    @property
    def end(self) -> Tensor:
        """(...) s, of each sample."""
        return self.instants.gather(0, self.counts[None])[0]

    def steps(self, first: int, last: int, level: int) -> tuple[Tensor, Tensor]:
        """Begins and lengths (last - first, ...) s of steps in 2^level parts; past its end, where a
        sample makes none, as long as the shortest of the others.
        """
        parts = 2**level
        k = torch.arange(first, last, device=self.instants.device)
        low = self.instants[k // parts]
        whole = self.instants[(k // parts + 1).clamp(max=len(self.instants) - 1)] - low
        index = (...,) + (None,) * (low.ndim - 1)
        length = whole / parts
        begin = low + (k % parts)[index] * length
        return begin, torch.where(
            length > 0, length, torch.where(length > 0, length, torch.inf).amin()
        )

    def bracket(self, t: Tensor, level: int) -> Tensor:
        """Number (n, ...) of the part of a step, of 2^level, that times t (n, ...) fall into."""
        parts, last = 2**level, self.counts - 1
        series = self.instants.movedim(0, -1).contiguous()
        at = (
            torch.searchsorted(series, t.movedim(0, -1).contiguous(), right=True).movedim(-1, 0) - 1
        )
        at = torch.minimum(at.clamp(min=0), last.clamp(min=0))
        low = self.instants.gather(0, at)
        high = self.instants.gather(0, (at + 1).clamp(max=len(self.instants) - 1))
        share = (t - low) / torch.where(high > low, high - low, torch.ones_like(low))
        return at * parts + (share * parts).long().clamp(0, parts - 1)

    def between(self, stops: Tensor) -> StepSequence:
        """The same, with the derivatives of instants that keep their shares of the way from one
        stop (n) s to the next.
        """
        known = stops.detach()
        k = torch.bucketize(self.instants, known, right=True).sub(1).clamp(0, len(known) - 2)
        share = (self.instants - known[k]) / (known[k + 1] - known[k])
        # zero, but for its derivatives
        moved = (stops[k] - known[k]) * (1 - share) + (stops[k + 1] - known[k + 1]) * share
        return StepSequence(self.instants + moved, self.counts, self.stops)

    def only(self, mask: Tensor) -> StepSequence:
        """The steps of the samples (...) of the mask alone."""
        return StepSequence(self.instants, torch.where(mask, self.counts, 0), self.stops)

    def states(
        self, stepper: Stepper, start: State, inputs: dict[str, Any], level: int, numbers: Tensor
    ) -> State:
        """States (n, ...) after so many (n, ...) parts of steps of 2^level each, from `start` (...)
        on. A sample that fails on the way stays where it is, with a status.
        """
        total, width = self.counts * 2**level, self.counts.numel()
        states, places = _rows(start.map(lambda x: x[None]), numbers == 0, numbers * 0)
        parts, spots, state = [states], [places], start
        done, sequence, place = 0, self, torch.arange(width, device=numbers.device)
        while done < largest(total):
            going = total > done
            few = BatchSubset.worthwhile(going)
            if few is not None:
                try:
                    stepper, inputs = part_of(few, stepper, inputs)
                    state, sequence = few.gather(state), few.gather(sequence)
                    place = place[few.index]
                    numbers, total, going = (few.take(x, 0) for x in (numbers, total, going))
                except NotSeparable:
                    pass
            following = int(total[going].min()) if going.ndim else int(total)
            size = max(1, ROOM // (going.numel() * start.position.shape[-2]))
            stop = min(done + min(AT_ONCE, size), following)
            begin, length = sequence.steps(done, stop, level)
            held = inputs_by_sample(
                inputs, begin + stepper.method.INSTANT * length, self.stops
            ).part
            after = states_after(stepper, state, StepPlan(length, begin, held, going))
            wanted = (numbers > done) & (numbers <= stop)
            rows, here = _rows(after, wanted, numbers - done - 1)
            parts.append(rows)
            columns = here % max(1, going.numel())
            spots.append(here // max(1, going.numel()) * width + place[columns])
            state, done = after[-1], stop
        order = torch.cat(spots).argsort()
        shape = (len(numbers), *self.counts.shape)
        joined = parts[0].map(lambda *x: torch.cat(x)[order], *parts[1:])
        return joined.map(lambda x: x.reshape(*shape, *x.shape[1:]))


def picked(states: State, at: Tensor) -> State:
    """Of states (n, ...) that with the number `at` (...), each sample's own."""

    def taken(x: Tensor) -> Tensor:
        index = at.reshape(1, *at.shape, *(1,) * (x.ndim - at.ndim - 1)).expand(1, *x.shape[1:])
        return x.gather(0, index)[0]

    return states.map(taken)


def _rows(states: State, wanted: Tensor, at: Tensor) -> tuple[State, Tensor]:
    """Those of the states (K, ...) that are wanted (n, ...), in one axis; `at` (n, ...): which of
    them. Second: their places among n and samples.
    """
    shape = wanted.shape[1:]
    spots = wanted.reshape(-1).nonzero()[:, 0]
    samples = shape.numel()
    k, sample = at.reshape(-1)[spots], spots % max(1, samples)

    def taken(x: Tensor) -> Tensor:
        return x.reshape(len(x), samples, *x.shape[1 + len(shape) :])[k, sample]

    return states.map(taken), spots
