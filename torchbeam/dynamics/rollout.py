"""Rollout: many steps of a stepper, as many at once as native code makes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count, instance
from ..core.functions_of_time import shared
from ..core.leaves import own_leaves, wants_gradient
from ..core.memory import SMALL, check_memory
from ..math.shapes import broadcast_shapes
from ..scene.effects import Inputs, changing, first_of, inputs_at, inputs_over
from ..scene.scene import merge_inputs
from ..state.reduced import whole_of
from ..state.state import State, of_mesh
from .held_inputs import GivenInputs, changes_within, given_from
from .stepper import Ahead, Stepper

AT_ONCE = 256  # steps that native code is asked for, at most


def rollout(stepper: Stepper, state: State, steps: int, inputs: dict[str, Any] | None = None, **more: Any) -> State:
    """States (steps, ...) after each of so many steps of a stepper, from a state on: the same as calling it so many times,
    with one call of native code where the compiled engine takes the scene. What the stepper was made of is not made anew.

    inputs  by name, in a dictionary or by keyword: (..., size) held throughout; a function of t, taken where the method takes
            its loads; or `PerInterval`, (..., steps, size), each held over a step

    Differentiable as the steps are. A sample that fails keeps its last good state, with a status. Raises ValueError for what
    `Stepper` refuses, and for values for another number of steps.
    """
    instance("a stepper", stepper, Stepper)
    of_mesh(state, stepper.scene.beam, "a state")
    steps, given = count("steps", steps), merge_inputs(inputs, more)
    t, varies = shared(state.t), changing(given, steps)

    def held(first: int, end: int) -> dict[str, Any] | list[GivenInputs]:
        few = range(first, end if varies else first + 1)
        if within:
            return [given_from(given, t + k * stepper.dt, stepper.dt, stepper.dt, k) for k in few]
        return inputs_over(given, few, lambda k: t + (k + stepper.method.INSTANT) * stepper.dt, int, stepper.dt)

    within = changes_within(given, stepper.method)
    check_room(stepper, state, inputs_at(given, t, stepper.dt), steps, steps)
    lengths = stepper.dt.expand(steps)
    begins = t + torch.arange(steps, dtype=t.dtype, device=t.device) * stepper.dt if t.ndim == 0 else None
    made = [few.states for few in march(stepper, state, lengths, begins, held, [True] * steps)]
    return stepper.model.space.to_public(whole_of(made))


def check_room(stepper: Stepper, state: State, inputs: Inputs, steps: int, wanted: int, checkpoint: bool | None = None) -> None:
    """Raises MemoryError where the states after so many steps are more than there is memory for: those that are `wanted`, and
    where a gradient is recorded all of them, or about 2 sqrt(steps) with `checkpoint` (None = that cannot be asked for).
    """
    if state.position.device.type != "cpu":
        return
    inputs = stepper.scene.tensors(inputs)
    shape = broadcast_shapes(stepper.scene.batch_shape, state.batch_shape, *(x.shape[:-1] for x in inputs.values()))
    own = (x.value.shape[x.value.ndim - x.axes:].numel() for x in own_leaves(state) if x.value is not None)
    size = shape.numel() * sum(own) * state.position.element_size()
    least, most = (wanted + 2 * math.isqrt(steps)) * size, max(wanted, steps * stepper.method.SOLVES_A_STEP) * size
    if most <= SMALL:
        return
    what = f"the states of {steps} steps of {shape.numel()} sample(s)"
    if not (torch.is_grad_enabled() and wants_gradient(stepper.model, state, *inputs.values())):
        check_memory(what, wanted * size, "a smaller batch takes less")
    elif checkpoint:
        check_memory(f"{what}, with their gradient and checkpoint=True,", least, "a smaller batch takes less")
    else:
        told = "" if checkpoint is None else f"checkpoint=True takes {least / 1e9:.3g} GB, and "
        check_memory(f"{what}, with their gradient,", most, f"{told}a smaller batch {'takes ' if not told else ''}less")


def march(stepper: Stepper, state: State, dt: Tensor, t: Tensor | None, held: Callable[[int, int], Any],
          wanted: list[bool]) -> Iterator[Ahead]:
    """Steps dt (K) from the times t (K), None = the samples' own; some at a time. held: first, end -> inputs of these steps,
    see `inputs_over`; wanted: whether the state after a step is asked for.
    """
    done, steps = 0, len(dt)
    size = AT_ONCE if t is not None and stepper.compiled is not None else 1
    while done < steps:
        few = slice(done, min(done + size, steps))
        inputs = held(few.start, few.stop)
        made = None if t is None else stepper.ahead(state, dt[few], t[few], inputs, wanted[few])
        size = 1 if made is None or made.stopped else min(2 * len(made.iterations), AT_ONCE)
        if made is None:
            now = inputs[0] if isinstance(inputs, list) else first_of(inputs)
            last = stepper.advance(state, now, dt=dt[done], t=None if t is None else t[done])
            states = stepper.reduced(last).map(lambda x, asked=int(wanted[done]): x[None][:asked])
            made = Ahead(states, lambda last=last: last, stepper.iterations[None])
        done += len(made.iterations)
        yield made
        if done < steps:
            state = made.last()

