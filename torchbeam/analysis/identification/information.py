"""Information that candidates would give, by batches of derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.validation import finite, refusal, shown
from .experiment import Experiment, Model
from .identify import with_derivatives
from .measurement import Measurement
from .parameters import Parameters
from .problem import FitProblem

DERIVATIVES = ("auto", "forward", "difference")
SAMPLES = 4096  # of a batch, at most
SHARED = 1e-6  # of a derivative that offsets leave, below which it is theirs
UNKNOWN = ("repeats", "blocks")  # noises whose size only data tell


@dataclass(frozen=True)
class Information:
    """Candidates at parameters of some draws.

    problem     of all readings of one run;  x (draws, p) coordinates of the parameters
    belongs     (measurements,) number of the candidate that each belongs to
    model, inputs  model(theta) and None, or model(theta, u) and (K, ...)
    """

    problem: FitProblem
    x: Tensor
    belongs: Tensor
    model: Any
    inputs: Tensor | None

    @classmethod
    def of(
        cls,
        model: Model,
        candidates: Sequence[Sequence[Measurement]],
        parameters: Parameters,
        inputs: Tensor | None,
        correlation: Any,
        derivatives: str,
        relative_step: float | None,
    ) -> Information:
        check_function("a model", model, *["theta", "u"][: 1 + (inputs is not None)])
        every = [m for group in candidates for m in group]
        belongs = torch.tensor([k for k, group in enumerate(candidates) for _ in group])
        zeros = tuple(replace(m, values=torch.zeros_like(m.values)) for m in every)
        problem = FitProblem.of([Experiment(None, model, zeros, False)], parameters)
        x = problem.parameters.x
        made = cls(_remembering(problem, correlation), x, belongs, model, inputs)
        first = made._with_inputs(inputs if inputs is None else inputs[:1])
        return replace(made, problem=with_derivatives(first, x[:1], derivatives, relative_step))

    def _with_inputs(self, u: Tensor | None) -> FitProblem:
        """The problem of the inputs (S, ...) of starts."""
        if u is None:
            return self.problem

        def run(theta: Any) -> Any:
            N = len(next(iter(theta.values())) if isinstance(theta, Mapping) else theta)
            return self.model(theta, u.repeat_interleave(N // len(u), 0))

        experiment = replace(self.problem.experiments[0], model=run)
        return replace(self.problem, experiments=(experiment,))

    def each(self) -> Tensor:
        """(candidates, K, draws, p, p), p coordinates of the model, what is not known of each run's
        own offsets taken from it. Raises ValueError for a model that fails.
        """
        m, draws = self.problem.parameters.model, len(self.x)
        K = 1 if self.inputs is None else len(self.inputs)
        x, which = self.x.repeat(K, 1), torch.arange(K).repeat_interleave(draws)
        rows = max(1, SAMPLES // (2 * m + 1))
        parts = []
        for here, k in zip(x.split(rows), which.split(rows), strict=True):
            problem = self._with_inputs(None if self.inputs is None else self.inputs[k])
            none = torch.zeros(len(here), dtype=torch.long, device=x.device)
            r, J = problem.linearised(here, none)
            if not (torch.isfinite(r).all() and torch.isfinite(J).all()):
                raise ValueError(
                    "a model that fails at the start, or is not finite there, was given to design; "
                    "one that answers is wanted"
                )
            parts.append(self._by_candidate(J, m))
        return torch.cat(parts, 1).unflatten(1, (K, draws))

    def _by_candidate(self, J: Tensor, m: int) -> Tensor:
        """(candidates, S, p, p) of derivatives (S, T, p and nuisance)."""
        sizes = [one.values.numel() for _, one in self.problem.measurements]
        sums = J.new_zeros(int(self.belongs.max()) + 1, len(J), m, m)
        for k, own in zip(self.belongs.tolist(), J.split(sizes, 1), strict=True):
            by, beside = own[..., :m], own[..., m:]
            beside = beside[..., (beside != 0).any(0).any(0)]
            if beside.shape[-1]:
                beside = beside / torch.linalg.vector_norm(beside, dim=-2, keepdim=True)
                left = by - beside @ (torch.linalg.pinv(beside) @ by)
                before, after = (torch.linalg.vector_norm(v, dim=-2, keepdim=True)
                                 for v in (by, left))  # fmt: skip
                by = torch.where(after > SHARED * before, left, 0)
            sums[k] += by.mT @ by
        return sums

    def before(self) -> Tensor:
        """(draws, p, p) of the priors."""
        m = self.problem.parameters.model
        return torch.diag_embed(self.problem.prior(self.x)[2][:, :m])

    def of_parameters(self, names: Any, criterion: str) -> tuple[list[str], Tensor]:
        """Labels (q,) and derivatives (draws, q, p) of parameters by name: of coordinates over the
        sizes that matter, or of theta for "c".
        """
        p = self.problem.parameters
        m, entries = p.model, {}
        for e in p.entries:
            entries[e.name] = [*range(e.first, e.first + e.size)]
        entries |= {name: [k] for k, name in enumerate(p.names[:m])}
        if wrong := [n for n in names or () if not isinstance(n, str) or n not in entries]:
            raise ValueError(f"of = {shown(wrong[0])} was given; there are {', '.join(entries)}")
        places = [k for n in names for k in entries[n]] if names else [*range(m)]
        size = torch.where(p.transform.additive | (p.size == 0), 1, p.size)[:m]
        scale = p.transform.slope(self.x)[:, :m] if criterion == "c" else 1 / size.expand(
            len(self.x), -1)  # fmt: skip
        return [p.names[k] for k in places], torch.diag_embed(scale)[:, places]

    def of_function(self, f: Any) -> tuple[list[str], Tensor]:
        """The same of what a function of theta gives (N, ...)."""
        p = self.problem.parameters
        f = check_function("of", f, "theta")

        def flat(x: Tensor) -> Tensor:
            values = f(p.given(self.problem.theta(x)))
            if not isinstance(values, Tensor) or values.shape[:1] != x.shape[:1]:
                raise refusal(f"a function `of` that gave {shown(values)}", "a tensor (N, ...)")
            return values.reshape(len(x), -1)

        _, G = self.problem.derivatives(flat, self.x, None)
        finite("derivatives of what is asked", G)
        return [f"number {k} of what is asked" for k in range(G.shape[1])], G


def _remembering(problem: FitProblem, correlation: Any) -> FitProblem:
    """With correlations of noise from one reading to the next, by name or one for all."""
    memory = problem.memory
    if memory is None:
        return problem
    for k, name in enumerate(memory.names):
        rho = correlation.get(name) if isinstance(correlation, Mapping) else correlation
        if rho is None or not 0 <= float(rho) < 1:
            raise ValueError(
                f"the correlation {shown(rho)} of {name!r} was given, whose noise is 'ar1'; one "
                "from 0 to 1, from one reading to the next, is wanted"
            )
        memory = memory.with_(k, float(rho))
    return problem.whitened(memory.in_(problem.white), memory)


def drawn(parameters: Parameters, draws: int, seed: int) -> Parameters:
    """With so many starts from the priors; parameters without one stay where they are."""
    if draws == 1:
        return parameters
    if not parameters.priors:
        raise ValueError(
            f"draws = {draws} were given with parameters without priors; tb.Parameter(prior=...) "
            "is wanted"
        )
    start = parameters.start[:1].repeat(draws, 1)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        for e in parameters.priors:
            law = e.prior.expand(torch.Size(e.shape))
            start[:, e.place] = law.sample((draws,)).reshape(draws, e.size).to(start)
    return replace(parameters, start=start.clamp(*parameters.limits))
