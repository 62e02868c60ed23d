"""All parameters of an identification as one vector: names, places, coordinates, priors, starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor
from torch.distributions import Distribution

from ...core.arguments import count, number
from ...core.memory import check_memory
from ...core.validation import Value, as_tensor, common_dtype, finite, positive, refusal
from .parameter import Parameter
from .transform import Transform

ROUNDING = 64  # of a coordinate and back, in units of the last place


@dataclass(frozen=True)
class Entry:
    """One parameter's place in the vector, its shape, and whose own it is (`experiment`)."""

    name: str
    first: int
    shape: tuple[int, ...]
    experiment: str | None = None
    prior: Distribution | None = None

    @property
    def size(self) -> int:
        return max(1, int(torch.Size(self.shape).numel()))

    @property
    def place(self) -> slice:
        return slice(self.first, self.first + self.size)

    def support(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Ends (size,) of the prior's support, infinite where it has none; a little inside of those
        that are not zero, as some densities are zero at an end.
        """
        ends = dict(lower_bound=-torch.inf, upper_bound=torch.inf)
        ends = [getattr(self.prior.support, name, end) for name, end in ends.items()]
        ends = [torch.as_tensor(end, dtype=like.dtype).to(like) for end in ends]
        low, high = (end.expand(self.shape).reshape(self.size) for end in ends)
        inside = ROUNDING * torch.finfo(like.dtype).eps
        return tuple(
            torch.where(torch.isfinite(end), end + side * inside * end.abs(), end)
            for end, side in ((low, 1), (high, -1))
        )


@dataclass(frozen=True)
class Parameters:
    """Layout of the vector theta (p,): those of the model, then those of the measurements
    (offsets, drifts).

    names    (p,) of the numbers;  entries  of named parameters; none where the model takes the
             vector itself
    start    (S, p) theta;  size (p,) of changes that matter, 0 = not known;  least, largest (p,)
             bounds that were given
    model    how many of the numbers the model takes
    """

    names: tuple[str, ...]
    entries: tuple[Entry, ...]
    transform: Transform
    start: Tensor
    size: Tensor
    least: Tensor
    largest: Tensor
    model: int
    by_name: bool = field(default=False)

    @classmethod
    def of(
        cls,
        start: Any,
        log: bool,
        bounds: tuple[Value, Value] | None,
        names: Sequence[str] | None,
        experiments: Sequence[str],
        like: Any,
    ) -> Parameters:
        """From what `identify` was given; `like`: data, on whose device."""
        if isinstance(start, Mapping):
            if bounds is not None or names is not None:
                raise ValueError(
                    "bounds or names were given beside parameters by name; tb.Parameter(start, "
                    "bounds=...) is wanted"
                )
            return _named(start, log, experiments, common_dtype(*_numbers(start), like))
        dtype, device = common_dtype(start, like)
        start = finite("start", as_tensor(start, dtype, device)).detach()
        start = start[None] if start.ndim == 1 else start
        if start.ndim != 2 or not start.numel():
            raise refusal(f"a start of shape {tuple(start.shape)}", "(p,) or (starts, p)")
        p = start.shape[1]
        names = tuple(names) if names is not None else tuple(f"theta[{i}]" for i in range(p))
        if len(names) != p:
            raise ValueError(f"{len(names)} names were given for {p} parameters")
        if len(set(names)) != p:
            raise refusal(f"names {', '.join(map(str, names))}", "each once", were=True)
        low, high = (start.new_full((p,), end) for end in (-torch.inf, torch.inf))
        least, largest = (low, high) if bounds is None else _pair(bounds, start[0])
        if not ((least <= start) & (start <= largest)).all():
            raise ValueError(
                f"bounds {least.tolist()} and {largest.tolist()} were given for a start outside of "
                "them; one between is wanted"
            )
        if log:
            positive("start", start)
            positive("bounds", least.clamp(min=0) if bounds is None else least, zero=True)
        every = torch.full((p,), bool(log), device=device)
        transform = Transform(every, torch.zeros_like(every), low, high)
        return cls(names, (), transform, start, start[0].abs(), least, largest, p)

    @property
    def priors(self) -> tuple[Entry, ...]:
        return tuple(e for e in self.entries if e.prior is not None)

    @property
    def x(self) -> Tensor:
        """(S, p) coordinates of the starts."""
        return self.transform.x(self.start)

    @property
    def limits(self) -> tuple[Tensor, Tensor]:
        """(p,) least and largest theta: bounds, within what priors give a density to."""
        least, largest = self.least.clone(), self.largest.clone()
        for entry in self.priors:
            low, high = entry.support(least)
            least[entry.place], largest[entry.place] = (
                torch.maximum(low, least[entry.place]),
                torch.minimum(high, largest[entry.place]),
            )
        return least, largest

    def bounds(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Limits (like x) of coordinates."""
        return tuple(end.expand_as(x) for end in self._ends(*self.limits))

    @property
    def bounded(self) -> bool:
        """Whether bounds were given that coordinates can reach."""
        return any(bool(torch.isfinite(end).any()) for end in self._ends(self.least, self.largest))

    def _ends(self, least: Tensor, largest: Tensor) -> tuple[Tensor, Tensor]:
        """Coordinates (p,) of theta (p,) that are limits; of logits there are none."""
        T = self.transform
        logs = (torch.where(T.log, end.clamp(min=0), 1).log() for end in (least, largest))
        low, high = (
            torch.where(T.log, new, end) for new, end in zip(logs, (least, largest), strict=True)
        )
        return torch.where(T.logit, -torch.inf, low), torch.where(T.logit, torch.inf, high)

    def given(self, theta: Tensor, experiment: str | None = None) -> Any:
        """What a model takes: (N, p), or name -> (N, *shape) of an experiment's parameters."""
        if not self.by_name:
            return theta[:, : self.model]
        return {
            e.name: theta[:, e.place].reshape(len(theta), *e.shape)
            for e in self.entries
            if e.experiment in (None, experiment)
        }

    def number(self, name: str, experiment: str | None) -> int:
        """Place of a parameter that is one number, an experiment's own or common to all; ValueError
        for another shape.
        """
        entry = next(
            e for e in self.entries if (e.name, e.experiment) in ((name, None), (name, experiment))
        )
        if entry.size != 1:
            raise refusal(f"the parameter {name!r} of shape {entry.shape}", "one number")
        return entry.first

    def more_starts(self, starts: int, spread: float, seed: int) -> Parameters:
        """With so many starts, the first as given, the others at random (scrambled Sobol): between
        its limits where a parameter has two, evenly or, of a logarithm, by that; else evenly by the
        logarithm within a factor of `spread`, or the size from zero, and the one limit that there
        is.
        """
        if count("starts", starts) == 1:
            return self
        check_memory(f"{starts} starts", 8 * starts * self.model, "fewer are wanted")
        if len(self.start) > 1:
            raise ValueError(
                f"starts = {starts} was given beside {len(self.start)} starts; one of them is "
                "wanted"
            )
        if not number("spread", spread) > 1:
            raise refusal(f"spread = {spread:g}", "a factor above 1")
        first, (least, largest) = self.start[0], self.limits
        engine = torch.quasirandom.SobolEngine(self.model, scramble=True, seed=seed)
        u = engine.draw(starts - 1, dtype=torch.float64).to(first)
        near, far = first.abs() / spread, first.abs() * spread
        low = torch.where(first > 0, near, torch.where(first < 0, -far, -self.size))
        high = torch.where(first > 0, far, torch.where(first < 0, -near, self.size))
        between = (
            torch.isfinite(least) & torch.isfinite(largest) & ~(self.transform.log & (least <= 0))
        )
        low = torch.where(between, least, torch.maximum(low, least))
        high = torch.where(between, largest, torch.minimum(high, largest))
        if len(still := (~between & (low == high)).nonzero()):
            raise ValueError(
                f"starts = {starts} were asked for with {self.names[int(still[0])]} from 0 on, of "
                "which no size is known; tb.Parameter(0.0, scale=...), or bounds, are wanted"
            )
        by_log = self.transform.log | (~between & (first != 0))
        a, b = (torch.where(by_log, end.abs(), 1).log() for end in (low, high))
        theta = torch.where(
            by_log, first.sign() * torch.lerp(a, b, u).exp(), torch.lerp(low, high, u)
        )
        theta = torch.maximum(torch.minimum(theta, high), low)  # to the last digit
        return replace(self, start=torch.cat((self.start, theta)))

    def with_nuisance(self, names: Sequence[str]) -> Parameters:
        """With so many linear parameters of measurements behind the others, from zero on."""
        q = len(names)
        if not q:
            return self
        none, T = torch.zeros(q, dtype=torch.bool, device=self.start.device), self.transform

        def longer(x: Tensor, value: float) -> Tensor:
            return torch.nn.functional.pad(x, (0, q), value=value)

        masks = (torch.cat((mask, none)) for mask in (T.log, T.logit))
        transform = Transform(*masks, longer(T.low, 0.0), longer(T.high, 0.0))
        return replace(
            self,
            names=(*self.names, *names),
            transform=transform,
            start=longer(self.start, 0.0),
            size=longer(self.size, 0.0),
            least=longer(self.least, -torch.inf),
            largest=longer(self.largest, torch.inf),
        )


def _pair(bounds: Any, like: Tensor) -> tuple[Tensor, Tensor]:
    """Bounds (p,) of what is like (p,)."""
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        raise refusal(f"bounds = {bounds!r}", "(least, largest)", were=True)
    least, largest = (as_tensor(b, like.dtype, like.device) for b in bounds)
    if (
        any(b.ndim > 1 or b.numel() not in (1, len(like)) for b in (least, largest))
        or not (least <= largest).all()
    ):
        raise ValueError(
            f"bounds {least.tolist()} and {largest.tolist()} were given for {len(like)} "
            "parameters; the least and the largest of each are wanted"
        )
    return least.expand(len(like)), largest.expand(len(like))


def _numbers(start: Mapping[str, Any]) -> list[Any]:
    return [p.start if isinstance(p, Parameter) else p for p in start.values()]


def _named(
    start: Mapping[str, Any], log: bool, experiments: Sequence[str], kind: tuple
) -> Parameters:
    """Vector of named parameters, shared ones and one of each experiment's own."""
    if not start:
        raise refusal("no parameters", "one at least", were=True)
    entries, found, names, first = [], [], [], 0
    for name, one in start.items():
        if not isinstance(name, str):
            raise refusal(f"a parameter named {name!r}", "text")
        if not isinstance(one, Parameter):
            one = Parameter(as_tensor(one, *kind), transform="log" if log else None)
        if one.own and len(experiments) < 2:
            raise ValueError(
                f"the parameter {name!r}, own to each experiment, was given with one; several "
                "are wanted"
            )
        for experiment in experiments if one.own else (None,):
            entry = Entry(name, first, tuple(one.start.shape), experiment, one.prior)
            full = name if experiment is None else f"{experiment}.{name}"
            names += [full] if not entry.shape else [f"{full}[{i}]" for i in range(entry.size)]
            entries.append(entry)
            found.append(one)
            first += entry.size

    def joined(read: Any, like: Any = lambda p: p.start) -> Tensor:
        numbers = [torch.as_tensor(read(p), dtype=kind[0], device=kind[1]) for p in found]
        return torch.cat(
            [x.expand_as(like(p)).flatten() for x, p in zip(numbers, found, strict=True)]
        )

    unbounded = torch.tensor(-torch.inf), torch.tensor(torch.inf)
    low, high = (joined(lambda p, i=i: (p.bounds or unbounded)[i]) for i in (0, 1))
    logs, logits = (
        joined(lambda p, name=name: float(p.transform == name)).bool() for name in ("log", "logit")
    )
    zero = torch.zeros_like(low)
    transform = Transform(
        logs, logits, torch.where(logits, low, zero), torch.where(logits, high, zero)
    )
    start, size = joined(lambda p: p.start)[None], joined(lambda p: p.size)
    return Parameters(tuple(names), tuple(entries), transform, start, size, low, high, first, True)
