"""Problem: weighted misfits of experiments as a function of parameters, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...solvers.jacobian import difference, forward
from ...solvers.region import Region
from .blocks import Blocks
from .experiment import Experiment
from .losses import LOSSES
from .measurement import Measurement, sigma_given
from .memory import Memory
from .noise import Noise
from .nuisance import Nuisance, wave_names
from .parameters import Entry, Parameters
from .whitening import Whitening


@dataclass(frozen=True)
class FitProblem:
    """Least squares of all experiments: r(x) = (y + nuisance - data) / sigma, and minus the
    logarithm of priors.

    known       (all numbers,) bool: which were measured;  white  by which those are weighed
    target      (1 or S, T): weighted data, one set for all starts or each its own
    noise       whose size is found;  sigma_given: weights are those of the noise, or are changed
                until they are;  memory  of noise that is not independent
    nuisance    linear parameters of measurements, and how they enter all numbers
    method      "forward" or "difference", of relative_step, one or (p,)
    """

    experiments: tuple[Experiment, ...]
    parameters: Parameters
    known: Tensor
    white: Whitening
    target: Tensor
    nuisance: Nuisance
    noise: Noise
    sigma_given: bool
    memory: Memory | None = None
    method: str = "difference"
    relative_step: float | Tensor = 1e-4

    @classmethod
    def of(
        cls,
        experiments: Sequence[Experiment],
        parameters: Parameters,
        absolute_sigma: bool = True,
        noise: Noise | None = None,
    ) -> FitProblem:
        """From experiments and the parameters of their models; those of their measurements are
        added. Without `noise`, it is known by sigma, or one for all data.
        """
        every = [(e, m) for e in experiments for m in e.measurements]
        for _, m in every:
            m.check_measured()
        scaled = sigma_given(m for _, m in every) and absolute_sigma
        values = torch.cat([m.values.flatten() for _, m in every])
        known = ~values.isnan()
        weight = torch.cat(
            [
                (torch.ones_like(m.values) if m.sigma is None else 1 / m.sigma).flatten()
                for _, m in every
            ]
        )
        Blocks.check(experiments)
        nuisance = Nuisance.of([(e.name, m) for e, m in every], parameters.model)
        parameters = parameters.with_nuisance(nuisance.names)
        fitted, p = sum(m.fitted for _, m in every), len(parameters.names)
        numbers = int(known.sum()) - fitted
        if numbers + sum(e.size for e in parameters.priors) < p:
            less = f", {fitted} of them fitted by the model," if fitted else ""
            raise ValueError(
                f"{numbers + fitted} data{less} were given for {p} parameters; at least as many "
                "are wanted, or priors"
            )
        if noise is None:
            noise = Noise.known(values) if scaled else Noise.common(values, fitted)
        if parameters.priors and not scaled:
            raise ValueError(
                "priors were given with data without an absolute sigma, against which they are "
                "weighed; one is wanted"
            )
        known_names = {e.name for e in parameters.entries}
        for _, m in every:
            if wrong := [n for n in m.parameters if n not in known_names]:
                raise ValueError(
                    f"a Measurement with the parameter {wrong[0]!r} was given; there are "
                    f"{', '.join(sorted(known_names)) or 'none by name'}"
                )
        white = Whitening.of(weight[known])
        nuisance = nuisance.with_frequencies(
            parameters.number(name, e.name) for e, m in every for name in wave_names(m)
        )
        # fmt: off
        problem = cls(tuple(experiments), parameters, known, white, white(values[known])[None],
                      nuisance, noise, scaled)
        # fmt: on
        return replace(problem, memory=Memory.of(problem))

    @property
    def measurements(self) -> list[tuple[Experiment, Measurement]]:
        """All, each with its experiment, in the order of the numbers."""
        return [(e, m) for e in self.experiments for m in e.measurements]

    def rows(self) -> Iterator[tuple[Experiment, Measurement, Tensor]]:
        """Each measurement, with the rows of its readings among the data, -1 of what is missing."""
        row = torch.full(self.known.shape, -1, device=self.known.device)
        row[self.known] = torch.arange(int(self.known.sum()), device=row.device)
        for (e, m), own in zip(self.measurements, self.by_measurement(row), strict=True):
            yield e, m, own

    @property
    def independent(self) -> Tensor:
        """(T,) bool: data of which weighted noise is normal and independent from reading to
        reading: it does not count by blocks, nor has it another loss than the square.
        """
        return self._of_data(lambda e, m: m.noise in ("white", "ar1") and m.loss is None)

    @property
    def loss(self) -> Tensor:
        """(T,) number of each one's loss, see `losses`."""
        return self._of_data(lambda e, m: LOSSES.index(m.loss))

    def _of_data(self, read: Callable[[Experiment, Measurement], int]) -> Tensor:
        """(T,) of each measurement's."""
        every = [torch.full(m.values.shape, read(e, m)).flatten() for e, m in self.measurements]
        return torch.cat(every).to(self.known.device)[self.known]

    @property
    def in_rounds(self) -> bool:
        """Whether noise is found by searches in turn."""
        channels = self.sigma_given and bool(self.noise.names)
        return channels or self.memory is not None or bool(self.loss.any())

    def by_measurement(self, values: Tensor) -> list[Tensor]:
        """Values (all numbers,) of each measurement, of its shape."""
        shapes = [m.values.shape for _, m in self.measurements]
        return [
            part.reshape(shape)
            for part, shape in zip(values.split([s.numel() for s in shapes]), shapes, strict=True)
        ]

    @property
    def spare(self) -> int:
        """Data less parameters and the numbers that models have fitted to the data themselves."""
        fitted = sum(m.fitted for _, m in self.measurements)
        return int(self.known.sum()) - fitted - len(self.parameters.names)

    @property
    def deviations(self) -> Tensor:
        """(channels,) by which the data of a channel whose noise is to be found are weighed."""
        weight = self.white.weight
        ones = self.noise.sums(torch.ones_like(weight), self.known)
        return self.noise.sums(1 / weight, self.known) / ones

    @property
    def measured(self) -> Tensor:
        """(T,) bool: data, and not rows of a prior."""
        return self._of_data(lambda e, m: e.measured)

    def values(self, theta: Tensor) -> Tensor:
        """Readings (N, all numbers), measured or not, without offsets and drifts."""
        parts = [e.values(self.parameters, theta) for e in self.experiments]
        return torch.cat(parts, -1) if len(parts) > 1 else parts[0]

    def weighted(self, x: Tensor) -> Tensor:
        """Weighted readings (N, T) of coordinates (N, model) of the model's parameters."""
        return self.white(self.values(self.theta(x))[:, self.known])

    def theta(self, x: Tensor) -> Tensor:
        """Parameters (N, p) of coordinates (N, model); 0 for offsets, which no model knows."""
        return self.parameters.transform.theta(
            torch.nn.functional.pad(x, (0, len(self.parameters.names) - x.shape[1]))
        )

    def residuals(self, x: Tensor, which: Tensor) -> Tensor:
        """r (N, T) of coordinates (N, p) of the starts `which` (N,)."""
        return self.weighted(x[:, : self.parameters.model]) + self._besides(x, which)

    def linearised(
        self, x: Tensor, which: Tensor, r: Tensor | None = None, rough: bool = False
    ) -> tuple[Tensor, Tensor]:
        """r (N, T), unless it is known, and J (N, T, p); a rough J is of one-sided differences."""
        besides = self._besides(x, which)
        y, J = self.derivatives(self.weighted, x, None if r is None else r - besides, rough)
        if self.nuisance.names:
            by = self.white(self.nuisance.derivatives(self.theta(x))[..., self.known])
            slope = self.parameters.transform.slope(x)[..., None]
            J = torch.nn.functional.pad(J, (0, x.shape[1] - J.shape[-1])) + (slope * by).mT
        return y + besides, J

    def derivatives(
        self, f: Callable[[Tensor], Tensor], x: Tensor, y: Tensor | None, rough: bool = False
    ) -> tuple[Tensor, Tensor]:
        """f (N, n) of the model's coordinates, and its derivatives (N, n, model) by them."""
        m = self.parameters.model
        if self.method == "forward":
            return forward(f, x[:, :m])
        bounds = (end[..., :m] for end in self.parameters.bounds(x))
        return difference(f, x[:, :m], self.steps(x)[:, :m], *bounds, y, central=not rough)

    def region(self, x: Tensor) -> Region:
        """Where a search may move from coordinates (S, p)."""
        parameters = self.parameters
        return Region(
            x, parameters.size, parameters.transform.additive, *parameters.bounds(x), self.target
        )

    def steps(self, x: Tensor) -> Tensor:
        """Changes (N, p) by which derivatives are found."""
        one = torch.ones_like(x)
        size, far = self.parameters.size, x.abs()
        size = torch.where(
            size > 0, torch.maximum(far, 1e-3 * size), torch.where(far > 1e-3, far, one)
        )
        return self.relative_step * torch.where(self.parameters.transform.additive, one, size)

    def _besides(self, x: Tensor, which: Tensor) -> Tensor:
        """What r has beside the model's readings: nuisance less data."""
        target = self.target[which] if len(self.target) > 1 else self.target
        if not self.nuisance.names:
            return -target
        return self.white(self.nuisance.values(self.theta(x))[:, self.known]) - target

    def prior(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Minus the logarithm of the priors' density of coordinates (N,), its gradient and
        curvature (N, p), which is not negative.
        """
        value, gradient, curvature = x.new_zeros(len(x)), torch.zeros_like(x), torch.zeros_like(x)
        if not self.parameters.priors:
            return value, gradient, curvature
        for entry in self.parameters.priors:
            here = entry.place
            phi, first, second = _surprise(self.parameters, entry, x)
            value = value + phi
            gradient[:, here], curvature[:, here] = first, second.clamp(min=0)
        return value, gradient, curvature

    def objective_prior(self, x: Tensor) -> Tensor:
        """Minus the logarithm of the priors' density of coordinates (N,), differentiable."""
        total = x.new_zeros(len(x))
        for entry in self.parameters.priors:
            total = total - _log_density(self.parameters, entry, x).sum(-1)
        return total

    def with_data(self, values: Sequence[Tensor]) -> FitProblem:
        """The same for other values of each measurement, missing where those of this one are."""
        target = self.white(torch.cat([v.flatten() for v in values])[self.known])
        return replace(self, experiments=self._with_measured("values", values), target=target[None])

    def reweighted(self, factor: Tensor) -> FitProblem:
        """The same with deviations that are so many times (channels,) as large."""
        every = self.noise.each(factor)
        sigma = [
            m.sigma * row
            for (_, m), row in zip(self.measurements, self.by_measurement(every), strict=True)
        ]
        changed = replace(self, experiments=self._with_measured("sigma", sigma))
        white = self.white
        return changed.whitened(replace(white, weight=white.weight / every[self.known]))

    def whitened(self, white: Whitening, memory: Memory | None = None) -> FitProblem:
        """The same with other weights."""
        return replace(
            self,
            white=white,
            target=white(self.white.inverse(self.target)),
            memory=memory or self.memory,
        )

    def _with_measured(self, name: str, each: Iterable[Tensor]) -> tuple[Experiment, ...]:
        """Experiments whose measurements have other values, or sigma, by `name`."""
        rest = iter(each)
        return tuple(
            replace(e, measurements=tuple(replace(m, **{name: next(rest)}) for m in e.measurements))
            for e in self.experiments
        )


def _log_prob(entry: Any, theta: Tensor) -> Tensor:
    """(N, size); minus infinity for samples of which a number is outside of the support."""
    shaped = theta.reshape(len(theta), *entry.shape)
    inside = entry.prior.support.check(shaped.detach()).reshape(theta.shape).all(-1)
    if inside.all():
        return entry.prior.log_prob(shaped).reshape(theta.shape)
    return torch.full_like(theta, -torch.inf).index_put(
        (inside,), entry.prior.log_prob(shaped[inside]).reshape(-1, theta.shape[1])
    )


def _log_density(parameters: Parameters, entry: Entry, x: Tensor) -> Tensor:
    """(N, size) logarithm of a prior's density of coordinates x (N, p): of theta, times how theta
    moves by them, so that the mode is that of the law by which intervals are laid about it.
    """
    here, transform = entry.place, parameters.transform
    return _log_prob(entry, transform.theta(x)[:, here]) + transform.log_slope(x)[:, here]


def _surprise(parameters: Parameters, entry: Entry, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """-log p (N,) of coordinates x (N, p), its first and second derivatives (N, size): each number
    of a prior is by itself.
    """
    here = entry.place
    with torch.enable_grad():
        x = x.detach().requires_grad_()
        density = -_log_density(parameters, entry, x)
        first, second = torch.zeros_like(x), torch.zeros_like(x)
        if density.requires_grad:
            (first,) = torch.autograd.grad(density.sum(), x, create_graph=True)
            if first.requires_grad:
                gradient = torch.autograd.grad(first.sum(), x, allow_unused=True)[0]
                second = second if gradient is None else gradient
    return density.sum(-1).detach(), first.detach()[:, here], second.detach()[:, here]
