"""Events: functions of the state, at whose zeros a sample stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import function as check_function
from ..core.batch_subset import BatchSubset
from ..core.validation import concrete
from ..math.first_derivative import Once
from ..scene.prescribed_motion import PrescribedMotion
from ..state.state import State
from .dense_output import between

TRIALS = 60  # of a root's place, at most


@dataclass(frozen=True)
class Events:
    """Functions of states (...) that give one number (...) a sample."""

    functions: tuple[Callable[[State], Tensor], ...] = ()

    @classmethod
    def of(cls, events: Any) -> Events:
        """Of a function, or a sequence of them. Raises ValueError for anything else."""
        many = () if events is None else events if isinstance(events, (tuple, list)) else (events,)
        if not all(map(callable, many)):
            raise ValueError(
                f"events of type {type(events).__name__} were given; a function of the state, or a "
                "list of such, is wanted"
            )
        return cls(tuple(check_function("an event", event, "state") for event in many))

    def values(self, states: State) -> Tensor | None:
        """(events, ...); None without events. Raises ValueError where a function gives anything but
        a number a sample.
        """
        if not self.functions:
            return None
        values = []
        for function in self.functions:
            value = function(states)
            if (
                not isinstance(value, Tensor)
                or value.shape != states.status.shape
                or not value.is_floating_point()
            ):
                shown = (
                    f"shape {tuple(value.shape)}"
                    if isinstance(value, Tensor)
                    else type(value).__name__
                )
                raise ValueError(
                    f"an event of {shown} was given for states of shape "
                    f"{tuple(states.status.shape)}; one real number a state is wanted"
                )
            values.append(value)
        return torch.stack(values)

    def crossed(self, before: Tensor, values: Tensor) -> Tensor:
        """Number of the event (K, ...) that has crossed zero at each of the values
        (events, K, ...), from `before` (events, ...) on; -1 = none. What starts at zero has to
        leave it first.
        """
        signs = torch.cat((before[:, None], values), 1).sign()
        last = signs[:, 0]
        crossings = []
        for now in signs.unbind(1)[1:]:
            crossings.append((now != last) & (last != 0))
            last = torch.where(now != 0, now, last)
        met = torch.stack(crossings, 1)
        first = met.long().argmax(0)
        return torch.where(met.any(0), first, -1)

    def zero(
        self, a: State, b: State, event: Tensor, motion: PrescribedMotion
    ) -> tuple[Tensor, State]:
        """Time (...) and state at which the event with the number `event` (...) is zero between two
        states, at which it has different signs, or the end nearer to zero where it has not.
        Differentiable: t = t0 - g(t0)/g'(t0) at the zero t0.

        By secants and halves (the Illinois method, Dowell and Jarratt 1971).
        """
        index = event.clamp(min=0)[None]

        def value(t: Tensor) -> Tensor:
            return self.values(between(a, b, t, motion)).gather(0, index)[0]

        with torch.no_grad():
            low, high = concrete(a.t), concrete(b.t)
            width = high - low
            g_low, g_high = value(low), value(high)
            apart = g_low.sign() * g_high.sign() <= 0
            at, before = torch.where(g_low.abs() <= g_high.abs(), low, high), torch.zeros_like(low)
            for _ in range(TRIALS):
                slope = g_high - g_low
                trial = low - g_low * (high - low) / torch.where(
                    slope != 0, slope, torch.ones_like(slope)
                )
                trial = torch.minimum(torch.maximum(trial, low), high)
                g = value(trial)
                left = g.sign() * g_low.sign() > 0  # the zero lies behind it
                side = torch.where(left, 1.0, -1.0).to(before)
                # the value at an end that stays for the second time
                weight = torch.where(side == before, 0.5, 1.0).to(before)
                g_low = torch.where(left, g, g_low * weight)
                g_high = torch.where(left, g_high * weight, g)
                low, high = torch.where(left, trial, low), torch.where(left, high, trial)
                before = side
                moved, at = (trial - at).abs(), torch.where(apart, trial, at)
                if not (apart & (moved > 4 * torch.finfo(at.dtype).eps * (at.abs() + width))).any():
                    break
            gap = 1e-4 * width
            rate = (value(at + gap) - value(at - gap)) / (2 * gap)
        g = Once.apply(value(at))
        at = at - torch.where(
            apart & (rate != 0),
            (g - g.detach()) / torch.where(rate != 0, rate, torch.ones_like(rate)),
            0.0,
        )
        return at, between(a, b, at, motion)

    def picked(
        self, values: Tensor | None, at: Tensor, some: Tensor, before: Tensor | None
    ) -> Tensor | None:
        """Of values (events, K, ...) those with the number `at` (...), where there are `some`
        (...); else those `before`.
        """
        if values is None:
            return None
        new = values.gather(1, at.expand(len(values), 1, *at.shape))[:, 0]
        return torch.where(some & (new != 0), new, before)

    def taken(self, values: Tensor | None, few: BatchSubset) -> Tensor | None:
        """Of some samples."""
        return None if values is None else few.take(values, 0)
