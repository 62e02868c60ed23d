"""Discretisation: by how much a fit would move with shorter steps or a finer mesh."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED
from ..convergence.finer import Finer, NotRefined, finer
from ..convergence.reading import on_mesh
from .experiment import Experiment
from .problem import FitProblem

P = ParamSpec("P")
F = TypeVar("F")
APART = 1.0  # deviations by which a parameter may move
MOST = 0.5  # of a misfit that gives the noise: below it, deviations are those of what is left
FINER = "which leave it out; a finer model is wanted, as `fit.refined` takes"
KINDS: dict[str, tuple[float, str, str]] = dict(
    steps=(2, "steps half as long", FINER),
    elements=(2, "twice as many elements", FINER),
    springs=(10, "firm springs of the clamp ten times as stiff", "which take them as rigid; a "
             "`Support` that holds these components beside the RootSpring is wanted"),
)  # fmt: skip


def doubted(search: Callable[P, F]) -> Callable[P, F]:
    """A function that returns a `Fit`, whose fits have doubts about their steps and their mesh. The
    fits have converged, and their residuals raise no doubt.

    Each refined model runs once, with the fit's parameters. Its readings give a Gauss-Newton step
    by the fit's derivatives (defect correction, as in `Fit.refined`).

    Nothing is known of the mesh of a structure, nor of steps that control their own error.
    """

    @wraps(search)
    def judged(*args: P.args, **kwargs: P.kwargs) -> F:
        with finer() as runs:
            fit = search(*args, **kwargs)
        return _with_doubts(fit, runs)

    return judged


def _with_doubts(fit: Any, runs: Finer) -> Any:
    if fit.status != CONVERGED or fit.doubts or not runs.used:
        return fit
    kinds = [
        kind for kind, there in zip(KINDS, (runs.stepped, True, runs.sprung), strict=True) if there
    ]
    x, which = fit.x[None], torch.zeros(1, dtype=torch.long, device=fit.x.device)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        r = fit.problem.residuals(x, which)
        each = [pair for kind in kinds for pair in _doubt(fit, kind, r, which)]
    if not each:
        return fit
    said = [sentence for _, sentence in each]
    doubts = tuple(sentence for is_doubt, sentence in each if is_doubt)
    message = "; ".join([fit.message, *said])
    return replace(fit, doubts=doubts, hints=(*fit.hints, *said), message=message)


def _doubt(fit: Any, kind: str, r: Tensor, which: Tensor) -> Iterator[tuple[bool, str]]:
    """Whether it is a doubt, and a sentence: refinement moves a parameter; r (1, T) of the fit."""
    (factor, refined, wanted), problem, x = KINDS[kind], fit.problem, fit.x[None]
    try:
        with finer(**{kind: factor}):
            of = problem if kind != "elements" else _on_meshes(problem, x)
            change = of.residuals(x, which) - r
    except NotRefined as error:
        yield False, str(error)
        return
    except Exception:  # a mesh that does not divide, a start of another mesh, a failure
        return
    A = fit.jacobian.mT @ fit.jacobian + torch.diag(problem.prior(x)[2][0])
    move = _step(A, fit.jacobian.mT @ change[0], ~fit.held & ~fit.open)
    apart = (move / fit.x_covariance.diagonal().sqrt())[: problem.parameters.model]
    theta, least, rest = fit.transform.theta(fit.x + move), APART, ""
    reason = f"the error of the {kind} is larger than stated deviations, {wanted}"
    if not math.isinf(fit.freedom.min().item()):
        left = (r[0] + change[0] + fit.jacobian @ move).norm() / r[0].norm()
        if left < MOST:
            least, rest = APART * left.item(), f", and leave {left:.2g} of the misfit"
            reason = f"this is the error of the {kind}, and no noise; {wanted.partition('; ')[2]}"
    moved = [k for k in apart.abs().argsort(descending=True).tolist() if abs(apart[k]) > least]
    if moved:
        said = ", ".join(
            f"{fit.names[k]} by {apart[k]:+.2g} deviations (to {_apart(theta[k], fit.theta[k])})"
            for k in moved
        )
        yield True, f"{refined} would move {said}{rest}: {reason}"


def _apart(value: Tensor, other: Tensor) -> str:
    """A number with two digits at least of its difference from the other."""
    share = ((value - other) / value).abs().clamp(1e-12, 1).item()
    return f"{value:.{max(4, 2 - math.floor(math.log10(share)))}g}"


def _step(A: Tensor, gradient: Tensor, free: Tensor) -> Tensor:
    """(p,) coordinates by which least squares move; 0 of those that are not free."""
    size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).rsqrt() * free
    return -size * (torch.linalg.pinv(size[:, None] * A * size, hermitian=True) @ (size * gradient))


def _on_meshes(problem: FitProblem, x: Tensor) -> FitProblem:
    """The problem whose experiments have run on finer meshes, and whose sensors follow these; a
    model that returns tensors reads the nodes of its own mesh.
    """
    parts = [_on_mesh(e, problem, x) for e in problem.experiments]
    return replace(problem, experiments=tuple(parts))


def _on_mesh(experiment: Experiment, problem: FitProblem, x: Tensor) -> Experiment:
    if not experiment.measured:
        return experiment
    runs = Finer.now.get()
    runs.scenes.clear()
    runs.as_drawn = all(m.sensor is None for m in experiment.measurements)
    given = problem.parameters.given(problem.theta(x), experiment.name)
    result = experiment.model(given)
    if runs.as_drawn or not runs.scenes:
        return replace(experiment, model=lambda _: result)
    coarse, fine = runs.scenes[-1]
    measurements = tuple(
        replace(m, sensor=on_mesh(m.sensor, coarse, fine)) for m in experiment.measurements
    )
    return replace(experiment, model=lambda _: result, measurements=measurements)
