"""Rollout: many steps of a stepper, as many at once as native code makes."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count, instance
from ..core.functions_of_time import shared
from ..core.leaves import own_leaves, wants_gradient
from ..core.memory import SMALL, check_memory
from ..core.one_thread import few_on_one_thread, numbers_of
from ..math.shapes import broadcast_shapes
from ..scene.effects import Inputs, changing, inputs_at
from ..scene.inputs import merge_inputs
from ..state.state import State
from ..state.state_check import of_mesh
from .instants import begins_of, exact
from .make_steps import StepPlan, states_after
from .step_inputs import StepInputs, inputs_of_steps
from .stepper import Stepper


@few_on_one_thread(
    lambda stepper, state, *_, **__: numbers_of(getattr(stepper, "scene", None), state)
)
def rollout(
    stepper: Stepper, state: State, steps: int, inputs: dict[str, Any] | None = None, **more: Any
) -> State:
    """Many steps of a stepper in one call: the states (steps, ...) after each of them.

    It equals a loop of calls of the stepper. Native code makes all steps at once if the compiled
    engine takes the scene. It makes no new stepper.

    Args:
        inputs: by name, in a dictionary or by keyword: (..., size) held throughout; a function of
            t, evaluated where the method evaluates its loads; or `PerInterval`, (..., steps, size),
            each held over a step

    It is differentiable as the steps are. A sample that fails keeps its last good state, with a
    status and a RuntimeWarning.

    Raises:
        ValueError: as `Stepper`, and for values for another number of steps.

    Examples:
        >>> stepper = tb.Stepper(tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))]), 0.01)
        >>> pushes = torch.zeros(20, 3)  # N, one a step
        >>> states = tb.rollout(
        ...     stepper, stepper.rest(), 20, inputs={"u": tb.PerInterval(pushes)}
        ... )
        >>> states.t[-1]  # s
        tensor(0.2000)
    """
    state = of_mesh(state, instance("a stepper", stepper, Stepper).scene, "a state")
    plan = plan_of(stepper, state, steps, merge_inputs(inputs, more))
    states = states_after(stepper, state, plan)
    if stepper.failures:
        stepper.failures.warn()
    return states


def plan_of(stepper: Stepper, state: State, steps: int, inputs: dict[str, Any]) -> StepPlan:
    """The steps of a rollout, checked, with room for all their states."""
    instance("a stepper", stepper, Stepper)
    of_mesh(state, stepper.scene, "a state")
    steps = count("steps", steps)
    t, dt = shared(exact(state.t, stepper.latest)), stepper.dt.expand(steps)
    changing(inputs, steps)
    check_room(stepper, state, inputs_at(inputs, t.to(dt), stepper.dt), steps, steps)
    begins = begins_of(t, stepper.dt, steps)
    known = begins.to(dt)

    def inputs_of(first: int, end: int) -> StepInputs:
        rows = slice(first, end)
        return inputs_of_steps(
            stepper.scene, inputs, stepper.method, known[rows], dt[rows], range(first, end)
        )

    return StepPlan(dt, begins, inputs_of)


def check_room(
    stepper: Stepper,
    state: State,
    inputs: Inputs,
    steps: int,
    wanted: int,
    checkpoint: bool | None = None,
) -> None:
    """Raises MemoryError where the states after so many steps are more than there is memory for:
    those that are `wanted`, and where a gradient is recorded all of them, or about 2 sqrt(steps)
    with `checkpoint` (None = that cannot be asked for).
    """
    if state.position.device.type != "cpu":
        return
    inputs = stepper.scene.tensors(inputs)
    shape = broadcast_shapes(
        stepper.scene.batch_shape, state.batch_shape, *(x.shape[:-1] for x in inputs.values())
    )
    solves = steps * stepper.method.SOLVES_A_STEP
    size = shape.numel() * state.position.element_size()
    fields = [x for x in vars(state).values() if isinstance(x, Tensor)]
    if max(wanted, solves) * size * sum([x.numel() for x in fields]) <= SMALL:  # as a rule
        return
    sizes = (
        x.value.shape[x.value.ndim - x.axes :].numel()
        for x in own_leaves(state)
        if x.value is not None
    )
    size *= sum(sizes)
    least = (wanted + 2 * math.isqrt(steps)) * size
    most = max(wanted, solves) * size
    if most <= SMALL:
        return
    text = f"the states of {steps} steps of {shape.numel()} sample(s)"
    if not (torch.is_grad_enabled() and wants_gradient(stepper.model, state, *inputs.values())):
        check_memory(text, wanted * size, "a smaller batch takes less")
    elif checkpoint:
        check_memory(
            f"{text}, with their gradient and checkpoint=True,", least, "a smaller batch takes less"
        )
    else:
        checkpointed = (
            "" if checkpoint is None else f"checkpoint=True takes {least / 1e9:.3g} GB, and "
        )
        check_memory(
            f"{text}, with their gradient,",
            most,
            f"{checkpointed}a smaller batch {'takes ' if not checkpointed else ''}less",
        )
