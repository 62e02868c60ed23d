"""What a search has found: the best start, its covariance, what is not told, hints."""

from __future__ import annotations

import warnings
from typing import Any

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED, FAILED, LEFT, STUCK, UNFINISHED, Found
from ...solvers.region import Region
from .hints import bound_hints, fit_hints, unit_hints
from .problem import Problem
from .readings import Readings
from .undetermined import undetermined

UNIDENTIFIABLE = 3
REASON = {CONVERGED: "converged", UNFINISHED: "more iterations are wanted", STUCK: "no step makes the misfit smaller",
          UNIDENTIFIABLE: "not identifiable", FAILED: "the model fails there", LEFT: "not followed"}


def conclusions(problem: Problem, found: Found, region: Region, derivatives: str, tolerance: float) -> dict[str, Any]:
    """Fields of a `Fit`, of the best of the starts."""
    parameters, T = problem.parameters, problem.parameters.transform
    x, r, J = found.x, found.r, found.J
    phi, _, bend = problem.prior(x)
    squares, p, numbers = r.square().sum(-1), x.shape[1], r.shape[1]
    theta, history = T.theta(x), T.theta(found.history)
    region.sized(torch.arange(len(x), device=x.device), torch.where(torch.isfinite(r), r, 0), J)
    at_unit = torch.where(T.additive, 1.0, torch.maximum(x.abs(), region.size))
    rounding = torch.finfo(x.dtype).eps / (problem.relative_step if problem.method == "difference" else 1)
    target = problem.target
    least_seen = torch.maximum(tolerance * torch.linalg.vector_norm(r, dim=-1),
                               rounding * torch.linalg.vector_norm(r + target, dim=-1))
    away, shown, open_ = region.away(x), [], []
    for k in range(len(x)):
        J_size = torch.nan_to_num(torch.cat((J[k], torch.diag(bend[k].sqrt()))) * at_unit[k])
        said, which = undetermined(parameters.names, theta[k], parameters.start[k], away[k], J_size, least_seen[k])
        good = torch.isfinite(squares[k]) & (found.status[k] < FAILED)
        shown.append(said if good else ())
        open_.append(which & good)
    blind = torch.tensor([bool(said) for said in shown], device=x.device)
    statuses = torch.where(blind, UNIDENTIFIABLE, found.status)
    total = torch.where(torch.isfinite(squares) & (found.status != LEFT), squares + 2 * phi, torch.inf)
    best = int(total.argmin())
    freedom = torch.inf if problem.sigma_given else float(max(numbers - p, 1))
    scale = 1.0 if problem.sigma_given else squares[best] / freedom
    x_covariance = scale * _inverse(J[best].mT @ J[best] + torch.diag(bend[best]))
    slope = T.slope(x[best])
    known = torch.full(problem.known.shape, torch.nan, dtype=x.dtype, device=x.device)
    told = ~open_[best]
    seen = J[best][:, told]
    known[problem.known] = ((seen @ x_covariance[told][:, told]) * seen).sum(-1).clamp(min=0).sqrt() / problem.weight
    readings, y = _readings(problem, x[best], known)
    first, _ = _readings(problem, parameters.x[best])
    hints = (*unit_hints(first), *fit_hints(readings, squares[best].item(), numbers - p, problem.sigma_given),
             *bound_hints(parameters.names, x[best], *parameters.bounds(x[best])))
    if unit_hints(first):
        warnings.warn(hints[0], UserWarning, stacklevel=4)
    status, misfits = int(statuses[best]), (squares / numbers).sqrt()
    failed = int((statuses == FAILED).sum())
    message = "; ".join((REASON[status], *shown[best], *hints, *(
        [f"the model failed at {failed} of {len(x)} starts"] if failed else []), *(
        [f"at {len(found.raised)} trials the model raised, last {found.raised[-1]!r}"] if found.raised else [])))
    shapes = {e.name if e.experiment is None else f"{e.experiment}.{e.name}": (e.first, tuple(e.shape))
              for e in parameters.entries}
    return dict(theta=theta[best], names=parameters.names, covariance=slope[:, None] * x_covariance * slope,
                y=_as_given(y, problem), misfit=misfits[best], status=status, iterations=len(found.history) - 1,
                history=history, starts=theta, misfits=misfits, statuses=statuses, unidentifiable=shown[best],
                message=message, hints=hints, open=open_[best], freedom=freedom, derivatives=derivatives, shapes=shapes,
                x=x[best], x_covariance=x_covariance, bounds=torch.stack((parameters.least, parameters.largest), -1),
                transform=T, readings=readings, problem=problem)


def _readings(problem: Problem, x: Tensor, deviation: Tensor | None = None) -> tuple[tuple[Readings, ...], list[list[Tensor]]]:
    """Data beside the model at coordinates (p,), offsets and drifts included, by experiment and measurement."""
    parameters = problem.parameters
    theta = parameters.transform.theta(x)
    values = problem.values(theta[None])[0]
    own, found, all_, first = theta[parameters.model:], [], [], 0
    for e in problem.experiments:
        parts = []
        for m in e.measurements:
            names, basis = m.nuisance()
            y = values[first:first + m.values.numel()].reshape(m.values.shape)
            y = y + (own[:len(names)] @ basis.reshape(len(names), y.numel())).reshape(y.shape)
            off = None if deviation is None else deviation[first:first + m.values.numel()].reshape(m.values.shape)
            own, first = own[len(names):], first + m.values.numel()
            found.append(Readings(e.name, m.labels, m.times, m.values, y, m.sigma, off))
            parts.append(y)
        all_.append(parts)
    return tuple(found), all_


def _as_given(y: list[list[Tensor]], problem: Problem) -> Any:
    """The model's values in the form in which the data were given."""
    parts = [own[0] if e.single else tuple(own) for e, own in zip(problem.experiments, y, strict=True)]
    names = [e.name for e in problem.experiments]
    return parts[0] if names == [None] else dict(zip(names, parts, strict=True))


def _inverse(A: Tensor) -> Tensor:
    """Of a symmetric matrix without negative eigenvalues; where it is singular to rounding, its largest meaningful one."""
    size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).rsqrt()
    values, vectors = torch.linalg.eigh(size[:, None] * A * size)
    return size[:, None] * (vectors / values.clamp(min=torch.finfo(A.dtype).eps * values.amax()) @ vectors.mT) * size
