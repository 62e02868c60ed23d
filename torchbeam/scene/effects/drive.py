"""Drives: the effort along a joint's coordinate as a function of the coordinate and its rate."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import function as check_function
from ...core.declared import own, real_numbers
from ...core.functions_of_time import at_time, taken
from ...core.leaves import leaf, with_values
from ...core.validation import refusal, shown
from ..coordinate_law import OwnLaw, Response, Travel, rows
from .load_point import jacobians
from .values import scalar_value

RATE = "rate"
COORDINATES = ("angle", "travel")


def _values(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise refusal(f"{name} = {shown(value)}", "numbers or tensors by name", are=True)
    return {key: own(real_numbers(f"Drive's value {key!r}", x)) for key, x in value.items()}


@dataclass(frozen=True)
class Drive(OwnLaw):
    """The torque of a hinge, or the force of a slider, as a function of its coordinate and rate.

    A plain function with a parameter `angle`, `travel` or `rate` is one as well.

    Args:
        function: takes, by these names, those that it has: `angle` rad of a hinge, counted over
            turns, or `travel` m of a slider; `rate` rad/s or m/s; t s; and `values`. Returns N m or
            N on the second part, (...). Write it in torch operations; its result for a sample may
            depend on the arguments of that sample alone
        values: parameters by name, numbers or tensors (...). Derivatives are by these; what the
            function closes over is a constant

    An implicit step takes coordinate, rate and t at its middle. Automatic differentiation gives the
    tangent. At rest the rate is zero, and the derivative by it is a damping.

    Raises:
        ValueError: for a function without such parameters, or values that it does not take.

    Examples:
        >>> torque = tb.Drive(lambda rate, c: -c * rate**3, values={"c": 0.2})
        >>> brake = tb.Hinge(None, ("door", 0), axis=(0, 0, 1), torque=torque)
        >>> tb.simulate(tb.Scene({"door": beam}, joints=[brake]), [0.0, 0.1], step=0.05).status
        tensor(0)
    """

    function: Callable[..., Any] = leaf(None)
    values: dict[str, Any] | None = leaf(rows, default=None)

    at = 0  # which of several joints has it
    node = 0  # it does not act along a beam

    def __post_init__(self) -> None:
        values = {} if self.values is None else _values("Drive's values", self.values)
        object.__setattr__(self, "values", values)
        super().__post_init__()
        names = parameters(self.function)
        if not {*COORDINATES, RATE} & {*names}:
            raise ValueError(
                f"a Drive by a function of {', '.join(names) or 'nothing that it names'} was "
                "given; angle or travel, or rate, is wanted among its parameters"
            )
        for name in self.values:
            if name in (*COORDINATES, RATE, "t") or name not in names:
                raise ValueError(
                    f"the value {name!r} was given to a Drive whose function takes "
                    f"{', '.join(names)}; one of these, no coordinate, is wanted"
                )

    def checked(self, name: str, coordinate: str) -> Drive:
        """Itself, in a joint with this coordinate. Raises ValueError for another."""
        known, names = (coordinate, RATE, "t", *self.values), parameters(self.function)
        other = next((x for x in names if x in COORDINATES and x != coordinate), None)
        if other is not None:
            raise refusal(f"{name} by a function of {other}", f"one of {coordinate}, rate or t")
        check_function(name, self.function, named=[x for x in known if x in names])
        return self

    def response(self, travel: Travel) -> Response:
        q, r = travel.after, torch.zeros_like(travel.after)
        if travel.dt is not None:
            q, r = (travel.before + q) / 2, (q - travel.before) / travel.dt
        q, r = self._own(q), self._own(r)
        slope, by_rate = self._slopes(q, r, travel.t)
        slope = slope if travel.dt is None else slope / 2 + by_rate / travel.dt
        effort = self._effort(q, r, travel.t)
        none = travel.memory[..., :0]
        return Response(-self._at_joint(effort, travel), -self._at_joint(slope, travel), none)

    def mixes(self, batch: torch.Size, like: Tensor) -> bool:
        """Whether what the function gives the first sample of a batch changes with the others."""
        q = torch.linspace(0.1, 0.2, batch.numel(), dtype=like.dtype).reshape(*batch, 1)
        other = q + 0.1 * (q > 0.1)
        named = {name: x[..., None] for name, x in self.values.items()}
        alike = with_values(self, values=named, rows=1, at=0)
        first = (alike._effort(x, 2 * x, like.new_zeros(()))[(0,) * q.ndim] for x in (q, other))
        return bool((next(first) - next(first)).abs() > 0)

    def by_rate(self, coordinate: Tensor, rate: Tensor, t: Tensor) -> Tensor:
        """(...) the effort's derivative by the rate, of one joint at these (...)."""
        return self._slopes(coordinate[..., None], rate[..., None], t)[1][..., 0]

    def damper(self, travel: Travel) -> Tensor:
        q = self._own(travel.after)
        return -self._at_joint(self._slopes(q, torch.zeros_like(q), travel.t)[1], travel)

    def _effort(self, q: Tensor, r: Tensor, t: Tensor) -> Tensor:
        """(..., 1) of the joint's coordinate and rate (..., 1)."""
        names = parameters(self.function)
        known = dict.fromkeys(COORDINATES, q) | {RATE: r}
        known |= {name: self._own(x) for name, x in self.values.items()}

        def effort(now: Tensor) -> Tensor:
            named = {name: x for name, x in (known | {"t": now}).items() if name in names}
            value = taken("a Drive's effort", self.function(**named), q)
            if value.shape[-1:] not in ((), (1,)):
                raise refusal(
                    f"a Drive's function that returns the shape {tuple(value.shape)}",
                    f"that of its coordinate, {tuple(q.shape)},",
                )
            return value

        return at_time(effort, t, axes=1) + torch.zeros_like(q)

    def _slopes(self, q: Tensor, r: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        """The derivatives by both."""
        try:
            by = jacobians(lambda *x: self._effort(*x, t), q, r)
        except RuntimeError as error:
            first = next(iter(str(error).splitlines()), "")
            raise ValueError(
                f"a Drive's function that torch cannot differentiate was given ({first}); "
                "torch's operations, which write to none of its arguments, are wanted"
            ) from error
        return tuple(x[..., 0] for x in by)

    def _own(self, x: Tensor) -> Tensor:
        """(..., 1) of all joints (..., J)."""
        return x[..., self.at : self.at + 1] if x.shape[-1] > 1 else x

    def _at_joint(self, x: Tensor, travel: Travel) -> Tensor:
        """The inverse, zero elsewhere."""
        return pad(x, (self.at, travel.after.shape[-1] - 1 - self.at))


def parameters(function: Any) -> tuple[str, ...]:
    """Names of what a function takes; none where it does not say."""
    try:
        return tuple(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return ()


def effort_of(coordinate: str) -> Callable[[str, Any], Any]:
    """A check of a field: as `scalar_value`, or a `Drive` of this coordinate."""

    def check(name: str, value: Any) -> Any:
        if callable(value) and {*COORDINATES, RATE} & {*parameters(value)}:
            value = Drive(value)
        known = isinstance(value, Drive)
        return value.checked(name, coordinate) if known else scalar_value(name, value)

    return check
