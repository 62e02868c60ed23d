"""Search for fields: the data, and rows by which each field is smooth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, instance, number
from ...core.validation import as_tensor, common_dtype, refusal, shown
from . import posterior
from .experiment import experiments_of
from .fit import Fit
from .identify import SearchOptions, searched
from .measurement import Measurement, each, sigma_given
from .noise import NOISES
from .parameter import Parameter
from .problem import FitProblem
from .regularization import Linearised
from .smoothness import Smoothness, SmoothnessRows

NOISE = 0.05  # first deviation of data without sigma, over their RMS
FIRST = 1e-4  # first weight, over that at which smoothness counts as much as the data


@dataclass(frozen=True)
class FieldSearch:
    """What is searched: models and measurements by experiment (None: one without a name), and for
    each field its rows, their target (rows,), and factors (rows,) by which they count.
    """

    models: dict[str | None, Any]
    measured: dict[str | None, Any]
    start: Mapping[str, Any]
    rows: dict[str, SmoothnessRows]
    target: dict[str, Tensor]
    factor: dict[str, Tensor]
    sharp: tuple[str, ...]
    known: bool
    options: SearchOptions

    @classmethod
    def of(
        cls,
        model: Any,
        data: Any,
        start: Mapping[str, Any],
        smoothness: Mapping[str, Smoothness],
        options: SearchOptions,
    ) -> FieldSearch:
        if not isinstance(start, Mapping) or not isinstance(smoothness, Mapping) or not smoothness:
            raise ValueError(
                "a start and smoothness by name are wanted: {'EI': tb.Parameter(...)}, {'EI': "
                "tb.Smoothness()}"
            )
        if not boolean("absolute_sigma", options.absolute_sigma):
            raise ValueError(
                "absolute_sigma=False was given to identify_fields, whose weights count on sigma; "
                "data without sigma are wanted, whose noise is found"
            )
        if choice("noise", options.noise, NOISES) != "common":
            raise ValueError(
                f"noise={options.noise!r} was given to identify_fields, which finds one "
                "deviation of all data; channels weighed by their sigma are wanted"
            )
        experiments = experiments_of(model, data, options.sigma)
        options, log = replace(options, sigma=None), options.log
        models = {e.name: e.model for e in experiments}
        measured = {
            e.name: e.measurements[0] if e.single else list(e.measurements) for e in experiments
        }
        every = [m for group in measured.values() for m in each(group)]
        if odd := [m for m in every if m.loss or m.noise != "white"]:
            kind = f"loss={odd[0].loss!r}" if odd[0].loss else f"noise={odd[0].noise!r}"
            raise ValueError(
                f"{kind} was given to identify_fields, whose weights count on normal noise that is "
                "independent; noise='white' is wanted, where neighbours are alike with sigma "
                "over sqrt((1 - rho)/(1 + rho)), rho their correlation"
            )
        known = sigma_given(every)
        if not known and not any(m.values.nan_to_num().any() for m in every):
            raise ValueError(
                "data that are all zero were given to identify_fields without sigma; their noise "
                "is not to be known, and sigma=... is wanted"
            )
        kind = common_dtype(*(m.values for m in every))
        rows, target = {}, {}
        for name, prior in smoothness.items():
            if name not in start:
                raise ValueError(
                    f"smoothness of {name!r} was given; there are {', '.join(map(str, start))}"
                )
            field = start[name]
            if not isinstance(field, Parameter):
                field = Parameter(as_tensor(field, *kind), transform="log" if log else None)
            if field.start.ndim != 1 or field.own or field.transform == "logit":
                raise ValueError(
                    f"smoothness of {name!r} was given, of shape {tuple(field.start.shape)}; one "
                    "field (n,) of all experiments is wanted, by itself or by its logarithm"
                )
            L = instance("smoothness", prior, Smoothness).rows(field.start)
            rows[name] = SmoothnessRows(name, L, field.transform == "log")
            target[name] = rows[name].of(field.start) if prior.order == 0 else L.new_zeros(len(L))
        factor = {name: torch.ones_like(of) for name, of in target.items()}
        sharp = tuple(name for name, prior in smoothness.items() if prior.sharp)
        return cls(models, measured, start, rows, target, factor, sharp, known, options)

    @property
    def noise(self) -> float:
        """First deviation of the data; 1 where theirs are given."""
        return 1.0 if self.known else NOISE * self.size

    @property
    def size(self) -> float:
        """RMS of the data."""
        values = torch.cat(
            [m.values.flatten() for group in self.measured.values() for m in each(group)]
        )
        return values[~values.isnan()].square().mean().sqrt().item()

    @property
    def _like(self) -> Tensor:
        return next(iter(self.target.values()))

    def checked(self, weight: Mapping[str, float]) -> Tensor:
        if not isinstance(weight, Mapping):
            raise refusal(f"weight = {shown(weight)}", "name -> number")
        if set(weight) != set(self.rows):
            raise ValueError(
                f"weights of {', '.join(map(str, weight))} were given; of {', '.join(self.rows)} "
                "are wanted"
            )
        weights = self._like.new_tensor(
            [number(f"the weight of {name!r}", weight[name]) for name in self.rows]
        )
        if not (weights > 0).all():
            raise refusal(f"a weight of {weights.min().item():g}", "positive ones", are=True)
        return weights

    def first(self) -> tuple[Tensor, float]:
        """Weights that leave the data all they can say, from the derivatives at the start."""
        tiny = self._like.new_full((len(self.rows),), torch.finfo(self._like.dtype).eps)
        once = replace(self.options, iterations=1)
        fit = searched(*self._with_rows(tiny, self.noise), self.start, once)
        problem, x = fit.problem, fit.problem.parameters.x[:1]
        with torch.no_grad():
            linear = self._linearised(problem, x, *problem.linearised(x, _first(x)), self.noise)
        return FIRST * linear.balance / self.noise**2, self.noise

    def searched(
        self, start: Mapping[str, Any], weight: Tensor, sigma: float
    ) -> tuple[Fit, Linearised]:
        fit = searched(*self._with_rows(weight, sigma), start, self.options)
        x = fit.x[None]
        with torch.no_grad():
            r = fit.problem.residuals(x, _first(x))
            return fit, self._linearised(fit.problem, x, r, fit.jacobian[None], sigma)

    def start_from(self, fit: Fit) -> dict[str, Any]:
        """Fields by their logarithms from where they were found; others may have begun at zero."""
        return {
            name: replace(one, start=fit[name])
            if isinstance(one, Parameter) and one.transform == "log" and not one.own
            else one
            for name, one in self.start.items()
        }

    def sharpened(self, fit: Fit, weight: Tensor) -> FieldSearch:
        """With rows that count by how large they are."""
        factor = dict(self.factor)
        for (name, rows), w in zip(self.rows.items(), weight.tolist(), strict=True):
            if name in self.sharp:
                factor[name] = Smoothness.factors(
                    w * (rows.of(fit[name]) - self.target[name]).square()
                )
        return replace(self, factor=factor)

    def samples(self, linear: Linearised, weight: Tensor, sigma: float, free: bool) -> Tensor:
        """Samples of the posterior, see `posterior`, of a problem linearised with these factors."""
        root = [factor.sqrt() for factor in self.factor.values()]
        plain = replace(
            linear,
            L=tuple(L / s[:, None] for L, s in zip(linear.L, root, strict=True)),
            target=tuple(c / s for c, s in zip(linear.target, root, strict=True)),
        )
        return posterior.samples(
            plain, weight, sigma, [name in self.sharp for name in self.rows], free, self.known
        )

    def _with_rows(self, weight: Tensor, sigma: float) -> tuple[dict[str, Any], dict[str, Any]]:
        """Models and data of experiments, one more for each field."""

        def noisy(m: Measurement) -> Measurement:
            return m if self.known else replace(m, sigma=sigma)

        data = {
            name: [noisy(m) for m in group] if isinstance(group, list) else noisy(group)
            for name, group in self.measured.items()
        }
        models = dict(self.models)
        for (name, rows), w in zip(self.rows.items(), weight.tolist(), strict=True):
            models[f"smoothness of {name}"] = rows
            data[f"smoothness of {name}"] = Measurement(
                self.target[name], (w * self.factor[name]) ** -0.5
            )
        return models, data

    def _linearised(
        self, problem: FitProblem, x: Tensor, r: Tensor, J: Tensor, sigma: float
    ) -> Linearised:
        """About x (1, p), of r (1, T) and J (1, T, p) there; misfits over the data's deviations."""
        _, pull, bend = (part[0] for part in problem.prior(x))
        data = problem.measured
        scale = 1.0 if self.known else sigma
        wide, target = [], []
        for name, rows in self.rows.items():
            (place,) = (e.place for e in problem.parameters.entries if e.name == name)
            wide.append(x.new_zeros(len(rows.L), x.shape[1]))
            root = self.factor[name].sqrt()
            wide[-1][:, place] = root[:, None] * rows.L
            target.append(root * self.target[name])
        r, J = scale * r[0, data], scale * J[0, data]
        return Linearised(x[0], r, J, tuple(wide), tuple(target), scale**2 * pull, scale**2 * bend)


def _first(x: Tensor) -> Tensor:
    return torch.zeros(1, dtype=torch.long, device=x.device)
