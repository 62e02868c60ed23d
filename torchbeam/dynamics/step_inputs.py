"""Inputs of one step of a method, whatever solves it is made of, and of several steps that are made
at once; and the last state that native code has made, which need not be checked and reduced again
to go on from.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.functions_of_time import at_time, taken
from ..core.numbers import Numbers
from ..nodal.coordinates.planar import Planar
from ..nodal.coordinates.spatial import Spatial
from ..scene.effects import Inputs, PerInterval, first_of, inputs_at, inputs_over
from ..scene.scene import Scene
from ..state.state import State
from .method import Method, Scheme

# held over a step, or functions of the share that has passed
GivenInputs = dict[str, Any] | Callable[[float], dict[str, Any]]


class HeldInputs:
    """Inputs by name (..., size): values that are held over the step, or a function of the share of
    it that has passed.
    """

    def __init__(self, given: Inputs | Callable[[float], Inputs]) -> None:
        self.given = given
        self._known: dict[float, Inputs] = {}

    def __call__(self, share: float) -> Inputs:
        if not self.vary:
            return self.given
        if share not in self._known:
            self._known[share] = self.given(share)
        return self._known[share]

    @property
    def vary(self) -> bool:
        return callable(self.given)

    def map(self, change: Callable[[Any], Inputs]) -> HeldInputs:
        """With `change` of what is given at any share."""
        return HeldInputs((lambda share: change(self(share))) if self.vary else change(self.given))

    def part(self, first: float, size: float) -> HeldInputs:
        """Of a part of the step that begins at the share `first` and is a share `size` of it."""
        return HeldInputs(lambda share: self(first + share * size)) if self.vary else self


class StepInputs(NamedTuple):
    """Of K steps, by name: held (..., size) what all are given, each (K, ..., size) what each is;
    within: in their place those of each step, where its solves are given different ones.
    """

    held: Inputs
    each: Inputs = {}  # noqa: RUF012
    within: tuple[HeldInputs, ...] = ()

    def part(self, first: int, end: int) -> StepInputs:
        """Of some of the steps."""
        rows = slice(first, end)
        return StepInputs(
            self.held, {name: x[rows] for name, x in self.each.items()}, self.within[rows]
        )

    def one(self, k: int) -> GivenInputs:
        """What step k is given."""
        return (
            self.within[k].given
            if self.within
            else {**self.held, **{name: x[k] for name, x in self.each.items()}}
        )

    def at(self, k: int, share: float) -> Inputs:
        """What step k is given when this share of it has passed."""
        return self.within[k](share) if self.within else self.one(k)

    @property
    def shapes(self) -> list[torch.Size]:
        """The axes of samples of each."""
        if self.within:
            return [x.shape[:-1] for x in self.within[0](0.0).values()]
        return [
            *(x.shape[:-1] for x in self.held.values()),
            *(x.shape[1:-1] for x in self.each.values()),
        ]

    def of_solves(self, scheme: Scheme, instant: float, count: int, shape: torch.Size) -> Inputs:
        """Of the first of the steps, each solve's, one after the other, (count x solves, *shape,
        size), or what all are given, (..., size). instant: of a solve, as a share of it.
        """
        if self.within:
            return together(self.within[:count], scheme.instants(instant), shape)
        each = {name: in_line(x[:count], shape, 1) for name, x in self.each.items()}
        return {
            **self.held,
            **{
                name: x if scheme.solves == 1 else x.repeat_interleave(scheme.solves, 0)
                for name, x in each.items()
            },
        }


def inputs_of_steps(
    scene: Scene,
    inputs: dict[str, Any],
    method: Method,
    begins: Tensor,
    lengths: Tensor,
    intervals: Sequence[int],
) -> StepInputs:
    """Of steps of these lengths from `begins` on, in these intervals, as `simulate` has them."""
    if method.SOLVES_A_STEP > 1 and any(map(callable, inputs.values())):

        def within(k: int) -> Callable[[float], Inputs]:
            return lambda share: inputs_at(
                inputs, begins[k] + share * lengths[k], lengths, intervals[k]
            )

        return StepInputs(
            {}, within=tuple(HeldInputs(within(k)).map(scene.tensors) for k in range(len(lengths)))
        )
    if not any(isinstance(v, PerInterval) or callable(v) for v in inputs.values()):
        return StepInputs(scene.tensors(inputs))
    values = inputs_over(
        inputs,
        range(len(lengths)),
        lambda k: begins[k] + method.INSTANT * lengths[k],
        lambda k: intervals[k],
        lengths,
    )
    held = scene.tensors(first_of(values))
    each = {
        name: v.value.movedim(-2, 0) for name, v in values.items() if isinstance(v, PerInterval)
    }
    return StepInputs({name: x for name, x in held.items() if name not in each}, each)


def inputs_by_sample(inputs: dict[str, Any], t: Tensor, stops: Tensor) -> StepInputs:
    """Inputs by name at the times t (K, ...) s of as many steps, of which values per interval
    change at the stops (n) s.
    """

    def value(name: str, v: Any) -> Tensor:
        if isinstance(v, PerInterval):
            values = v.value if isinstance(v.value, Tensor) else torch.as_tensor(v.value)
            values = values.to(stops).expand(*t.shape, *values.shape[-2:])
            interval = torch.bucketize(t, stops, right=True).sub(1).clamp(0, len(stops) - 2)
            return values.gather(
                -2, interval[..., None, None].expand(*t.shape, 1, values.shape[-1])
            )[..., 0, :]
        value_at_t = at_time(lambda now: taken(f"the input {name!r}", v(now), stops), t)
        return value_at_t.expand(*t.shape, value_at_t.shape[-1])

    each = {
        name: value(name, v)
        for name, v in inputs.items()
        if isinstance(v, PerInterval) or callable(v)
    }
    return StepInputs({name: v for name, v in inputs.items() if name not in each}, each)


def together(
    steps: Sequence[HeldInputs], instants: Sequence[float], shape: torch.Size | None
) -> Inputs:
    """Those of steps, each at these instants of it, (steps x instants, ..., size), with the
    samples' `shape`; or those of all, where nothing changes, (..., size).
    """
    if len(steps) == 1 and not steps[0].vary:
        return steps[0].given
    rows: list[Inputs] = []
    for step in steps:
        rows += [step(share) for share in instants] if step.vary else [step.given] * len(instants)

    def stacked(name: str) -> Tensor:
        return torch.stack([row[name].expand(*shape, -1) for row in rows])

    return {name: stacked(name) for name in rows[0]}


def in_line(x: Tensor, shape: torch.Size, axes: int = 0) -> Tensor:
    """x (K, ..., own axes) with the samples' `shape` between its first axis and its own."""
    last_axes = x.shape[x.ndim - axes :]
    lead = x.shape[1 : x.ndim - axes]
    return x.reshape(len(x), *(1,) * (len(shape) - len(lead)), *lead, *last_axes).expand(
        len(x), *shape, *last_axes
    )


class StateCache(NamedTuple):
    """The public state; names of its fields whose numbers count, and these; itself in the space's
    coordinates, None = it is; whether it is known that no sample of it has failed.
    """

    state: Callable[[], State | None]
    names: list[str]
    numbers: Numbers
    reduced: State | None
    well: bool

    @classmethod
    def of(cls, state: State, reduced: State, space: Spatial, well: bool) -> StateCache | None:
        """From a public state and itself in the coordinates of a space; None where these do not
        come back from it as they were, or nothing tells whether it is written to.
        """
        same = state is reduced
        if not same and not (
            isinstance(space, Planar) and space.reversible and not state.position.requires_grad
        ):
            return None
        names = ["status"]
        if not same:  # fields that both share are read where they are
            there = vars(reduced)
            names += [
                k for k, x in vars(state).items() if x is not there[k] and isinstance(x, Tensor)
            ]
        numbers = Numbers.of([getattr(state, name) for name in names])
        if numbers is None:
            return None
        return cls(weakref.ref(state), names, numbers, None if same else reduced, well)

    def if_same(self, state: State) -> StateCache | None:
        """This, with `reduced`, if the state is this one, as it was."""
        if self.state() is not state or not self.numbers.stand(
            [getattr(state, name) for name in self.names]
        ):
            return None
        return self if self.reduced is not None else self._replace(reduced=state)
