"""`Load`: defined by a user's function of the motion, with optional internal states."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import choice, count, listed
from ...core.arguments import function as check_function
from ...core.declared import real_numbers
from ...core.functions_of_time import at_time, taken
from ...core.leaves import leaf, option, with_values
from ...core.validation import Value, broadcast, refusal, shown
from ...core.warning import warn
from ...math.shapes import broadcast_shapes
from ..beam import Beam
from ..parts import Place, check_node
from .load_point import (
    INERTIAL,
    INTERNAL,
    MOTION,
    READS,
    LoadEffect,
    LoadPoint,
    Wrench,
    derivatives,
    jacobians,
)
from .sites import to_sites
from .values import Input, Inputs, value_at

PLACE = "s"  # may be asked for in `of`, and is no motion
UNSAID = (
    "a Load without node was given, which acts on the tip as node=-1 does; from the next minor "
    "version on it acts along the beam, per metre, as node=None does: the one that is meant is "
    "wanted"
)


def _inputs(name: str, value: Any) -> tuple[Input, ...]:
    named = isinstance(value, dict)
    inputs = tuple(Input(*item) for item in value.items()) if named else tuple(listed(value))
    if not all(isinstance(i, Input) for i in inputs):
        raise ValueError(
            f"{shown(value)} was given as {name}; Inputs, or names with sizes, are wanted"
        )
    return inputs


def _names(name: str, value: Any) -> tuple[str, ...]:
    names = listed(value)
    for motion in names:
        choice(name, motion, (*MOTION, PLACE))
    return names


def _values(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(
            f"{shown(value)} was given as {name}; numbers or tensors by name are wanted"
        )
    for key, number in value.items():
        if isinstance(number, Input) or callable(number):
            raise ValueError(
                f"{type(number).__name__} was given as Load's value {key!r}; numbers or a tensor "
                "are wanted"
            )
    return {key: real_numbers(f"Load's value {key!r}", number) for key, number in value.items()}


@dataclass(frozen=True)
class Load(LoadEffect):
    """A load by a function of the motion:
    `function(position, rotation, velocity, spin, t, **named)` -> (force, moment).

    Args:
        function: takes position (..., 3) m, rotation (..., 3, 3) section axes -> frame a, velocity
            (..., 3) m/s absolute, spin (..., 3) rad/s, all in frame a; t (0-dim) s. Returns force
            and moment (..., 3) in frame a, N and N m, per metre along the beam: tensors or
            sequences of numbers; None = absent. Write it in torch operations. The result at a site
            of a sample depends on the arguments there alone: the engine chooses which sites and
            samples share a call. Samples at different times have a call for each time.
        node: counts from the root, -1 is the tip; None = along the beam, force and moment per
            metre, with arguments (..., sites, ...). Give it, unless `on` or "s" already say that
            the load is along the beam. Without it the load acts on the tip, with a FutureWarning.
            From the next minor version on, it will act along the beam, as `Drag` and `Gravity` do
        inputs: `Input`s, or names with sizes {"u": 2}: the function takes them by name, with as
            many axes as the motion
        values: parameters by name, numbers or tensors, which the function takes by that name. At a
            node (...). Along the beam one for each element (..., N), for each node (..., N+1) or
            for all (..., 1). The function gets (..., sites), where a node has the mean of its
            elements by their lengths
        internal: number of internal states z (actuator lag, inflow), along the beam at each site.
            The function then takes `z` by name, (..., internal) or (..., sites, internal)
        rate: z' = rate(z, position, rotation, velocity, spin, t, **named), 1/s of z, z by its
            place; z starts at zero
        of: quantities that the function and the rate read, of "position", "rotation", "velocity",
            "spin". The others are given as None, and not differentiated. Empty: a load of t,
            inputs, values and z. Further quantities come by name: "acceleration" (..., 3) m/s^2 and
            "angular_acceleration" (..., 3) rad/s^2, absolute, frame a. Along the beam, also the arc
            length "s" (..., sites) m from the root, of nodes: `Along` integrates over elements
        on: along the beam: name of a beam of a structure; None = all

    Automatic differentiation gives the tangent. An implicit step takes z at mid step, linearly
    implicit,

        z_mid = z_n + (I - dt/2 dg/dz)^-1 dt/2 g(z_n, ...),    z_{n+1} = 2 z_mid - z_n

    For a linear law this is the midpoint rule; it is stable for any lag (Rosenbrock 1963). An
    equilibrium, and each of a `path`, has z at rest. The derivative of a load by accelerations is
    an added mass; an explicit method needs a load that is linear in them. `State.internal` has the
    states of one load after the other, (sites x internal) row by row.

    Raises:
        ValueError: for internal states without a rate, a rate without them, unknown names in `of`,
            "s" at a node, or two arguments of one name. When it acts, for a result that is not a
            force and a moment of the right shape.

    Examples:
        >>> jet = tb.Load(lambda x, R, v, w, t: (-0.5 * v, None), node=-1)  # N: at the tip
        >>> slowed = tb.Scene(beam, [jet, tb.TipLoad(force=(0, 0, 1.0))])
        >>> tb.simulate(slowed, [0.0, 0.1], step=0.01).status
        tensor(0)
    """

    function: Callable[..., tuple[Tensor | None, Tensor | None]] = leaf(None, check=check_function)
    node: Place | None = ...
    inputs: Iterable[Input] | dict[str, int] = option(_inputs, default=())
    internal: int = option(partial(count, least=0), default=0, name="internal")
    rate: Callable[..., Tensor] | None = leaf(None, default=None, check=check_function)
    of: Sequence[str] = option(_names, default=READS, name="of")
    values: dict[str, Value] | None = leaf(
        lambda load: int(load.node is None), default=None, check=_values
    )
    on: str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node is ...:
            along = self.on is not None or PLACE in self.of
            object.__setattr__(self, "node", None if along else -1)
            if not along:
                warn(UNSAID, FutureWarning)
        if self.node is not None:
            check_node("node", self.node)
        if bool(self.internal) != (self.rate is not None):
            wrong = "a rate without internal states"
            wrong = "internal states without a rate" if self.internal else wrong
            raise ValueError(f"{wrong} was given to Load; both or neither are wanted")
        if PLACE in self.of and self.node is not None:
            raise ValueError(
                "the arclength 's' was asked for by a Load at a node; one along the beam, "
                "node=None, has it"
            )
        if self.node is not None and self.on is not None:
            raise refusal(
                f"Load with on = {shown(self.on)} and the node {self.node!r}",
                "node=(name, number), or node=None for all along that beam,",
            )
        object.__setattr__(self, "values", self.values or {})
        self._check_functions()

    def _check_functions(self) -> None:
        """ValueError where functions do not take what is handed over, each by its own name."""
        names = [
            *(i.name for i in self.inputs),
            *self.values,
            *(["z"] if self.internal else []),
            *(n for n in self.of if n not in READS),
        ]
        for name in {n for n in names if names.count(n) > 1}:
            raise ValueError(
                f"two arguments of the name {name!r} were given to Load; one is wanted"
            )
        motion = ("position", "rotation", "velocity", "spin", "t")
        for name in _wants(self.function, len(motion)) - {*names}:
            raise ValueError(
                f"Load's function of {name!r} was given; one of {', '.join(motion)} is wanted, to "
                f"which of=(..., {name!r}) hands it over by name"
            )
        check_function("Load's function", self.function, *motion, named=names)
        if self.rate is not None:
            names = [name for name in names if name != "z"]
            check_function("Load's rate", self.rate, "z", *motion, named=names)

    @property
    def by_place(self) -> bool:
        return bool(self.values) or PLACE in self.of

    @property
    def depends(self) -> frozenset[str]:
        return frozenset(self.of) - {PLACE}

    def internal_states(self, beam: Beam) -> int:
        return self.internal if self.node is not None else self.internal * beam.rows_along(self)

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        z = None
        if self.internal:
            z = point.internal
            z = z if point.dt is None else self.advance(point, z, t, inputs, point.dt)
        motion, named, lead = self._arguments(point, t, inputs, z)

        def wrench(now: Tensor) -> Wrench:
            returned = self.function(*motion, now, **named)
            count = len(returned) if isinstance(returned, (tuple, list)) else None
            if count != 2 or all(w is None for w in returned):
                said = shown(returned) if count in (None, 2) else f"{count} values"
                raise ValueError(
                    f"a Load's function that returns {said} was given; (force, moment) is wanted, "
                    "one of them None where it is absent"
                )
            return tuple(
                None if w is None else _returned("a Load's function", w, 3, lead, point.R)
                for w in returned
            )

        return at_time(wrench, t, axes=1 if self.node is not None else 2)

    def at_sites(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Load | None:
        along = self.node is None and self.values
        return with_values(self, values=self._values_at(s, elements)) if along else None

    def _values_at(self, s: Tensor, elements: int) -> dict[str, Tensor]:
        """Parameters (..., sites)."""
        return {
            name: to_sites(f"Load's value {name!r}", v, s, elements)
            for name, v in self.values.items()
        }

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        if not self.depends:
            return {}
        with _differentiated("function"):
            return super().tangent(point, t, inputs)

    def rates(self, point: LoadPoint, z: Tensor, t: Tensor, inputs: Inputs) -> Tensor:
        """z' as z is, (..., internal) or (..., sites, internal)."""
        motion, named, lead = self._arguments(point, t, inputs, z)
        z = named.pop("z")

        def rate(now: Tensor) -> Tensor:
            g = _returned(
                "a Load's rate", self.rate(z, *motion, now, **named), self.internal, lead, z
            )
            return g.expand(broadcast_shapes(g.shape, z.shape))

        return at_time(rate, t, axes=1 if self.node is not None else 2)

    def rates_tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Derivative (..., internal, 3 or internal) of z' by names, as in `tangent`, and by z."""
        with _differentiated("rate"):
            names = (*sorted(self.depends), INTERNAL)
            return derivatives(lambda at: self.rates(at, at.internal, t, inputs), point, names)

    def advance(self, point: LoadPoint, z: Tensor, t: Tensor, inputs: Inputs, dt: Tensor) -> Tensor:
        """z at the middle of a step of dt (...) that starts with z; the motion as at its middle."""
        half = (dt / 2)[..., None] if self.node is not None else (dt / 2)[..., None, None]
        g = self.rates(point, z, t, inputs)
        with _differentiated("rate"):
            (slope,) = jacobians(lambda x: self.rates(point, x, t, inputs), z.expand(*g.shape))
        eye = torch.eye(self.internal, dtype=g.dtype, device=g.device)
        return z + torch.linalg.solve(eye - half[..., None] * slope, (half * g)[..., None])[..., 0]

    def _arguments(
        self, point: LoadPoint, t: Tensor, inputs: Inputs, z: Tensor | None
    ) -> tuple[tuple[Tensor | None, ...], dict[str, Tensor], torch.Size]:
        """Position, rotation, velocity, spin (None where they are not used); the others by name;
        their axes before their own. All have as many of these, and motions the same, so that they
        can be stacked; along the beam one of them is for the sites.
        """
        motion = dict(
            position=point.position, rotation=point.R, velocity=point.velocity, spin=point.spin
        )
        motion = tuple(v if name in self.of else None for name, v in motion.items())
        named = {i.name: value_at(i, t, inputs, point.R) for i in self.inputs}
        numbers = self.values
        if self.node is None:
            named = {name: v[..., None, :] for name, v in named.items()}
            numbers = self._values_at(point.s, point.elements)
            numbers |= {PLACE: point.s} if PLACE in self.of else {}
        for name in INERTIAL:
            if name in self.of:
                x = getattr(point, name)
                named[name] = torch.zeros_like(point.R[..., 0]) if x is None else x
        if z is not None:
            named["z"] = z
        axes_counts = (1, 2, 1, 1)
        shapes = [x.shape[:-1] for x in named.values()] + [x.shape for x in numbers.values()]
        lead = broadcast_shapes(point.R.shape[:-2], *shapes)
        present = [(x, k) for x, k in zip(motion, axes_counts, strict=True) if x is not None]
        axes = max([point.R.ndim - 2, *(x.ndim - k for x, k in present), *map(len, shapes)])
        named = {name: _with_axes(x, axes + 1) for name, x in named.items()}
        numbers = {name: _with_axes(x, axes) for name, x in numbers.items()}
        present = [(_with_axes(x, axes + k), k) for x, k in present]
        common = broadcast_shapes(*(x.shape[:-k] for x, k in present))
        wide = iter(
            [x if x.shape[:-k] == common else x.expand(*common, *x.shape[-k:]) for x, k in present]
        )
        motion = tuple(None if x is None else next(wide) for x in motion)
        return motion, named | numbers, lead


def _wants(function: Callable[..., Any], behind: int) -> set[str]:
    """What a function wants by names that may be asked for in `of`, behind so many arguments; of
    one that has fewer, at all.
    """
    try:
        parameters = [*inspect.signature(function).parameters.values()]
        parameters = parameters[behind if len(parameters) >= behind else 0 :]
    except ValueError:  # one of C's, that does not say
        return set()
    return {p.name for p in parameters if p.default is p.empty} & {PLACE, *INERTIAL}


def _with_axes(x: Tensor, count: int) -> Tensor:
    """x with so many axes, the new ones first."""
    return x if x.ndim == count else x[(None,) * (count - x.ndim)]


@contextmanager
def _differentiated(what: str) -> Iterator[None]:
    """Says of a function that gives numbers, but no derivatives, what is wanted of it."""
    try:
        yield
    except RuntimeError as error:
        first = next(iter(str(error).splitlines()), "")
        raise ValueError(
            f"a Load's {what} that torch cannot differentiate was given ({first}); torch's "
            "operations, which write to none of its arguments, are wanted: a table by "
            "torch.searchsorted, a slope by torch.func.grad"
        ) from error


def _returned(whose: str, value: Any, size: int, lead: torch.Size, like: Tensor) -> Tensor:
    """What a function returned, (..., size), if its axes fit the arguments'; else ValueError."""
    if not isinstance(value, (Tensor, tuple, list)):
        raise refusal(f"{whose} that returns {shown(value)}", f"tensors (..., {size})", are=True)
    value = taken(f"{whose}'s value", value, like, size)
    # the function may bring axes of its own
    broadcast(f"{whose}'s value and arguments", value.shape[:-1], lead)
    return value
