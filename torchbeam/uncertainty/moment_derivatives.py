"""Derivatives of moments by the parameters of laws, sample by sample (pathwise)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from ..core.arguments import boolean, level_of
from ..core.arguments import function as checked_function
from ..core.repetition import one_of
from ..core.validation import Value, as_tensor, finite, refusal
from ..core.warning import warn
from .called import Function, called
from .designs import Sobol
from .estimate import Estimate, student_half
from .evaluation import points_of, settings
from .joint_law import Correlation, JointLaw
from .laws import Law
from .samples import reasons_of

TRIED = 8  # samples whose derivatives are looked at beside differences
# of a derivative by which it may differ from the difference; and of y/q, what is too small to see
CARRIED, SEEN = 0.1, 1e-3


@dataclass(frozen=True)
class MomentDerivatives:
    """Moments of y (...) and their derivatives by the parameters q (m,) of the laws: `Estimate`s.

    Args:
        mean, deviation: (...) moments
        mean_by, deviation_by: (m, ...) their derivatives

    Examples:
        >>> def scatter(q):
        ...     return {"EI": tb.laws.LogNormal(q[0], q[1]), "P": laws["P"]}
        >>> by = tb.moment_derivatives(
        ...     deflection, scatter, torch.tensor([1.0, 0.1]), 256, by_name=True
        ... )
        >>> by.mean_by.estimate  # of the mean, by mean and deviation of EI
        tensor([-0.3420,  0.0600])
    """

    mean: Estimate
    deviation: Estimate
    mean_by: Estimate
    deviation_by: Estimate

    def __repr__(self) -> str:
        return (
            f"MomentDerivatives(mean {self.mean!r}; by {self.mean_by.estimate.shape[0]} parameters)"
        )


def moment_derivatives(
    function: Function,
    laws: Callable[[Tensor], Mapping[str, Law]],
    q: Value,
    n: int,
    *,
    replicates: int = 16,
    interval: float = 0.95,
    correlation: Correlation | None = None,
    seed: int = 0,
    chunk: int = 256,
    by_name: bool = False,
) -> MomentDerivatives:
    """Mean and standard deviation of y, and their derivatives by parameters of the laws, such as
    the deviation of a stiffness.

    Args:
        function: as in `monte_carlo`, and differentiable by theta
        laws: q (m,) -> dict of laws, differentiable, such as lambda q: {"EI":
            torch.distributions.Normal(q[0], q[1])}, or a function of u
        q: (m,) point of the derivatives
        n, replicates, correlation, seed, chunk, by_name: as in `monte_carlo`; n is a multiple of
            the replicates

    theta = F^-1(u; q) at fixed u, so that d mean/dq = mean(dy/dtheta dtheta/dq): pathwise
    derivatives (Glasserman 2003, section 7.2). y must be continuous in theta. It is computed in
    this process, in the dtype of q. Failed samples count neither in values nor in derivatives.

    Raises:
        ValueError: as `monte_carlo`, and for a y without gradient. Also for a wrong gradient of
            the first samples, by differences: a part of a law or the function computes with NumPy.

    Examples:
        >>> def scatter(q):
        ...     return {"EI": tb.laws.LogNormal(q[0], q[1]), "P": laws["P"]}
        >>> by = tb.moment_derivatives(
        ...     deflection, scatter, torch.tensor([1.0, 0.1]), 256, by_name=True
        ... )
        >>> by.deviation_by.estimate  # of the deviation, by each of q
        tensor([-0.0692,  0.2311])
    """
    level = level_of("interval", interval)
    checked_function("laws", laws, "q")
    boolean("by_name", by_name)
    q = finite("q", as_tensor(q, torch.float64))
    if q.ndim != 1 or not q.numel():
        raise refusal(f"q {tuple(q.shape)}", "(m,)")
    q = q.detach().clone().requires_grad_()
    joint = JointLaw.of(laws(q), correlation)
    n, seed, chunk, _ = settings(function, n, seed, chunk, None, None, None)
    points = points_of(n, replicates, fewest=2, least=2)
    plan = Sobol(joint.dimension, seed, points)
    u = plan.uniform(0, min(TRIED, points))
    _refuse_a_part(
        lambda q: JointLaw.of(laws(q), correlation).of_uniform(u).to(q.dtype),
        lambda theta: called(function, joint, theta, by_name)[:2],
        q,
    )
    sums, reached, about = [], [], None
    for k in range(replicates):
        parts = []
        for first in range(k * points, (k + 1) * points, chunk):
            last = min(first + chunk, (k + 1) * points)
            joint = JointLaw.of(laws(q), correlation)  # a graph of its own
            with one_of(n / (last - first)):
                part, *answers, about = _sums(function, joint, plan, first, last, q, by_name, about)
            parts.append(part)
            reached.append(answers)
        sums.append(tuple(map(sum, zip(*parts, strict=True))))
    reasons = reasons_of(*(torch.cat(part) for part in zip(*reached, strict=True)), {})
    return _derivatives(sums, about, n, level, reasons)


def _derivatives(
    sums: list[tuple[Tensor, ...]],
    about: Tensor | None,
    n: int,
    level: float,
    reasons: dict[str, int],
) -> MomentDerivatives:
    """Of the sums of replicates, see `_sums`; ValueError where most of n samples failed."""
    good = [total for total in sums if total[0] > 1]
    if len(good) < 2:
        raise ValueError(
            f"nearly all {n} samples failed ({', '.join(reasons)}); there are no moments of so few"
        )
    each = [torch.stack(part) for part in zip(*map(_moments, good), strict=True)]
    pooled = list(_moments(tuple(sum(part) for part in zip(*sums, strict=True))))
    pooled[0] = pooled[0] + about
    samples = int(sum(total[0] for total in sums))
    halves = [student_half(scatter, level) for scatter in each]
    rest = level, samples, f"{len(good)} replicates", reasons
    pairs = zip(pooled, halves, strict=True)
    return MomentDerivatives(*(Estimate.about(*pair, *rest) for pair in pairs))


def _refuse_a_part(
    theta: Callable[[Tensor], Tensor], answer: Callable[[Tensor], tuple[Tensor, Tensor]], q: Tensor
) -> None:
    """Raises ValueError where the derivative of samples' y that is carried is not that of their
    values, by central differences: of a sum of all numbers with weights of their own.
    """
    y, status = answer(theta(q))
    if not y.requires_grad:
        return  # `_sums` says so, as where nothing of q is in y
    scale = torch.where(q == 0, 1.0, q.abs()).detach()
    step = torch.finfo(q.dtype).eps ** (1 / 3) * scale
    moved = [answer(theta((q + x).detach())) for x in (*torch.diag(step), *torch.diag(-step))]
    beside = torch.stack([y for y, _ in moved]).detach().reshape(2, len(q), *y.shape)
    failed = torch.stack([status for _, status in moved])
    good = (status == 0) & (failed == 0).all(0)
    weight = torch.cos(torch.arange(y.numel()).to(y)).reshape(y.shape)
    weight = torch.where(good.reshape(-1, *(1,) * (y.ndim - 1)), weight, 0.0)
    (carried,) = torch.autograd.grad((weight * y.nan_to_num()).sum(), q, allow_unused=True)
    if carried is None:
        return
    change = (weight * (beside[0] - beside[1])).nan_to_num().flatten(1).sum(1)
    seen, size = change.to(q) / (2 * step), (weight * y.detach()).nan_to_num().abs().sum().to(q)
    largest = torch.maximum(carried.abs(), seen.abs())
    off = (carried - seen).abs() > CARRIED * largest + SEEN * size / scale
    if off.any():
        k = int(off.nonzero()[0])
        raise ValueError(
            f"a y whose gradient by q[{k}] is {carried[k].item():.3g} where its values change by "
            f"{seen[k].item():.3g} was given; laws and a function of torch operations are wanted"
        )


def _sums(
    function: Function,
    joint: JointLaw,
    plan: Sobol,
    first: int,
    last: int,
    q: Tensor,
    by_name: bool,
    about: Tensor | None,
) -> tuple[tuple[Tensor, ...], Tensor, Tensor, Tensor | None]:
    """Number of good samples; sums of d = y - about and of d^2 (...), and of their derivatives
    (m, ...); y and status of all; about (...), the mean of the first chunk that has good samples:
    squares of y itself cancel where its mean is large.
    """
    theta = joint.of_uniform(plan.uniform(first, last)).to(q.dtype)
    y, status, doubt = called(function, joint, theta, by_name, first)
    if doubt:
        warn(doubt)
    good = y[status == 0].double()
    about = good.detach().mean(0) if about is None and len(good) else about
    values = (good if about is None else good - about).reshape(len(good), math.prod(y.shape[1:]))
    moments = (values.sum(0), values.square().sum(0))

    def slopes(moment: Tensor) -> list[Tensor | None]:
        by = partial(torch.autograd.grad, inputs=q, retain_graph=True, allow_unused=True)
        return [by(number)[0] for number in moment.unbind()]

    by = [slopes(moment) for moment in moments] if y.requires_grad else [[None]]
    if all(part is None for part in by[0]):
        raise ValueError(
            "a function whose y carries no gradient by q was given; one of torch operations, and "
            "laws that depend on q, are wanted"
        )
    by = [
        torch.stack([torch.zeros_like(q) if part is None else part for part in moment], -1)
        for moment in by
    ]
    shape = y.shape[1:]
    sums = (
        torch.tensor(float(len(values)), dtype=torch.float64),
        *(m.detach().reshape(shape) for m in moments),
        *(b.double().reshape(len(q), *shape) for b in by),
    )
    return sums, y.detach().cpu(), status.cpu(), about


def _moments(sums: tuple[Tensor, ...]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mean of d, deviation and their derivatives, of sums."""
    n, total, squares, total_by, squares_by = sums
    mean, mean_by = total / n, total_by / n
    # over n: the mean of a Sobol sequence is that of the law but for little
    variance = squares / n - mean.square()
    variance_by = squares_by / n - 2 * mean * mean_by
    deviation = variance.clamp_min(0).sqrt()
    # of a number that does not vary, as at an instant at rest: neither does its deviation
    still = deviation == 0
    slope = variance_by / torch.where(still, 1.0, 2 * deviation)
    return mean, deviation, mean_by, torch.where(still, 0.0, slope)
