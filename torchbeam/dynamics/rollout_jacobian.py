"""Rollout jacobian: what is read of the states of a rollout, and its derivatives by whatever its
inputs, its start or its scene were made of.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count, function, instance
from ..core.leaves import own_leaves, with_values
from ..engine.chain.cotangents import rows_of_steps, rows_of_sums
from ..scene.inputs import merge_inputs
from ..state.reduced import whole_of
from ..state.state import State
from .make_steps import make_steps
from .rollout import plan_of
from .stepper import Stepper

# steps with gradient, over samples and rows: as many as are held in memory at once; and as are
# worth a sweep of their own, over the steps alone that these rows follow from
ROOM, WORTH = 400_000, 8_000
PARTS = 8  # of which the sweeps make 9/16 of the steps


def rollout_jacobian(
    stepper: Stepper,
    state: State,
    steps: int,
    inputs: dict[str, Any] | None,
    read: Callable[[State], Tensor],
    by: Tensor,
    *,
    every: int = 1,
) -> tuple[Tensor, Tensor]:
    """Readings along a `rollout`, and their derivatives by a tensor: the sensitivities of a
    trajectory.

    They are exact as gradients are; one sweep of native code finds all rows.

    Args:
        steps, inputs: as in `rollout`, with gradient from `by` to them, to the state or the scene
        read: function of the states (S, ...) after every `every` steps -> (S, ..., r), each state
            by itself. It may hold objects made of `by`, such as a scene
        by: the tensor; requires gradient
        every: a divisor of steps: S is their quotient

    Returns:
        Readings (S, ..., r) and derivatives (S, r, *by.shape) of their sums over the samples. If
        `by` has a row for each sample, these are each sample's derivatives. Both are constants: no
        derivatives go through them.

    Raises:
        ValueError: as `rollout` does; if `by` does not require a gradient, or `every` does not
            divide the steps; for readings of another shape, and within `torch.inference_mode()`.

    Examples:
        >>> stepper = tb.Stepper(tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))]), 0.01)
        >>> pushes = torch.zeros(20, 3, requires_grad=True)  # N, one a step
        >>> tips, slopes = tb.rollout_jacobian(
        ...     stepper,
        ...     stepper.rest(),
        ...     20,
        ...     {"u": tb.PerInterval(pushes)},
        ...     lambda states: states.position[..., -1, :],
        ...     pushes,
        ...     every=5,
        ... )
        >>> tips.shape, slopes.shape
        (torch.Size([4, 3]), torch.Size([4, 3, 20, 3]))
    """
    _check(stepper, steps, by, every)
    with torch.enable_grad():
        plan = plan_of(stepper, state, steps, merge_inputs(inputs, {}))
        made = whole_of([part.states() for part in make_steps(stepper, state, plan)])
        held = {leaf.name: leaf.value for leaf in own_leaves(made) if leaf.value is not None}
        fields = {name: x for name, x in held.items() if x.requires_grad}
        at = slice(every - 1, None, every)
        ends = {name: x.detach()[at].requires_grad_() for name, x in fields.items()}
        reached = with_values(made.map(lambda x: x.detach()[at]), **ends)
        values = _read(read, stepper.model.space.to_public(reached))
    S, r = len(values), values.shape[-1]
    if not values.numel():
        return values.detach(), by.new_zeros(S, r, *by.shape)
    slopes, direct = _slopes(values, ends, by)
    row = steps * reached.t.shape[1:].numel()
    parts = min(PARTS, max(1, S * r * row // WORTH))
    size = max(1, min(ROOM // row, -(-S * r // parts)))
    sweeps = [
        _rows(fields, slopes, range(first, min(first + size, S * r)), r, every, by)
        for first in range(0, S * r, size)
    ]
    whole = torch.cat(sweeps) if len(sweeps) > 1 else sweeps[0]
    if direct:
        row = torch.arange(S * r, device=by.device)
        weights = values.new_zeros(S * r, *values.shape)
        weights[row, row // r, ..., row % r] = 1
        whole = whole + rows_of_sums([values], [weights], by)
    return values.detach(), whole.reshape(S, r, *by.shape)


def _check(stepper: Stepper, steps: int, by: Tensor, every: int) -> None:
    """ValueError where there is no such jacobian."""
    instance("a stepper", stepper, Stepper)
    if torch.is_inference_mode_enabled():
        raise ValueError(
            "derivatives of a rollout within torch.inference_mode() were asked for, which records "
            "none; torch.no_grad() is wanted in its place"
        )
    if not instance("by", by, Tensor).requires_grad:
        raise ValueError("by was given without gradient; a tensor that requires it is wanted")
    if count("steps", steps) % count("every", every):
        raise ValueError(f"every = {every} was given for {steps} steps; a divisor is wanted")


def _read(read: Callable[[State], Tensor], states: State) -> Tensor:
    """read(states); what cannot be called so is refused in a sentence (which is looked for where
    that fails: to look beforehand takes as long as twenty tensor operations), as are other shapes.
    """
    try:
        values = read(states)
    except TypeError:
        function("read", read, "states")
        raise
    batch = states.t.shape
    if not isinstance(values, Tensor) or values.shape[:-1] != batch:
        kind = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
        raise ValueError(
            f"read gave {kind} of states {tuple(batch)}; a tensor with these axes and one more is "
            "wanted"
        )
    return values


def _slopes(values: Tensor, ends: dict[str, Tensor], by: Tensor) -> tuple[dict[str, Tensor], bool]:
    """By fields, (r, S, ..., own): derivatives of each number that is read of a state; and whether
    they depend on `by` themselves.
    """
    if not values.requires_grad:
        return {}, False
    with torch.enable_grad():
        sums = values.flatten(0, -2).sum(0).unbind()
    rows: list[tuple[Tensor | None, ...]] = [
        torch.autograd.grad(x, [*ends.values(), by], retain_graph=True, allow_unused=True)
        for x in sums
    ]
    *of_ends, of_by = zip(*rows, strict=True)
    slopes = {
        name: torch.stack([torch.zeros_like(end) if x is None else x for x in slope])
        for (name, end), slope in zip(ends.items(), of_ends, strict=True)
        if any(x is not None for x in slope)
    }
    return slopes, any(x is not None for x in of_by)


def _rows(
    fields: dict[str, Tensor],
    slopes: dict[str, Tensor],
    numbers: range,
    r: int,
    every: int,
    by: Tensor,
) -> Tensor:
    """(rows, *by.shape): row s r + i is of number i that is read after (s + 1) `every` steps."""
    if not slopes:
        return by.new_zeros(len(numbers), *by.shape)
    row = torch.arange(len(numbers), device=by.device)
    s, i = (row + numbers.start) // r, (row + numbers.start) % r
    steps = (numbers[-1] // r + 1) * every
    outputs, weights = [fields[name] for name in slopes], []
    for x, slope in zip(outputs, slopes.values(), strict=True):
        derivative = x.new_zeros(len(numbers), steps, *x.shape[1:])
        derivative[row, (s + 1) * every - 1] = slope[i, s]
        weights.append(derivative)
    rows = rows_of_steps(outputs, weights, by)
    if rows is not None:
        return rows
    with torch.enable_grad():
        outputs = [x[:steps] for x in outputs]
    return rows_of_sums(outputs, weights, by)
