"""Priors as observations: normal laws about parameters or their logarithms, as further data."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.distributions import Distribution, LogNormal, Normal, Uniform, constraints

from .experiment import Experiment
from .measurement import Measurement
from .parameters import Entry
from .problem import FitProblem


class Even(Distribution):
    """The same density everywhere."""

    arg_constraints = {}  # noqa: RUF012
    support = constraints.real

    def log_prob(self, value: Tensor) -> Tensor:
        return torch.zeros_like(value)


def with_priors_observed(problem: FitProblem) -> FitProblem:
    """The same least squares, with priors among the data, so that both can be repeated: as
    randomised searches for the mode do (Oliver, He and Reynolds 1996, 5th Eur. Conf. Math. Oil
    Recovery; Bardsley, Solonen, Haario and Laine 2014, SIAM J. Sci. Comput. 36, A1895). A normal
    prior is an observation of its parameter; a log-normal one, mean m and deviation s of the
    logarithm, one of that: by m where the logarithm is the coordinate, and else by m - s^2, where
    the density of the parameter itself has its mode. A uniform one is bounds. Where the density is
    one of another coordinate than that of the search, what is left of it is how theta moves by the
    coordinate.

    Raises ValueError for other priors, which are none.
    """
    parameters, like = problem.parameters, problem.white.weight
    log, logit = parameters.transform.log, parameters.transform.logit
    seen, left = [], {}
    for entry in parameters.priors:
        by_log = bool(log[entry.first]) and type(entry.prior) is LogNormal
        if type(entry.prior) is not Uniform:
            seen.append(_observation(entry, like, by_log))
        if not by_log and bool((log | logit)[entry.first]):
            left[entry.first] = Even()
    sigma, values = (
        torch.cat([like[:0], *(getattr(e.measurements[0], name).flatten() for e in seen)])
        for name in ("sigma", "values")
    )
    rows, (least, largest) = len(values), parameters.limits
    entries = tuple(replace(e, prior=left.get(e.first)) for e in parameters.entries)
    parameters = replace(parameters, entries=entries, least=least, largest=largest)
    noise = replace(
        problem.noise,
        channel=torch.cat((problem.noise.channel, problem.noise.channel.new_full((rows,), -1))),
    )
    return replace(
        problem,
        experiments=(*problem.experiments, *seen),
        parameters=parameters,
        noise=noise,
        known=torch.cat((problem.known, torch.ones_like(values, dtype=torch.bool))),
        white=problem.white.longer(1 / sigma),
        target=torch.cat((problem.target, (values / sigma)[None]), -1),
        nuisance=problem.nuisance.longer(rows),
    )


def _observation(entry: Entry, like: Tensor, by_log: bool) -> Experiment:
    law, name = entry.prior, entry.name
    if type(law) not in (Normal, LogNormal):
        raise ValueError(
            f"a bootstrap of a fit with the prior {law} of {name!r} was asked for; normal, "
            "log-normal and uniform ones can be repeated, and the intervals 'laplace' and "
            "'profile' count any"
        )
    centre, deviation = (
        torch.as_tensor(v).to(like).expand(entry.shape) for v in (law.loc, law.scale)
    )
    log = type(law) is LogNormal
    seen = Measurement(centre - deviation**2 if log and not by_log else centre, deviation)
    return Experiment(
        entry.experiment, lambda theta: theta[name].log() if log else theta[name], (seen,), True
    )
