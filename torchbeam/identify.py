"""identify: parameters of a model from data, by damped Gauss-Newton steps, many starts at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .checks import Value, as_tensor, common_dtype, count, finite, positive

Model = Callable[[Tensor], Tensor]  # theta (N, p) -> y (N, ...)
CONVERGED, UNFINISHED, STUCK = 0, 1, 2
REASON = {CONVERGED: "converged", UNFINISHED: "more iterations are wanted", STUCK: "no step makes the misfit smaller"}
DERIVATIVES = ("forward", "difference", "adjoint")
DAMPING = 1e-3  # at the start, of the diagonal of J^T J
LARGEST = 1e10


@dataclass(frozen=True)
class Fit:
    """What was found, from the best of the starts.

    theta       (p,) the parameters;  names (p,)
    covariance  (p, p) of the parameters: sigma^2 (J^T J)^-1, first order, where sigma is that given or else the misfit's own
                over T - p degrees of freedom; deviation (p,) the roots of its diagonal, correlation (p, p). Parameters that the
                data do not tell apart have huge deviations and a correlation near 1 or -1
    y           (...) the model there, as the data;  misfit: RMS of y - data (over sigma, where given)
    status      0 = converged, 1 = more iterations are wanted, 2 = no step makes the misfit smaller
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

    @property
    def deviation(self) -> Tensor:
        return self.covariance.diagonal().sqrt()

    @property
    def correlation(self) -> Tensor:
        return self.covariance / (self.deviation[:, None] * self.deviation)

    def __repr__(self) -> str:
        found = ", ".join(f"{n} = {v:.5g} +- {d:.2g}" for n, v, d in
                          zip(self.names, self.theta.tolist(), self.deviation.tolist(), strict=True))
        return f"Fit({found}; misfit {self.misfit.item():.3g}, {REASON[self.status]} in {self.iterations})"


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
    each start by itself; a start whose model is not finite shortens its step. (Nocedal and Wright 2006, section 10.3.)

    Raises ValueError for a model whose output does not fit the data, a start at which it is not finite, fewer data than
    parameters.
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
            raise ValueError(f"a model that gave {tuple(y.shape)} for theta {tuple(x.shape)} was given; "
                             f"{(len(x), *data.shape)} is wanted")
        return ((y - data) * weight)[:, known]

    first, limit = start.log() if log else start, count("iterations", iterations)
    with torch.no_grad():
        if derivatives == "adjoint":
            x, r, J, statuses, history = _descend(seen, first, limit, tolerance)
        else:
            x, r, J, statuses, history = _search(seen, first, least, largest, derivatives, relative_step, limit, tolerance)
        squares = r.square().sum(-1)
        best = int(torch.where(torch.isfinite(squares), squares, torch.inf).argmin())
        scale = 1.0 if sigma is not None else squares[best] / max(r.shape[1] - p, 1)
        covariance = scale * _inverse(J[best].mT @ J[best])
        theta = x.exp() if log else x
        if log:
            covariance = theta[best][:, None] * covariance * theta[best]
        y = model(theta[best][None])[0]
    misfits = (squares / r.shape[1]).sqrt()
    return Fit(theta[best], names, covariance, y, misfits[best], int(statuses[best]), len(history) - 1,
               history.exp() if log else history, theta, misfits, statuses)


def _inverse(A: Tensor) -> Tensor:
    """Of a symmetric matrix without negative eigenvalues; where it is singular to rounding, its largest meaningful one."""
    size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).rsqrt()
    values, vectors = torch.linalg.eigh(size[:, None] * A * size)
    return size[:, None] * (vectors / values.clamp(min=torch.finfo(A.dtype).eps * values.amax()) @ vectors.mT) * size


def _search(seen: Model, x: Tensor, least: Any, largest: Any, derivatives: str, relative_step: float, iterations: int,
            tolerance: float) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Where each start ends: x (S, p), r (S, T), J (S, T, p), status (S,), history."""
    slopes = _forward if derivatives == "forward" else _difference
    r, J = slopes(seen, x, relative_step)
    if not torch.isfinite(r).all() or not torch.isfinite(J).all():
        bad = (~(torch.isfinite(r).all(-1) & torch.isfinite(J).flatten(1).all(-1))).nonzero()[0, 0]
        raise ValueError(f"a start ({int(bad)} of {len(x)}) at which the model is not finite was given; another is wanted")
    damping = torch.full((len(x),), DAMPING, dtype=x.dtype, device=x.device)
    status = torch.full((len(x),), UNFINISHED, device=x.device)
    history = [x]
    for _ in range(iterations):
        A = J.mT @ J
        diagonal = A.diagonal(dim1=-2, dim2=-1)
        floor = torch.finfo(x.dtype).eps * diagonal.amax(-1, keepdim=True) + torch.finfo(x.dtype).tiny
        damped = A + torch.diag_embed(damping[:, None] * diagonal + floor)
        trial = x - torch.linalg.solve_ex(damped, (J.mT @ r[..., None]))[0][..., 0]
        trial = torch.clamp(trial, least, largest) if least is not None else trial
        trial = torch.where((status == UNFINISHED)[:, None] & torch.isfinite(trial), trial, x)
        r_trial, J_trial = slopes(seen, trial, relative_step)
        before, after = r.square().sum(-1), r_trial.square().sum(-1)
        lower = (after <= before) & torch.isfinite(J_trial).flatten(1).all(-1) & (status == UNFINISHED)
        step = (trial - x).abs()
        settled = (step <= tolerance * (x.abs() + tolerance)).all(-1) | (before - after <= tolerance**2 * before) & lower
        done = (status == UNFINISHED) & settled & (lower | (step == 0).all(-1) | (damping <= 1))
        x = torch.where(lower[:, None], trial, x)
        r = torch.where(lower[:, None], r_trial, r)
        J = torch.where(lower[:, None, None], J_trial, J)
        damping = torch.where(lower, damping / 10, damping * 10)
        status = torch.where(done, CONVERGED, torch.where((status == UNFINISHED) & (damping > LARGEST), STUCK, status))
        history.append(x)
        if (status != UNFINISHED).all():
            break
    return x, r, J, status, torch.stack(history)


def _descend(seen: Model, x: Tensor, iterations: int, tolerance: float) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """The same by L-BFGS (Liu and Nocedal 1989) with strong Wolfe conditions, each start by itself; no move is longer than
    the first wants to be, the parameters' own size.
    """
    ends, statuses, ways = [], [], []
    for start in x:
        size = torch.where(start.abs() > 1e-3, start.abs(), torch.ones_like(start))
        scaled = (start / size).requires_grad_()
        search = torch.optim.LBFGS([scaled], max_iter=1, max_eval=25, tolerance_grad=0, tolerance_change=0,
                                   line_search_fn="strong_wolfe")
        scale, way, status = None, [start], UNFINISHED

        def squares(scaled: Tensor = scaled, size: Tensor = size, search: Any = search) -> Tensor:
            nonlocal scale
            search.zero_grad()
            with torch.enable_grad():
                value = seen((scaled * size)[None]).square().sum()
                scale = value.detach() if scale is None else scale
                value = value / (scale + torch.finfo(value.dtype).tiny)
                value.backward()
            return value

        for _ in range(iterations):
            before = scaled.detach().clone()
            search.step(squares)
            way.append(scaled.detach() * size)
            if (scaled.detach() - before).abs().amax() <= tolerance * (before.abs().amax() + tolerance):
                status = CONVERGED
                break
        ends.append(way[-1])
        statuses.append(status)
        ways.append(torch.stack(way))
    length = max(map(len, ways))
    ways = [torch.cat((w, w[-1:].expand(length - len(w), -1))) for w in ways]
    x = torch.stack(ends)
    return x, *_forward(seen, x, 0.0), torch.tensor(statuses, device=x.device), torch.stack(ways, 1)


def _forward(seen: Model, x: Tensor, _: float) -> tuple[Tensor, Tensor]:
    """Misfit and Jacobian by forward mode, direction j of start s being sample s p + j of one batch."""
    S, p = x.shape
    directions = torch.eye(p, dtype=x.dtype, device=x.device).repeat(S, 1)
    value, slope = torch.func.jvp(seen, (x.repeat_interleave(p, 0),), (directions,))
    return value.unflatten(0, (S, p))[:, 0], slope.unflatten(0, (S, p)).mT


def _difference(seen: Model, x: Tensor, relative: float) -> tuple[Tensor, Tensor]:
    """Misfit and Jacobian by central differences, all in one batch."""
    S, p = x.shape
    size = relative * torch.where(x.abs() > 1e-3, x.abs(), torch.ones_like(x))
    shift = torch.diag_embed(size)  # (S, p, p)
    values = seen(torch.cat((x[:, None], x[:, None] + shift, x[:, None] - shift), 1).flatten(0, 1)).unflatten(0, (S, 2 * p + 1))
    return values[:, 0], ((values[:, 1:p + 1] - values[:, p + 1:]) / (2 * size[..., None])).mT
