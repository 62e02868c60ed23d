"""Identification: parameters of models from data, by damped Gauss-Newton steps, many starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count
from ...core.arguments import tolerance as check_tolerance
from ...core.docstrings import with_arguments_of
from ...core.validation import Value
from ...core.warning import SlowPathWarning, warn
from ...solvers.lbfgs import descend
from ...solvers.least_squares import Found, search
from ...solvers.region import Region
from .discretisation import doubted
from .experiment import Model, experiments_of
from .fit import Fit
from .measurement import Measurement, each
from .noise import NOISES, Noise
from .parameters import Parameters
from .problem import FitProblem
from .reweighting import search_in_rounds

DERIVATIVES = ("auto", "forward", "difference", "adjoint")
STEP = 1e-4  # of differences
# times that: another step, which finds the same derivatives where differences are good
COARSE = 10.0
TRIES = 5  # steps of differences, each a tenth of the one before
SAME = 1e-3  # of a column of J


@dataclass(frozen=True)
class SearchOptions:
    """Options of `identify`, checked where a search begins.

    Args:
        starts: number of starts, drawn about the start within a factor of `spread`, the bounds and
            the priors' supports. Between two bounds, or the two ends of a support, they are uniform
            in the coordinate of the search
        follow: number of best starts that are followed; the others are evaluated once
        log: search in log theta (theta is positive): for stiffness, mass and damping
        bounds: (least, largest) of theta, (p,) each: a step beyond a bound is cut, and continues
            along it
        sigma: (...) standard deviation of the data: weights them, and scales the covariance
        absolute_sigma: False: sigma (of measurements too) weighs the data only; the misfit gives
            the size of the noise
        noise: of data without sigma. "common": a common deviation, from the misfit; of sensors that
            read several units (m, m/s^2) a deviation for each unit. "channel": a deviation for each
            channel (heteroscedastic), also beside data with sigma. Searches alternate with
            estimates of the deviations (iteratively reweighted least squares), up to restricted
            maximum likelihood
        derivatives: "difference": central differences of `relative_step` (1e-4), a batch of 2 p
            times the starts, which run on the compiled engine. "forward": forward mode, the p
            directions as a batch, by eager steps. "adjoint": the gradient of the squares by reverse
            mode, for any p, and L-BFGS (torch.optim) in place of Gauss-Newton. It is for p beyond
            some hundreds: it takes more iterations, follows starts in turn, and has bounds only by
            logits. "auto": differences, if ten times the step changes them by less than 1e-3 at the
            start. A parameter beyond that (responses of many periods, models that jump) gets
            shorter steps, down to 1e-8. If these fail, forward mode follows, with a RuntimeWarning
        tolerance: of the largest step, relative to theta (of log theta, absolute); also, squared,
            of the decrease of the squares
        progress: a line of progress (tqdm)
    """

    log: bool
    bounds: tuple[Value, Value] | None
    sigma: Value | None
    absolute_sigma: bool
    noise: str
    names: Sequence[str] | None
    starts: int
    spread: float
    follow: int
    seed: int
    derivatives: str
    relative_step: float | None
    iterations: int
    tolerance: float
    progress: bool

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> SearchOptions:
        """Those among the arguments of a function."""
        return cls(**{f.name: arguments[f.name] for f in fields(cls)})

    def check(self) -> None:
        choice("derivatives", self.derivatives, DERIVATIVES)
        for name in ("tolerance", *["relative_step"] * (self.relative_step is not None)):
            check_tolerance(name, getattr(self, name))
        boolean("progress", self.progress)
        boolean("log", self.log)
        count("iterations", self.iterations)
        choice("noise", self.noise, NOISES)
        if self.noise == "channel" and not self.absolute_sigma:
            raise ValueError(
                "noise='channel' was given with absolute_sigma=False; measurements without sigma "
                "are wanted, whose noise is found"
            )


@with_arguments_of(SearchOptions)
def identify(
    model: Model | Mapping[str, Model],
    data: Any,
    start: Any,
    *,
    log: bool = False,
    bounds: tuple[Value, Value] | None = None,
    sigma: Value | None = None,
    absolute_sigma: bool = True,
    noise: str = "common",
    names: Sequence[str] | None = None,
    starts: int = 1,
    spread: float = 3.0,
    follow: int = 32,
    seed: int = 0,
    derivatives: str = "auto",
    relative_step: float | None = None,
    iterations: int = 50,
    tolerance: float = 1e-6,
    progress: bool = False,
) -> Fit:
    """Find the parameters theta whose model(theta) fits the data best, by least squares over sigma.

    Args:
        model: theta -> y, batched: sample i of y depends on sample i of theta alone. theta is (N,
            p), or name -> (N, *shape) for named parameters. y (N, ...) has the shape of the data
            behind N. The model may also return (y, status (N,)), 0 = success, or the `Solution` of
            N samples, which the measurements read
        data: (...) as y without its first axis; NaN = not measured. Or a `Measurement`, which has
            noise, times, sensor, offset and drift. Or a list of several measurements of an
            experiment: y is then a list too, or a Solution. Several experiments are name -> any of
            these; `model` is then name -> model, or a common model
        start: (p,), or (starts, p), which are followed together as a batch: the best end counts. Or
            name -> `Parameter`, number or tensor. Experiments share all parameters but those with
            `own`

    Levenberg's and Marquardt's method: (J^T J + lambda diag(J^T J)) step = -J^T r, lambda rises
    until the squares decrease, for each start by itself. (Nocedal and Wright 2006, section 10.3.) A
    step changes a parameter by at most ten times its size (with `log`: by at most a factor of ten).
    No step passes 1e9 times the start. If the model raises, has a status or is not finite at a
    trial, a shorter step follows. Starts that are done or fail are no longer evaluated.

    `unidentifiable` names each parameter that ran away. It also names parameters, or combinations,
    that may change by their own size while the misfit changes by at most `tolerance` of it, or
    rounding. The status is then never 0.

    A converged fit without doubts is run again with half the step of each `simulate`, and with
    twice the elements: one sample each. `doubts` say if that would move a parameter by more than
    its deviation.

    Raises:
        ValueError: for a model whose output does not fit the data, or is finite at none of the
            starts. For fewer data than parameters without a prior, and for data without a number.
            An error that the model raises at all starts is passed on.

    Examples:
        >>> x = torch.tensor([1.0, 2.0, 3.0, 4.0])
        >>> fit = tb.identify(
        ...     lambda p: p["k"][..., None] * x,
        ...     2 * x + torch.tensor([0.1, -0.1, 0.1, -0.1]),
        ...     {"k": 1.0},
        ... )
        >>> fit.theta, fit.interval(0.95)  # the estimate, where it is
        (tensor([1.9933]), tensor([[1.9274, 2.0593]]))
    """
    return doubted(searched)(model, data, start, SearchOptions.of(locals()))


def searched(model: Any, data: Any, start: Any, options: SearchOptions) -> Fit:
    """See `identify`."""
    options.check()
    o, derivatives, tolerance = options, options.derivatives, options.tolerance
    experiments = experiments_of(model, data, o.sigma)
    like = [
        d for group in (data.values() if isinstance(data, Mapping) else [data]) for d in each(group)
    ]
    if isinstance(start, Mapping) or any(isinstance(d, Measurement) for d in like):
        like = [m.values for e in experiments for m in e.measurements]
    named = [e.name for e in experiments if e.name is not None and e.measured]
    parameters = Parameters.of(start, o.log, o.bounds, o.names, named, like)
    if derivatives == "adjoint" and parameters.bounded:
        raise ValueError(
            "bounds were given with derivatives = 'adjoint', which takes none but by the "
            "transform 'logit'; 'difference' and 'forward' do"
        )
    parameters, noise = parameters.more_starts(o.starts, o.spread, o.seed), None
    absolute = boolean("absolute_sigma", o.absolute_sigma)
    if o.noise == "channel":
        experiments, noise = Noise.by_channel(experiments)
    elif absolute:
        experiments, noise = Noise.by_unit(experiments, parameters.model)
    problem = FitProblem.of(experiments, parameters, absolute, noise)
    x = problem.parameters.x
    region = problem.region(x)
    with torch.no_grad():
        problem = with_derivatives(problem, x, derivatives, o.relative_step)
        most = count("follow", o.follow) if o.starts > 1 else None
        with _line(o.progress, len(x)) as report:

            def run(problem: FitProblem, ends: Tensor, which: Tensor) -> Found:
                here = (region if len(which) == len(x) else region.of(which)).against(
                    problem.target
                )
                if derivatives == "adjoint":
                    return _by_adjoint(problem, ends, here, o.iterations, tolerance)
                few = most and min(most, len(ends))
                # fmt: off
                return search(problem, ends, here, o.iterations, tolerance, follow=few,
                              progress=report)
                # fmt: on

            if problem.in_rounds:
                problem, search_result = search_in_rounds(problem, x, run)
            else:
                search_result = run(problem, x, torch.arange(len(x), device=x.device))
        region = region.against(problem.target)
        method = derivatives if derivatives == "adjoint" else problem.method
        return Fit.of(problem, search_result, region, method, tolerance)


def with_derivatives(
    problem: FitProblem, x: Tensor, derivatives: str, relative_step: float | None
) -> FitProblem:
    """The problem with the derivatives that are asked for; else by differences that do not depend
    on their step at the first start that has a Jacobian: each parameter's of the first of TRIES,
    each a tenth of the one before (of a step that is given, that alone); else by forward mode.
    """
    problem = replace(problem, relative_step=STEP if relative_step is None else relative_step)
    if derivatives in ("forward", "difference"):
        return replace(problem, method=derivatives)
    tries = TRIES if relative_step is None else 1
    for k in range(len(x)):
        here, which = x[k : k + 1], torch.tensor([k], device=x.device)
        try:
            r, J = problem.linearised(here, which)
        except Exception:
            if len(x) == 1:
                raise
            continue
        coarse = replace(problem, relative_step=COARSE * problem.relative_step)
        try:
            _, other = coarse.linearised(here, which, r)
        except Exception:  # it raises there, or is not finite: nothing is known against differences
            return problem
        fine = problem
        for left in reversed(range(tries)):
            if not torch.isfinite(J).all() or not torch.isfinite(other).all():
                break
            off, size = _dependence(fine, here, r, J, other)
            if (off <= 0).all():
                return fine
            if left:
                shorter = torch.ones_like(x[0])
                shorter[: len(off)] = torch.where(off > 0, 1 / COARSE, 1.0)
                fine = replace(fine, relative_step=fine.relative_step * shorter)
                other, (_, J) = J, fine.linearised(here, which, r)
        else:
            worst = problem.parameters.names[int((off / size).nan_to_num().argmax())]
            warn(
                "derivatives = 'auto' takes forward mode, whose steps are eager and slow: the "
                f"differences of {worst!r} depend on their step ('difference' takes them all the "
                "same)",
                SlowPathWarning,
            )
            return replace(problem, method="forward")
    return problem


def _dependence(
    problem: FitProblem, x: Tensor, r: Tensor, J: Tensor, other: Tensor
) -> tuple[Tensor, Tensor]:
    """By how much the columns of two Jacobians (1, T, p) by differences, J those of the problem's
    step, are further apart than they may be, and their sizes: (p,), of the model's parameters.
    """
    m = problem.parameters.model
    size = torch.linalg.vector_norm(J, dim=1)[0, :m]
    off = torch.linalg.vector_norm(J - other, dim=1)[0, :m] - SAME * size
    rounding = 10 * torch.finfo(x.dtype).eps / problem.steps(x)[0, :m]
    return off - rounding * torch.linalg.vector_norm(r + problem.target[:1]), size


def _by_adjoint(
    problem: FitProblem, x: Tensor, region: Region, iterations: int, tolerance: float
) -> Found:
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
