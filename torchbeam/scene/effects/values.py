"""Values of effects: a tensor, numbers, a function of t, an Input; along the beam also a function
of s, or a value for each element.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.arguments import count, function_of
from ...core.arguments import function as check_function
from ...core.declared import plain, real_numbers
from ...core.functions_of_time import at_time, taken, with_user_rate
from ...core.leaves import FunctionOfTime, Placeholder, Tree, leaf, leaves
from ...core.validation import Value, as_tensor, axis_last, real, refusal, shown


@dataclass(frozen=True)
class Input(Placeholder):
    """An input of the scene: `size` numbers by `name`, given at each step (or call) and held over
    it.

    It stands in place of a load's value.

    Examples:
        >>> driven = tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))])
        >>> stepper = tb.Stepper(driven, 0.01)
        >>> state = stepper(stepper.rest(), u=(0, 0, 1.0))  # N, held over the step
    """

    name: str
    size: int

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise refusal(f"an Input with the name {shown(self.name)}", "text")
        count("size", self.size)


torch.serialization.add_safe_globals([Input])


@dataclass(frozen=True)
class Rate(FunctionOfTime):
    """Rate (..., 3) of a function of t, exact; what: its value, in sentences."""

    function: Callable[[Tensor], Tensor] = leaf(1)
    what: str

    def __call__(self, t: Tensor) -> Tensor:
        return with_rate(self.function, t, self.what)[1]


def with_rate(value: Any, t: Tensor, what: str) -> tuple[Tensor, Tensor]:
    """A value (..., 3), or that of a function at t, and its rate."""
    if not callable(value):
        return value, torch.zeros_like(value)
    return with_user_rate(what, lambda now: taken(what, value(now), now, 3), t)


class ByPlace(Tree):
    """A line load's value that differs from site to site: it is asked for the sites (..., sites, 3)
    with the arclengths s (..., sites) at time t, of a beam of so many elements.
    """

    def __call__(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Tensor:
        raise NotImplementedError


@dataclass(frozen=True)
class AtSites(ByPlace):
    """A line load's value (..., sites, 3) at the sites themselves."""

    value: Tensor = leaf(2)

    def __call__(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Tensor:
        return self.value


SIZES = re.compile("must match the size|equal size")  # of torch's words
NUMBER = re.compile("Boolean value of Tensor|converted to (Python s|S)calar")


@dataclass(frozen=True)
class Along(ByPlace):
    """A line load's value as a function of place and time: `function(s, t)` -> (..., sites, 3) per
    metre.

    s (..., sites) m is the arc length from the root, at four Gauss points of each element, t
    (0-dim) s. The function returns a tensor or a (nested) sequence. The nodes of an element bear
    its integral there. Force and moment are exact up to degree 5 in s, also where it jumps at a
    node. A jump inside an element gives a warning: put a node there. The mixed forms ask at the
    middles of elements.

    Examples:
        >>> load = tb.LineLoad(force=tb.Along(lambda s, t: torch.stack((0 * s, 0 * s, 2 * s), -1)))
        >>> tb.equilibrium(tb.Scene(beam, [load])).root.force[2]  # N, of 2 s N/m over 1 m
        tensor(-1.)
    """

    function: Callable[[Tensor, Tensor], Tensor] = leaf(None, check=function_of("s", "t"))

    def __call__(
        self, s: Tensor, t: Tensor, inputs: Inputs | None = None, elements: int | None = None
    ) -> Tensor:
        return at_time(lambda now: self._at(s, now), t, axes=2)

    def _at(self, s: Tensor, t: Tensor) -> Tensor:
        try:
            value = taken("an Along function's value", self.function(s, t), s, 3)
        except (RuntimeError, ValueError) as error:
            if NUMBER.search(str(error)):
                raise ValueError(
                    f"an Along function that takes s as a number was given ({error}); s is a "
                    "tensor of places where the load's force or moment is asked: torch.sin, "
                    "torch.where and the like are wanted"
                ) from None
            if not SIZES.search(str(error)):
                raise
            raise ValueError(
                f"an Along function that does not take s of shape {tuple(s.shape)} was given "
                f"({error}); an axis for s is wanted in what is of a batch, as in "
                "(P[..., None] * s, 0.0, 0.0)"
            ) from None
        if value.ndim > 1 and value.shape[-2] not in (1, s.shape[-1]):
            raise refusal(
                f"an Along function's value of shape {tuple(value.shape)}",
                f"(..., {s.shape[-1]}, 3), of each of s,",
            )
        return value


def _rows(name: str, value: Any) -> Any:
    """A value for each element, checked."""
    if callable(value):
        return check_function(name, value, "t")
    if isinstance(value, Input):
        return value
    rows = plain(value)
    if rows.ndim < 2 or rows.shape[-1] != 3:
        raise refusal(f"PerElement of shape {tuple(rows.shape)}", "(..., N, 3)")
    return real_numbers(name, rows)


@dataclass(frozen=True)
class PerElement(ByPlace):
    """A line load's value for each element.

    It is (..., N, 3) per metre, a function t -> (..., N, 3), or an `Input` of size 3 N with the
    elements' components one element after the other. The nodes of an element bear its load.

    Examples:
        >>> growing = tb.PerElement(
        ...     torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 3], [0, 0, 4]])
        ... )  # N/m
        >>> tb.equilibrium(tb.Scene(beam, [tb.LineLoad(force=growing)])).root.force[2]  # N
        tensor(-2.5000)
    """

    value: Value | Callable[[Tensor], Tensor] = leaf(2, check=_rows)

    def checked(self, value: Any, elements: int) -> Any:
        """`value` if it has a row, or an Input three numbers, for each element; else ValueError."""
        if isinstance(value, Input):
            if value.size != 3 * elements:
                raise ValueError(
                    f"PerElement with an Input of size {value.size} was given; size {3 * elements} "
                    f"is wanted, three of each of {elements} elements"
                )
            return value
        if value.ndim < 2 or tuple(value.shape[-2:]) != (elements, 3):
            raise ValueError(
                f"PerElement of shape {tuple(value.shape)} was given; (..., {elements}, 3) is "
                "wanted, one of each element"
            )
        return value

    def __call__(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Tensor:
        """(..., sites, 3) at arclengths s (..., sites), as many in each element of a beam."""

        def rows(now: Tensor) -> Tensor:
            value = taken("a PerElement function's value", self.value(now), s)
            return self.checked(value, elements)

        function = callable(self.value)
        value = at_time(rows, t, axes=2) if function else self.checked(self.value, elements)
        if isinstance(value, Input):
            value = input_at(value, inputs).unflatten(-1, (elements, 3))
        points, more = divmod(s.shape[-1], elements)
        if more:
            raise refusal(
                f"PerElement at {s.shape[-1]} sites along {elements} elements",
                "as many in each of them",
            )
        return value if points == 1 else value.repeat_interleave(points, -2)


def inputs_of(effect: Tree) -> list[Input]:
    """The inputs that an effect, or a joint, takes, in its leaves or beside them.

    Examples:
        >>> extend.inputs_of(tb.TipLoad(force=tb.Input("u", 3)))
        [Input(name='u', size=3)]
    """
    held = [*(leaf.value for leaf in leaves(effect)), *getattr(effect, "inputs", ())]
    return [value for value in held if isinstance(value, Input)]


Inputs = dict[str, Tensor]
OfTime = Value | Callable[[Tensor], Tensor] | Input | None  # what may be given as a function of t
# an array: plain numbers
LoadValue = Tensor | np.ndarray | Callable[..., Tensor] | Input


def value_at(value: LoadValue, t: Tensor, inputs: Inputs, like: Tensor) -> Tensor:
    """The load's value (..., 3) at time t, 0-dim or each sample's own; an `Input` is looked up by
    name.

    Raises ValueError where an input is missing or has the wrong last axis.
    """
    if isinstance(value, Input):
        return input_at(value, inputs)
    if callable(value):
        return at_time(lambda now: taken("a load function's value", value(now), like, 3), t)
    return value


def input_at(value: Input, inputs: Inputs) -> Tensor:
    """An input's value (..., size). Raises ValueError where it is missing or of another size."""
    if value.name not in inputs:
        known = ", ".join(sorted(inputs)) or "none"
        raise ValueError(f"the input {value.name!r} is wanted at each step; given were: {known}")
    return axis_last(f"input {value.name!r}", inputs[value.name], value.size)


@dataclass(frozen=True)
class PerInterval(Tree):
    """Values of an input (..., K, size), each held over one interval.

    The K intervals are those between output times, or the steps of a rollout. It stands in place of
    an input's value.

    Examples:
        >>> driven = tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))])
        >>> pushes = torch.tensor([[0, 0, 1.0], [0, 0, -1.0]])  # N, one an interval of t
        >>> tb.simulate(
        ...     driven, [0.0, 0.05, 0.1], step=0.01, inputs={"u": tb.PerInterval(pushes)}
        ... ).status
        tensor(0)
    """

    value: Value = leaf(2)

    def __post_init__(self) -> None:
        numbers = self.value  # a tensor stays in its dtype, until the scene that takes it is known
        value = real(numbers) if isinstance(numbers, Tensor) else plain(numbers)
        if value.ndim < 2:
            raise refusal(f"PerInterval of shape {tuple(value.shape)}", "(..., intervals, size)")
        object.__setattr__(self, "value", value)


def inputs_at(inputs: dict[str, Any], t: Tensor, like: Tensor, interval: int = 0) -> dict[str, Any]:
    """Inputs by name at the time t: functions evaluated, values of the interval taken."""

    def value(name: str, v: Any) -> Any:
        if isinstance(v, PerInterval):
            return v.value[..., interval, :]
        what = f"the input {name!r}"
        return at_time(lambda now: taken(what, v(now), like), t) if callable(v) else v

    return {name: value(name, v) for name, v in inputs.items()}


def inputs_over(
    inputs: dict[str, Any],
    steps: range,
    instant: Callable[[int], Tensor],
    interval: Callable[[int], int],
    like: Tensor,
) -> dict[str, Any]:
    """Inputs by name over steps, at the instant and in the interval of each: what differs from step
    to step as `PerInterval` of these steps, where there are several, the others as they are.
    Intervals rise with the steps, by one or none.
    """
    if len(steps) == 1:
        return inputs_at(inputs, instant(steps[0]), like, interval(steps[0]))
    places = [interval(k) for k in steps]
    if places[-1] - places[0] + 1 == len(places):
        places = slice(places[0], places[-1] + 1)

    def value(name: str, v: Any) -> Any:
        if isinstance(v, PerInterval):
            return PerInterval(as_tensor(v.value, like.dtype, like.device)[..., places, :])
        if not callable(v):
            return v
        each = [inputs_at({name: v}, instant(k), like)[name] for k in steps]
        each = [x if x.ndim else x[None] for x in each]  # a number, for an input of one
        return PerInterval(torch.stack(torch.broadcast_tensors(*each), -2))

    return {name: value(name, v) for name, v in inputs.items()}


def first_of(inputs: dict[str, Any]) -> dict[str, Any]:
    """Inputs by name in the first of the steps that they are for."""
    return {
        name: v.value[..., 0, :] if isinstance(v, PerInterval) else v for name, v in inputs.items()
    }


def changing(inputs: dict[str, Any], intervals: int) -> bool:
    """Whether inputs change over so many intervals; ValueError for values of another number."""
    for name, v in inputs.items():
        if isinstance(v, PerInterval) and v.value.shape[-2] != intervals:
            raise ValueError(
                f"the input {name!r} was given for {v.value.shape[-2]} intervals; there are "
                f"{intervals}"
            )
    return any(isinstance(v, PerInterval) or callable(v) for v in inputs.values())


def value_along(
    value: LoadValue | ByPlace,
    s: Tensor | None,
    t: Tensor,
    inputs: Inputs,
    like: Tensor,
    elements: int,
) -> Tensor:
    """The same (..., sites or 1, 3) at sites along the beam, at the arclengths s (..., sites)."""
    if isinstance(value, ByPlace):
        return value(s, t, inputs, elements)
    return value_at(value, t, inputs, like)[..., None, :]


def load_value(name: str, value: Value) -> LoadValue:
    """`value` checked: (..., 3), a function of t, an Input of size 3."""
    if isinstance(value, ByPlace):
        raise ValueError(
            f"{name} as {type(value).__name__} was given; only what acts along the beam takes it"
        )
    return _of_time(name, value, 3)


def line_value(name: str, value: Value) -> LoadValue | ByPlace:
    """The same of what acts along the beam: also Along and PerElement."""
    return value if isinstance(value, ByPlace) else load_value(name, value)


def scalar_value(name: str, value: Any) -> Any:
    """`value` checked: a number (...), a function of t, an Input of size 1."""
    return _of_time(name, value, 1)


def _of_time(name: str, value: Any, size: int) -> Any:
    if callable(value):
        return check_function(name, value, "t")
    if isinstance(value, Input):
        if value.size != size:
            raise refusal(f"{name} with an Input of size {value.size}", f"size {size}")
        return value
    return real_numbers(name, value, *((size,) if size > 1 else ()))


def scalar_at(what: str, value: Any, t: Tensor, inputs: Inputs, like: Tensor) -> Tensor:
    """The number (...) at time t of what `scalar_value` has checked; what: whose it is."""
    if isinstance(value, Input):
        return input_at(value, inputs)[..., 0]
    if callable(value):
        return at_time(lambda now: taken(what, value(now), like), t, axes=0)
    return value
