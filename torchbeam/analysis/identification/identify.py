"""Identification: parameters of models from data, by damped Gauss-Newton steps from several starts at once."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count
from ...core.arguments import tolerance as check_tolerance
from ...core.validation import Value
from ...solvers.lbfgs import descend
from ...solvers.least_squares import FAILED, LEFT, Found, search
from ...solvers.region import Region
from .fit import REASON, UNIDENTIFIABLE, Fit
from .hints import bound_hints, fit_hints, unit_hints
from .measurement import Measurement
from .parameters import Parameters
from .problem import Model, Problem, experiments_of
from .readings import Readings
from .undetermined import undetermined

DERIVATIVES = ("auto", "forward", "difference", "adjoint")
STEP = 1e-4  # of differences
COARSE = 10.0  # times that: another step, which finds the same derivatives where differences are good
SAME = 1e-3  # of a column of J


def identify(model: Model | Mapping[str, Model], data: Any, start: Any, *, log: bool = False,
             bounds: tuple[Value, Value] | None = None, sigma: Value | None = None, names: Sequence[str] | None = None,
             starts: int = 1, spread: float = 3.0, follow: int = 32, seed: int = 0, derivatives: str = "auto",
             relative_step: float | None = None, iterations: int = 50, tolerance: float = 1e-6, progress: bool = False) -> Fit:
    """Parameters theta for which model(theta) is nearest to the data, in the sum of squares over sigma.

    model        theta -> y, batched: sample i of y depends on sample i of theta alone. theta is (N, p), or name -> (N, *shape)
                 where parameters have names. y (N, ...) is as the data; or (y, status (N,)), 0 = success; or the `Solution` of
                 N samples, which the measurements read
    data         (...) as y without its first axis; NaN where nothing was measured. Or a `Measurement`, which has noise, times,
                 sensor, offset and drift; or several of one experiment, in a list: y is then a list too, or a Solution.
                 name -> any of these: several experiments; then `model` is name -> model, or one for all
    start        (p,), or (starts, p) to be followed all at once, as one batch: the best end counts; or name -> `Parameter`,
                 number or tensor. Parameters are all experiments', but for those that are each one's own
    starts       so many, drawn about the one that was given, within a factor of `spread`; between bounds where there are two
    follow       of these, so many that fit best are followed; the others are evaluated once
    log          search in log theta (theta is positive): for stiffness, mass and damping
    bounds       (least, largest) of theta, (p,) each: a step that leaves them is cut, and goes along them
    sigma        (...) standard deviation of the data: weights them, and scales the covariance
    derivatives  "difference": central differences of `relative_step` (1e-4), a batch of 2 p times the starts, which run on the
                 compiled engine. "forward": forward mode, the p directions as a batch, by eager steps. "adjoint": the gradient
                 of the squares by reverse mode, whatever p, and L-BFGS (torch.optim) in place of Gauss-Newton, for p beyond
                 some hundreds; it takes more iterations, one start after the other, no bounds. "auto": differences, where those
                 of ten times the step agree with them to 1e-3 at the start, and else forward mode
    tolerance    of the largest step, relative to theta (of log theta, absolute); also, squared, of the decrease of the squares
    progress     a line of progress (tqdm)

    Levenberg's and Marquardt's method: (J^T J + lambda diag(J^T J)) step = -J^T r, lambda raised until the squares go down,
    each start by itself. (Nocedal and Wright 2006, section 10.3.) No step changes a parameter by more than ten times its size
    (with `log`: by a factor of more than ten), or takes it beyond 1e9 times its start. A trial at which the model raises, has a
    status, or is not finite is a step that is not taken: a shorter one is tried. Starts that are done, or fail, are no longer
    evaluated.

    A parameter that ran away is named in `unidentifiable`, and so are parameters, or changes of several together, that change
    the misfit by no more than `tolerance` of itself, or than rounding, where they change by their own size. The status is then
    never 0.

    Raises ValueError for a model whose output does not fit the data, for starts at none of which it is finite, fewer data than
    parameters, data without a number; what the model raises at all starts goes through.
    """
    choice("derivatives", derivatives, DERIVATIVES)
    check_tolerance("tolerance", tolerance)
    boolean("progress", progress)
    limit = count("iterations", iterations)
    step = STEP if relative_step is None else check_tolerance("relative_step", relative_step)
    experiments = experiments_of(model, data, sigma)
    like = [m.values for e in experiments for m in e.measurements]
    if not isinstance(start, Mapping) and not any(isinstance(d, Measurement) for d in _each(data)):
        like = _each(data)
    parameters = Parameters.of(start, log, bounds, names, [e.name for e in experiments if e.name is not None], like)
    if bounds is not None and derivatives == "adjoint":
        raise ValueError("bounds were given with derivatives = 'adjoint', which takes none; 'difference' and 'forward' do")
    problem = replace(Problem.of(experiments, parameters.more_starts(starts, spread, seed)), relative_step=step)
    parameters = problem.parameters
    x = parameters.x
    region = Region(x, parameters.size, parameters.transform.additive, *parameters.bounds(x), problem.target)
    with torch.no_grad():
        way = derivatives if derivatives in ("forward", "difference") else _chosen(problem, x)
        problem = replace(problem, method=way)
        with _line(progress, len(x)) as report:
            if derivatives == "adjoint":
                found = _by_adjoint(problem, x, region, limit, tolerance)
            else:
                most = count("follow", follow) if starts > 1 else None
                found = search(problem, x, region, limit, tolerance, follow=most, progress=report)
        return _fit(problem, found, region, data, derivatives if derivatives == "adjoint" else way, tolerance)


def _each(data: Any) -> list[Any]:
    parts = list(data.values()) if isinstance(data, Mapping) else [data]
    return [d for part in parts for d in (part if isinstance(part, (list, tuple)) and any(
        isinstance(one, Measurement) for one in part) else [part])]


def _chosen(problem: Problem, x: Tensor) -> str:
    """"difference" where these do not depend on their step at the first start that has a Jacobian, else "forward"."""
    m = problem.parameters.model
    for k in range(len(x)):
        which = torch.tensor([k], device=x.device)
        try:
            r, J = problem.linearised(x[k:k + 1], which)
        except Exception:
            if len(x) == 1:
                raise
            continue
        coarse = replace(problem, relative_step=COARSE * problem.relative_step)
        try:
            _, other = coarse.linearised(x[k:k + 1], which, r)
        except Exception:  # it raises there, or is not finite: nothing is known against differences
            return "difference"
        if not torch.isfinite(J).all() or not torch.isfinite(other).all():
            continue
        off = torch.linalg.vector_norm(J - other, dim=1)[0, :m] - SAME * torch.linalg.vector_norm(J, dim=1)[0, :m]
        rounding = 10 * torch.finfo(x.dtype).eps / problem.steps(x[k:k + 1])[0, :m]
        return "difference" if (off <= rounding * torch.linalg.vector_norm(r + problem.target[:1])).all() else "forward"
    return "difference"


def _by_adjoint(problem: Problem, x: Tensor, region: Region, iterations: int, tolerance: float) -> Found:
    def objective(at: Tensor, k: int) -> Tensor:
        which = torch.tensor([k], device=x.device)
        return problem.residuals(at, which).square().sum() + 2 * problem.objective_prior(at).sum()

    x, status, history, raised = descend(objective, x, region, iterations, tolerance)
    every = torch.arange(len(x), device=x.device)
    try:
        r, J = problem.linearised(x, every)
    except Exception:  # next to where the search ended, maybe: forward mode looks at that alone
        r, J = replace(problem, method="forward").linearised(x, every)
    return Found(x, r, J, status, history, raised)


def _tqdm() -> Any:
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm


@contextmanager
def _line(wanted: bool, starts: int) -> Iterator[Callable[[int, int, float], None] | None]:
    """What shows a line of progress; None where none is wanted, or tqdm is not installed."""
    bar_of = _tqdm() if wanted else None
    if bar_of is None:
        yield None
        return
    with bar_of(total=starts, desc="identify", unit="start") as bar:
        def report(iteration: int, active: int, squares: float) -> None:
            bar.set_postfix_str(f"iteration {iteration}, squares {squares:.4g}", refresh=False)
            bar.update(starts - active - bar.n)
            bar.refresh()
        yield report


def _fit(problem: Problem, found: Found, region: Region, data: Any, derivatives: str, tolerance: float) -> Fit:
    """The fit of the best of the starts."""
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
    return Fit(theta[best], parameters.names, slope[:, None] * x_covariance * slope, _as_given(y, data), misfits[best], status,
               len(found.history) - 1, history, theta, misfits, statuses, shown[best], message, hints, open_[best], freedom,
               derivatives, shapes, x[best], x_covariance, torch.stack((parameters.least, parameters.largest), -1), T, readings,
               problem)


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


def _as_given(y: list[list[Tensor]], data: Any) -> Any:
    """The model's values in the form of the data."""
    def one(parts: list[Tensor], given: Any) -> Any:
        several = isinstance(given, (list, tuple)) and any(isinstance(d, Measurement) for d in given)
        return tuple(parts) if several else parts[0]

    if isinstance(data, Mapping):
        return {name: one(parts, data[name]) for name, parts in zip(data, y, strict=True)}
    return one(y[0], data)


def _inverse(A: Tensor) -> Tensor:
    """Of a symmetric matrix without negative eigenvalues; where it is singular to rounding, its largest meaningful one."""
    size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).rsqrt()
    values, vectors = torch.linalg.eigh(size[:, None] * A * size)
    return size[:, None] * (vectors / values.clamp(min=torch.finfo(A.dtype).eps * values.amax()) @ vectors.mT) * size
