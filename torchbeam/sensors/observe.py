"""Readings of a trajectory at times of their own: irregular, delayed, missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean
from ..core.arguments import function as check_function
from ..core.validation import Value, as_tensor, broadcast, concrete, finite, refusal, shown
from .sensor import Sensor

NEIGHBOURS = 5  # instants that a slope is found from: fourth order
MILLI = 200  # times later than the end from which on another unit is likely
OUTSIDE = 1e-6  # of the trajectory's length by which a time may lie outside of it


def observe(
    solution: Any,
    sensor: Sensor | Callable[[Any], Tensor],
    times: Value,
    *,
    delay: Value = 0.0,
    rate: bool = False,
) -> Tensor:
    """Readings (times, ..., *sensor.shape) of a solution at times between its instants.

    Args:
        solution: `Solution` of any form, with instants t (time,)
        sensor: of `tb.sensors`, or a function of the states that returns (time, ..., *shape)
        times: (times,) s in any order, or (times, ...) of each sample; a NaN gives the reading NaN
        delay: (...) s by which the readings lag: at the time s the motion of s - delay is read.
            Before the first instant the reading is the first one, at rest (its rate is zero); after
            the last it is NaN
        rate: the reading's derivative by time, per s. Of `NodeVelocity` it is the acceleration in
            the axes of frame a

    A reading between two instants is the cubic of both values and slopes (Hermite). Slopes come
    from the polynomial through the five nearest instants. Errors are h^4/384 y'''' (of a rate
    h^3/125 y''''), and there is one continuous derivative. It is differentiable by the solution, by
    times and by delay, in both modes. A kink of the motion between two instants (a force that
    begins) lowers the order. Instants at the kinks restore it, except for the slopes next to them.

    Stress and reactions are means over a step of an implicit method, which lag by half of it:
    `delay=-step/2` corrects that.

    Raises:
        ValueError: for times beyond the trajectory without a delay, and for other shapes.

    Examples:
        >>> times = torch.tensor([0.013, 0.05, 0.0777])  # s, of a clock of its own
        >>> tb.observe(solution, tb.sensors.TipPosition(), times).shape
        torch.Size([3, 3])
        >>> tb.observe(solution, tb.sensors.TipVelocity(), times, rate=True).shape  # m/s^2
        torch.Size([3, 3])
    """
    boolean("rate", rate)
    if not (hasattr(solution, "t") and hasattr(solution, "state")):
        raise refusal(f"a solution of type {type(solution).__name__}", "a torchbeam.Solution")
    t = solution.t.detach().contiguous()
    if len(t) < 2:
        raise ValueError(
            f"a solution of {len(t)} instants was given to observe; two or more are wanted"
        )
    values = _values(sensor, solution, t)
    shape = values.shape[len(solution.state.t.shape) :]
    shape = sensor.shape if isinstance(sensor, Sensor) else shape
    batch = values.shape[1 : values.ndim - len(shape)]
    times, delay = (as_tensor(x, t.dtype, t.device) for x in (times, delay))
    finite("delay", delay)
    if times.ndim == 0:
        raise ValueError(
            "one number was given for times; a series (times,) or (times, ...) is wanted"
        )
    seen = torch.isfinite(times)
    late = concrete(delay).detach()
    if not (late != 0).any():
        _within(times[seen], t)
    elif late.numel():  # no delay of a search: a unit that differs
        known = concrete(times[seen]).detach()
        if (known - late.max() > 2 * t[-1] - t[0]).any():
            _within(known, t)
    axes = broadcast("times and delay", times.shape[1:], delay.shape)
    if axes:
        batch = broadcast("times and readings", axes, batch)
        values = values.reshape(
            len(t), *(1,) * (len(batch) + len(shape) + 1 - values.ndim), *values.shape[1:]
        )
        values = values.expand(len(t), *batch, *shape)
    seen, times = (
        x.reshape(len(x), *(1,) * (len(axes) - x.ndim + 1), *x.shape[1:]) for x in (seen, times)
    )
    return _read(t, values, times - delay, seen, len(batch), rate)


def _values(sensor: Any, solution: Any, t: Tensor) -> Tensor:
    """Readings (time, ...) at the instants of a solution; ValueError for what is none."""
    read = sensor if isinstance(sensor, Sensor) else check_function("sensor", sensor, "state")
    values = read(solution.state)
    if not isinstance(values, Tensor):
        raise refusal(f"a sensor that gave {shown(values)}", "one of tensors")
    if values.shape[:1] != t.shape:
        said = f"a sensor that gave {tuple(values.shape)} for {len(t)} instants"
        raise refusal(said, "time as its first axis")
    return values


def _read(t: Tensor, values: Tensor, at: Tensor, seen: Tensor, axes: int, rate: bool) -> Tensor:
    """Readings at the instants `at` (times, ...), as far as they are `seen`, whose axes broadcast
    with theirs, of a trajectory of `values` (time, ..., *shape) with `axes` batch axes.
    """
    slopes = _slopes(t, values)
    at = torch.where(seen, at, t[0])
    before, ahead = (off > OUTSIDE * (t[-1] - t[0]) for off in (t[0] - at, at - t[-1]))
    k = torch.searchsorted(t, at.detach().contiguous(), right=True).sub(1).clamp(0, len(t) - 2)
    start, h = t[k], t.diff()[k]
    s = torch.clamp((at - start) / h, 0, 1)

    def wide(x: Tensor) -> Tensor:
        """x (times, ...) with the axes of readings."""
        own = *(1,) * (axes + 1 - x.ndim), *x.shape[1:]
        return x.reshape(len(x), *own, *(1,) * (values.ndim - 1 - axes))

    def taken(x: Tensor, which: Tensor) -> Tensor:
        if which.ndim == 1:
            return x[which]
        return torch.gather(x, 0, wide(which).expand(len(which), *x.shape[1:]))

    (a, b), (va, vb) = (tuple(taken(x, k + i) for i in (0, 1)) for x in (values, slopes))
    h, s, wrong = wide(h), wide(s), wide(~seen | ahead)
    rise, bend = b - a - h * va, h * (vb - va)
    c, d = 3 * rise - bend, bend - 2 * rise
    reading = a + s * (h * va + s * (c + s * d))
    if rate:
        reading = torch.where(wide(before), 0, va + s * (2 * c + 3 * s * d) / h)
    return torch.where(wrong, torch.nan, reading)


def _slopes(t: Tensor, values: Tensor) -> Tensor:
    """Derivatives of `values` (time, ...) at their instants, of polynomials through neighbours."""
    n = min(NEIGHBOURS, len(t))
    power = torch.arange(n, device=t.device)
    near = (torch.arange(len(t), device=t.device) - n // 2).clamp(0, len(t) - n)[:, None] + power
    away = t[near] - t[:, None]
    size = away.abs().amax(-1, keepdim=True)
    powers = (away / size)[:, None] ** power[:, None]  # (time, power, neighbour)
    weights = torch.linalg.solve(powers, (power == 1).to(t).expand(len(t), n)) / size
    weights = weights.reshape(*weights.shape, *(1,) * (values.ndim - 1))
    return sum(weights[:, j] * values[near[:, j]] for j in range(n))


def _within(times: Tensor, t: Tensor) -> None:
    """ValueError for times outside of the trajectory."""
    times, room = concrete(times), OUTSIDE * (t[-1] - t[0])
    if times.numel() and ((times < t[0] - room) | (times > t[-1] + room)).any():
        raise ValueError(
            f"times from {times.min().item():g} to {times.max().item():g} s were given to observe; "
            f"the solution goes from {t[0].item():g} to {t[-1].item():g} s"
            + " (are they in ms?)"
            * bool(times.abs().max() > MILLI * t[-1].abs())
        )
