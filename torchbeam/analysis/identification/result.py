"""What a search has found: the best start, its covariance, what is not told, hints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ...core.missing_name import Named, by_word
from ...core.warning import warn
from ...solvers.least_squares import CONVERGED, FAILED, LEFT, STUCK, UNFINISHED, Found
from ...solvers.region import Region
from .covariance import Spread
from .exchanged import exchange_hints, multiple_doubts
from .hints import bound_hints, misfit_hints, noise_hints, tangled_hints, unit_hints
from .periods import period_hints
from .problem import FitProblem
from .readings import Readings
from .undetermined import undetermined

UNIDENTIFIABLE = 3
CURVED = 100.0  # error of central differences over the squared step, with room
REASON = {
    CONVERGED: "converged",
    UNFINISHED: "more iterations are wanted",
    STUCK: "no step makes the misfit smaller",
    UNIDENTIFIABLE: "not identifiable",
    FAILED: "the model fails there",
    LEFT: "not followed",
}

LOST = "the search did not converge"
ASTRAY = (
    f"{LOST} ({{}}): theta is no least misfit, and intervals about it mean "
    "nothing; more `iterations`, a nearer start or several starts are wanted"
)


class NamedFit(Named):
    """What other programs call the attributes of a `Fit`."""

    _elsewhere = by_word(
        {
            "covariance": "cov pcov",
            "deviation": "bse error sd standarderror std stderr",
            "interval": "ci confidenceinterval confint",
            "misfit": "chi2 cost rmse",
            "readings, of each measurement's data and y,": "data prediction residual",
            "status": "converged success",
            "theta": "estimate param parameter popt",
        }
    )


def warn_of(doubts: Sequence[str]) -> None:
    """Warn of intervals of a search that did not converge, or whose residuals are no noise of the
    size that was stated.
    """
    if doubts:
        said = "; ".join(doubt.partition(": ")[0] for doubt in doubts)
        wanted = "A better model or mesh is wanted; of larger noise absolute_sigma=False"
        if doubts[0].startswith(LOST):
            wanted = "A search that converges is wanted"
        warn(
            "intervals that take the model as right and what it leaves as noise were asked for, "
            f"but {said} (`doubts` say more). {wanted}",
            UserWarning,
        )


def conclusions(
    problem: FitProblem, search: Found, region: Region, derivatives: str, tolerance: float
) -> dict[str, Any]:
    """Fields of a `Fit`, of the best of the starts."""
    parameters, T = problem.parameters, problem.parameters.transform
    x, r, J = search.x, search.r, search.J
    phi, _, bend = problem.prior(x)
    squares = r.square().sum(-1)
    theta, history = T.theta(x), T.theta(search.history)
    region.sized(torch.arange(len(x), device=x.device), torch.where(torch.isfinite(r), r, 0), J)
    at_unit = torch.where(T.additive, 1.0, torch.maximum(x.abs(), region.size))
    rounding, resolution = _accuracy(problem, x)
    target = problem.target
    least_seen = torch.maximum(
        tolerance * torch.linalg.vector_norm(r, dim=-1),
        rounding * torch.linalg.vector_norm(r + target, dim=-1),
    )
    away, shown, open_ = region.away(x), [], []
    for k in range(len(x)):
        J_size = torch.nan_to_num(torch.cat((J[k], torch.diag(bend[k].sqrt()))) * at_unit[k])
        names, start = parameters.names, parameters.start[k]
        said, which = undetermined(
            names, theta[k], start, away[k], J_size, least_seen[k], resolution
        )
        good = torch.isfinite(squares[k]) & (search.status[k] < FAILED)
        shown.append(said if good else ())
        open_.append(which & good)
    blind = torch.tensor([bool(said) for said in shown], device=x.device)
    statuses = torch.where(blind, UNIDENTIFIABLE, search.status)
    total = torch.where(
        torch.isfinite(squares) & (search.status != LEFT), squares + 2 * phi, torch.inf
    )
    best = int(total.argmin())
    spread, slope = Spread.of(problem, search, best), T.slope(x[best])
    spare = problem.spare + int(spread.held.sum())
    determined = ~open_[best]
    seen = J[best][:, determined]
    plain = problem.white.inverse(seen.mT).mT
    variance = ((plain @ spread.free[determined][:, determined]) * plain).sum(-1)
    deviation = _everywhere(problem, variance.clamp(min=0).sqrt())
    readings = _readings(problem, _values(problem, x[best], r[best]), deviation)
    status = int(statuses[best])
    odd = _units(problem, search, best, status == CONVERGED)
    doubts = _doubts(problem, search, spread, best, status, determined)
    exchanged = exchange_hints(problem, r[best], J[best], spread.white, spread.scale, theta[best])
    bounded = bound_hints(parameters.names, theta[best], spread.held)
    seen_by = J[best].square().sum(0) + bend[best]
    told = spread.free * determined * determined[:, None]
    alone = spread.scale * seen_by.rsqrt()
    tangled = tangled_hints(parameters.names, at_unit[best], alone, told)
    hints = (*odd, *noise_hints(spare, problem.sigma_given), *exchanged, *doubts, *bounded,
             *tangled)  # fmt: skip
    if odd:
        warn(odd[0], UserWarning)
    misfit = problem.white.alone(r)[:, problem.measured].square().mean(-1).sqrt()
    noise, memory = _found_noise(problem)
    shapes = {
        e.name if e.experiment is None else f"{e.experiment}.{e.name}": (e.first, tuple(e.shape))
        for e in parameters.entries
    }
    # fmt: off
    return dict(theta=theta[best], names=parameters.names,
                covariance=slope[:, None] * spread.free * slope,
                y=_as_given(readings, problem), misfit=misfit[best], status=status,
                iterations=len(search.history) - 1,
                history=history, starts=theta, misfits=misfit, statuses=statuses,
                unidentifiable=shown[best],
                message=_message(search, statuses, [REASON[status], *shown[best], *hints]),
                hints=hints, doubts=doubts, open=open_[best],
                held=spread.held, freedom=spread.freedom, redundancy=spread.redundancy,
                scale=spread.scale, blocks=spread.blocks, noise=noise, memory=memory,
                derivatives=derivatives,
                shapes=shapes, x=x[best], x_covariance=spread.covariance, x_slope=spread.slope,
                bounds=torch.stack(parameters.limits, -1), transform=T, readings=readings,
                jacobian=J[best], problem=problem)
    # fmt: on


def _doubts(
    problem: FitProblem, search: Found, spread: Spread, best: int, status: int, determined: Tensor
) -> tuple[str, ...]:
    """Sentences on a search that did not converge, and on residuals that are no noise."""
    lost = (ASTRAY.format(REASON[status]),) if status in (UNFINISHED, STUCK) else ()
    if not spread.scale:
        return lost
    x, r, J = (part[best] for part in (search.x, search.r, search.J))
    seen, white = J[:, determined], spread.white[determined][:, determined]
    return (
        *lost,
        *multiple_doubts(problem, r, J, spread.white, spread.scale),
        *period_hints(problem, r, J, best, x),
        *misfit_hints(problem, r, seen, white),
    )


def _found_noise(problem: FitProblem) -> tuple[dict[str, float], dict[str, float]]:
    """Deviations by channel, and correlations by measurement, of those that were found."""
    noise, memory = {}, {}
    if problem.sigma_given:
        noise = dict(zip(problem.noise.names, problem.deviations.tolist(), strict=True))
    if problem.memory is not None:
        memory = dict(zip(problem.memory.names, problem.memory.rho.tolist(), strict=True))
    return noise, memory


def _units(problem: FitProblem, search: Found, best: int, converged: bool) -> tuple[str, ...]:
    """Hints of units, by what the model gave where a search began."""
    if search.first is None:
        return ()
    offset = [m.offset for e, m in problem.measurements if e.measured]
    return unit_hints(_readings(problem, _known(problem, search.first[best])), offset, converged)


def _accuracy(problem: FitProblem, x: Tensor) -> tuple[Tensor, float]:
    """Rounding of derivatives over the values that they are of, and their relative accuracy."""
    eps, steps = torch.finfo(x.dtype).eps, x.new_tensor(1.0)  # relative
    if problem.method != "difference":
        return eps / steps, eps**0.5
    steps = torch.as_tensor(problem.relative_step, dtype=x.dtype, device=x.device)
    return eps / steps.min(), max(eps**0.5, CURVED * steps.max().item() ** 2)


def _message(search: Found, statuses: Tensor, sentences: list[str]) -> str:
    """These sentences, and what starts and trials failed at."""
    if failed := int((statuses == FAILED).sum()):
        sentences.append(f"the model failed at {failed} of {len(statuses)} starts")
    if search.raised:
        last = search.raised[-1]
        sentences.append(f"at {len(search.raised)} trials the model raised, last {last!r}")
    return "; ".join(sentences)


def _everywhere(problem: FitProblem, known: Tensor) -> Tensor:
    """(all numbers,) of what is known where something was measured, NaN elsewhere."""
    everywhere = known.new_full(problem.known.shape, torch.nan)
    everywhere[problem.known] = known
    return everywhere


def _known(problem: FitProblem, r: Tensor) -> Tensor:
    """The model's values (all numbers,) from residuals (T,), NaN where nothing was measured;
    offsets and drifts are in them.
    """
    return _everywhere(problem, problem.white.inverse(r + problem.target[0]))


def _values(problem: FitProblem, x: Tensor, r: Tensor) -> Tensor:
    """The model's values (numbers,) at coordinates (p,), asked only for what r does not tell."""
    if problem.known.all():
        return _known(problem, r)
    theta = problem.parameters.transform.theta(x)[None]
    return (problem.values(theta) + problem.nuisance.values(theta))[0]


def _readings(
    problem: FitProblem, values: Tensor, deviation: Tensor | None = None
) -> tuple[Readings, ...]:
    """Data beside the model's values (all numbers,), by measurement; without rows of priors."""
    every = problem.measurements
    off = [None] * len(every) if deviation is None else problem.by_measurement(deviation)
    return tuple(
        Readings(e.name, m.labels, m.times, m.values, y, m.sigma, d)
        for (e, m), y, d in zip(every, problem.by_measurement(values), off, strict=True)
        if e.measured
    )


def _as_given(readings: tuple[Readings, ...], problem: FitProblem) -> Any:
    """The model's values in the form in which the data were given."""
    rest = iter(readings)
    parts = {}
    for e in filter(lambda e: e.measured, problem.experiments):
        values = tuple(next(rest).y for _ in e.measurements)
        parts[e.name] = values[0] if e.single else values
    return parts[None] if None in parts else parts
