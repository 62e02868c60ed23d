"""Identification: parameters of a model from data, by damped Gauss-Newton steps from several starts at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.arguments import count
from ..core.validation import Value, as_tensor, common_dtype, finite, positive
from ..solvers.least_squares import CONVERGED, STUCK, UNFINISHED, OtherShape, Region, descend, search

Model = Callable[[Tensor], Tensor]  # theta (N, p) -> y (N, ...)
UNIDENTIFIABLE = 3
REASON = {CONVERGED: "converged", UNFINISHED: "more iterations are wanted", STUCK: "no step makes the misfit smaller",
          UNIDENTIFIABLE: "not identifiable"}
DERIVATIVES = ("forward", "difference", "adjoint")


@dataclass(frozen=True)
class Fit:
    """Result of `identify`, from the best of the starts.

    theta       (p,) the parameters;  names (p,)
    covariance  (p, p) of the parameters: sigma^2 (J^T J)^-1, first order, where sigma is that given or else the misfit's own
                over T - p degrees of freedom; deviation (p,) the roots of its diagonal, correlation (p, p). Parameters that the
                data do not tell apart have huge deviations and a correlation near 1 or -1
    y           (...) the model there, as the data;  misfit: RMS of y - data (over sigma, where given)
    status      0 = converged, 1 = more iterations are wanted, 2 = no step makes the misfit smaller, 3 = not identifiable:
                the data do not say where parameters are, and theta is no estimate of these
    unidentifiable  a sentence for each parameter that ran away, 1e9 times its start, and for each direction in which the
                parameters can change by their own size while the misfit stays; empty where all are determined
    message     the status in words, with these sentences, and what the model raised at trials
    iterations  evaluations of the model and its derivatives, less the first
    history     (iterations + 1, starts, p) the parameters on the way
    starts      (starts, p) where each start ended;  misfits (starts,) with what misfit, statuses (starts,)
    """

    theta: Tensor
    names: tuple[str, ...]
    covariance: Tensor
    y: Tensor
    misfit: Tensor
    status: int
    iterations: int
    history: Tensor
    starts: Tensor
    misfits: Tensor
    statuses: Tensor
    unidentifiable: tuple[str, ...] = ()
    message: str = ""

    @property
    def deviation(self) -> Tensor:
        return self.covariance.diagonal().sqrt()

    @property
    def correlation(self) -> Tensor:
        return self.covariance / (self.deviation[:, None] * self.deviation)

    def __repr__(self) -> str:
        found = ", ".join(f"{n} = {v:.5g} +- {d:.2g}" for n, v, d in
                          zip(self.names, self.theta.tolist(), self.deviation.tolist(), strict=True))
        return f"Fit({found}; misfit {self.misfit.item():.3g}, {REASON[self.status]} in {self.iterations}" + (
            f"; {'; '.join(self.unidentifiable)}" if self.unidentifiable else "") + ")"


def identify(model: Model, data: Value, start: Value, *, log: bool = False, bounds: tuple[Value, Value] | None = None,
             sigma: Value | None = None, names: Sequence[str] | None = None, derivatives: str = "forward",
             relative_step: float = 1e-5, iterations: int = 50, tolerance: float = 1e-6) -> Fit:
    """Parameters theta for which model(theta) is nearest to the data, in the sum of squares.

    model        theta (N, p) -> y (N, ...), batched: sample i of y depends on row i of theta alone
    data         (...) as y without its first axis; NaN where nothing was measured
    start        (p,), or (starts, p) to be followed all at once, as one batch: the best end counts
    log          search in log theta (theta is positive): for stiffness, mass and damping
    bounds       (least, largest) of theta, (p,) each: a step that leaves them is cut
    sigma        (...) standard deviation of the data: weights them, and scales the covariance
    derivatives  "forward": forward mode, the p directions as a batch; "difference": central differences of `relative_step`,
                 for models without derivatives: a batch of p, or 2 p + 1, times the starts. "adjoint": the gradient of the
                 squares by reverse mode, whatever p, and L-BFGS (torch.optim) in place of Gauss-Newton, for p beyond some
                 tens; it takes more iterations, one start after the other, no bounds, and one "forward" in the end
    tolerance    of the largest step, relative to theta (with `log` of log theta); also, squared, of the decrease of the squares

    Levenberg's and Marquardt's method: (J^T J + lambda diag(J^T J)) step = -J^T r, lambda raised until the squares go down,
    each start by itself. (Nocedal and Wright 2006, section 10.3.) No step changes a parameter by more than ten times its size
    (with `log`: by a factor of more than ten), or takes it beyond 1e9 times its start. A trial at which the model raises or is
    not finite is a step that is not taken: a shorter one is tried.

    A parameter that ran away is named in `unidentifiable`, and so are parameters, or changes of several together, that change
    the misfit by no more than `tolerance` of itself, or than rounding, where they change by their own size. The status is then
    never 0.

    Raises ValueError for a model whose output does not fit the data, a start at which it is not finite, fewer data than
    parameters; what the model raises at a start goes through.
    """
    dtype, device = common_dtype(start, data)
    start = finite("start", as_tensor(start, dtype, device))
    start = start[None] if start.ndim == 1 else start
    if start.ndim != 2:
        raise ValueError(f"a start of shape {tuple(start.shape)} was given; (p,) or (starts, p) is wanted")
    if derivatives not in DERIVATIVES:
        raise ValueError(f"derivatives = {derivatives!r} was given; {' or '.join(map(repr, DERIVATIVES))} is wanted")
    p = start.shape[1]
    names = tuple(names) if names is not None else tuple(f"theta[{i}]" for i in range(p))
    if len(names) != p:
        raise ValueError(f"{len(names)} names were given for {p} parameters")
    data = as_tensor(data, dtype, device)
    known = ~torch.isnan(data)
    if known.sum() < p:
        raise ValueError(f"{int(known.sum())} data were given for {p} parameters; at least as many are wanted")
    weight = torch.ones_like(data) if sigma is None else 1 / positive("sigma", as_tensor(sigma, dtype, device)).expand_as(data)
    if bounds is not None and derivatives == "adjoint":
        raise ValueError("bounds were given with derivatives = 'adjoint', which takes none; 'forward' does")
    least, largest = (None, None) if bounds is None else (as_tensor(b, dtype, device) for b in bounds)
    if log:
        positive("start", start)
        least, largest = (None, None) if bounds is None else (positive("bounds", least, zero=True).log(), largest.log())

    def seen(x: Tensor) -> Tensor:
        """Weighted misfits (N, T) of the searched parameters (N, p)."""
        y = model(x.exp() if log else x)
        if y.shape[1:] != data.shape or y.shape[0] != x.shape[0]:
            raise OtherShape(f"a model that gave {tuple(y.shape)} for theta {tuple(x.shape)} was given; "
                              f"{(len(x), *data.shape)} is wanted")
        return ((y - data) * weight)[:, known]

    first, limit = start.log() if log else start, count("iterations", iterations)
    region = Region(first, log, least, largest, (data * weight)[known])
    with torch.no_grad():
        if derivatives == "adjoint":
            x, r, J, statuses, history, raised = descend(seen, first, region, limit, tolerance)
        else:
            x, r, J, statuses, history, raised = search(seen, first, region, derivatives, relative_step, limit, tolerance)
        squares = r.square().sum(-1)
        best = int(torch.where(torch.isfinite(squares), squares, torch.inf).argmin())
        scale = 1.0 if sigma is not None else squares[best] / max(r.shape[1] - p, 1)
        covariance = scale * _inverse(J[best].mT @ J[best])
        theta = x.exp() if log else x
        if log:
            covariance = theta[best][:, None] * covariance * theta[best]
        y = model(theta[best][None])[0]
        region.sized(r, J)
        rounding = torch.finfo(dtype).eps / (relative_step if derivatives == "difference" else 1)
        least_seen = torch.maximum(tolerance * torch.linalg.vector_norm(r, dim=-1),
                                   rounding * torch.linalg.vector_norm(r + region.target, dim=-1))
        J_size = torch.nan_to_num(J * (1 if log else torch.maximum(x.abs(), region.size)[:, None]))
        shown = [_undetermined(names, *each) for each in zip(theta, start, region.at_edge(x), J_size, least_seen, strict=True)]
        statuses = torch.where(torch.tensor([bool(t) for t in shown], device=x.device), UNIDENTIFIABLE, statuses)
    misfits, status = (squares / r.shape[1]).sqrt(), int(statuses[best])
    message = "; ".join((REASON[status], *shown[best], *([f"at {len(raised)} trials the model raised, last {raised[-1]!r}"]
                                                        if raised else [])))
    return Fit(theta[best], names, covariance, y, misfits[best], status, len(history) - 1,
               history.exp() if log else history, theta, misfits, statuses, shown[best], message)


def _undetermined(names: tuple[str, ...], theta: Tensor, start: Tensor, away: Tensor, J: Tensor, least: Tensor
                  ) -> tuple[str, ...]:
    """Parameters that the data do not determine where one start ended, from J (T, p) by the parameters' own sizes: those that
    ran `away`, (p,) bool; those that change the weighted values by no more than `least`; changes of several that do so.
    """
    change = torch.linalg.vector_norm(J, dim=0)
    said = [f"{names[j]} ran away, from {start[j].item():.4g} to {theta[j].item():.4g}" for j in _true(away)]
    said += [f"the misfit does not change with {names[j]} (here {theta[j].item():.4g})"
             for j in _true((change <= least) & ~away)]
    some = _true((change > least) & ~away)
    if len(some) > 1:
        _, singular, directions = torch.linalg.svd(J[:, some] / change[some], full_matrices=False)
        directions = directions / change[some]
        length = torch.linalg.vector_norm(directions, dim=-1)
        open_ = (singular <= torch.finfo(J.dtype).eps ** 0.5) | (singular / length <= least)
        for direction in (directions / length[:, None])[open_]:
            parts = _true(direction.abs() > 0.1)
            shares = (100 * direction * direction[parts[0]].sign()).tolist()
            together = ", ".join(f"{names[some[j]]} {shares[j]:+.0f} %" for j in parts)
            said.append(f"the misfit does not change where these change together: {together}")
    return tuple(said)


def _true(mask: Tensor) -> list[int]:
    return mask.nonzero()[:, 0].tolist()


def _inverse(A: Tensor) -> Tensor:
    """Of a symmetric matrix without negative eigenvalues; where it is singular to rounding, its largest meaningful one."""
    size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).rsqrt()
    values, vectors = torch.linalg.eigh(size[:, None] * A * size)
    return size[:, None] * (vectors / values.clamp(min=torch.finfo(A.dtype).eps * values.amax()) @ vectors.mT) * size
