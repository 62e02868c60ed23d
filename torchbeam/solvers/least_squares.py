"""Least squares: damped Gauss-Newton steps and L-BFGS from many starts, in a region, past trials that fail."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

Model = Callable[[Tensor], Tensor]  # x (N, p) -> misfits (N, T)
Found = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, list[str]]
"""where each start ends: x (S, p), misfits r (S, T), J (S, T, p), status (S,); history (iterations + 1, S, p); what the model
raised at trials"""
CONVERGED, UNFINISHED, STUCK = 0, 1, 2
DAMPING = 1e-3  # at the start, of the diagonal of J^T J
LARGEST = 1e10
STRIDE = 10.0  # largest change in a step: of a parameter's size; of a logarithm, the largest factor
REACH = 1e9  # largest size on the way, of that at the start; of a logarithm, the largest factor


class OtherShape(ValueError):
    """A model whose output does not fit the data."""


class Region:
    """Where each start may go: from its place by a limited step, never far beyond its own size, within the bounds.

    target  (T,) what the misfits are counted from
    size    (S, p) of the parameters at the start. One that starts at zero has that of a change that moves the model's values
            by their own size, as soon as it moves them at all; until then its steps have no limit
    """

    def __init__(self, start: Tensor, log: bool, least: Tensor | None, largest: Tensor | None, target: Tensor) -> None:
        self.start, self.log, self.least, self.largest, self.target = start, log, least, largest, target
        self.size = start.abs()

    def sized(self, r: Tensor, J: Tensor) -> None:
        """Find sizes that are not known yet, from misfits (S, T) and J (S, T, p)."""
        size = torch.linalg.vector_norm(r + self.target, dim=-1, keepdim=True) / torch.linalg.vector_norm(J, dim=-2)
        self.size = torch.where((self.size == 0) & torch.isfinite(size), size, self.size)

    def of(self, k: int) -> Region:
        """That of start k."""
        one = Region(self.start[k], self.log, self.least, self.largest, self.target)
        one.size = self.size[k]
        return one

    def cut(self, x: Tensor, trial: Tensor) -> Tensor:
        """The trial, or where it leaves the region the nearest there."""
        if self.log:
            stride, centre, reach = math.log(STRIDE), self.start, math.log(REACH)
        else:
            size = torch.where(self.size == 0, torch.inf, self.size)
            stride, centre, reach = STRIDE * torch.maximum(x.abs(), size), 0.0, REACH * size
        trial = x + torch.clamp(trial - x, -stride, stride)
        trial = centre + torch.clamp(trial - centre, -reach, reach)
        return trial if self.least is None else torch.clamp(trial, self.least, self.largest)

    def at_edge(self, x: Tensor) -> Tensor:
        """(S, p) bool: which parameters ran away."""
        if self.log:
            return (x - self.start).abs() >= 0.99 * math.log(REACH)
        return (x.abs() >= 0.99 * REACH * self.size) & (self.size > 0)


def search(seen: Model, x: Tensor, region: Region, derivatives: str, relative_step: float, iterations: int,
           tolerance: float) -> Found:
    """By the method of Levenberg and Marquardt, each start (S, p) by itself, all in one batch."""
    slopes = forward if derivatives == "forward" else difference
    r, J = slopes(seen, x, relative_step)
    good_start(torch.isfinite(r).all(-1) & torch.isfinite(J).flatten(1).all(-1))
    damping = torch.full((len(x),), DAMPING, dtype=x.dtype, device=x.device)
    status = torch.full((len(x),), UNFINISHED, device=x.device)
    blocked = torch.zeros_like(status, dtype=torch.bool)  # steps are small because longer ones fail
    history, raised = [x], []
    for _ in range(iterations):
        region.sized(r, J)
        A = J.mT @ J
        diagonal = A.diagonal(dim1=-2, dim2=-1)
        eps, tiny = torch.finfo(x.dtype).eps, torch.finfo(x.dtype).tiny
        damped = A + torch.diag_embed((damping[:, None] + eps) * diagonal + tiny)
        step = -torch.linalg.solve_ex(damped, (J.mT @ r[..., None]))[0][..., 0]
        whole = torch.isfinite(step).all(-1) & (status == UNFINISHED)
        trial = torch.where(whole[:, None], region.cut(x, x + step), x)
        r_trial, J_trial = _tried(slopes, seen, trial, relative_step, (r, J), raised)
        before, after = r.square().sum(-1), r_trial.square().sum(-1)
        failed = ~(torch.isfinite(after) & torch.isfinite(J_trial).flatten(1).all(-1))
        lower = (after <= before) & ~failed & whole
        blocked = (blocked | failed) & ~(lower & (damping <= 1))
        step = (trial - x).abs()
        settled = (step <= tolerance * (x.abs() + tolerance)).all(-1) | (before - after <= tolerance**2 * before) & lower
        done = whole & settled & (lower | (step == 0).all(-1) | (damping <= 1))
        x = torch.where(lower[:, None], trial, x)
        r = torch.where(lower[:, None], r_trial, r)
        J = torch.where(lower[:, None, None], J_trial, J)
        damping = torch.where(lower, damping / 10, damping * 10)
        stuck = (done & blocked) | ((status == UNFINISHED) & ~done & (damping > LARGEST))
        status = torch.where(stuck, STUCK, torch.where(done, CONVERGED, status))
        history.append(x)
        if (status != UNFINISHED).all():
            break
    return x, r, J, status, torch.stack(history), raised


def good_start(good: Tensor) -> None:
    """ValueError where a start (S,) is not good."""
    if not good.all():
        raise ValueError(f"a start ({int((~good).nonzero()[0, 0])} of {len(good)}) at which the model is not finite was given; "
                         "another is wanted")


def descend(model: Model, start: Tensor, region: Region, iterations: int, tolerance: float) -> Found:
    """By L-BFGS (Liu and Nocedal 1989) with strong Wolfe conditions, each start by itself; no first move is longer than the
    parameters' own size.
    """
    raised: list[str] = []
    region.size = torch.where(region.size == 0, _size(start), region.size)
    found = [_descend(model, x, region.of(k), iterations, tolerance, raised) for k, x in enumerate(start)]
    length = max(len(way) for _, way in found)
    ways = [torch.cat((w, w[-1:].expand(length - len(w), -1))) for _, w in found]
    x = torch.stack([w[-1] for w in ways])
    return x, *forward(model, x, 0.0), torch.tensor([s for s, _ in found], device=x.device), torch.stack(ways, 1), raised


def _descend(model: Model, start: Tensor, region: Region, iterations: int, tolerance: float,
             raised: list[str]) -> tuple[int, Tensor]:
    """Status and way (k, p) of one start (p,). To the line search a trial that leaves the region, or at which the model raises
    or is not finite, is one at which the squares have grown, with the distance.
    """
    size = _size(start)
    scaled = (start / size).requires_grad_()
    search = torch.optim.LBFGS([scaled], max_iter=1, max_eval=25, tolerance_grad=0, tolerance_change=0,
                               line_search_fn="strong_wolfe")
    here, way, rejected = scaled.detach().clone(), [start], False

    def squares(trial: Tensor) -> Tensor:
        """Of one trial, with its gradient in `scaled.grad`."""
        search.zero_grad()
        with torch.enable_grad():
            value = model((trial * size)[None]).square().sum()
            value.backward()
        return value.detach()

    scale = squares(scaled) + torch.finfo(start.dtype).tiny
    good_start(torch.isfinite(scale)[None])

    def closure() -> Tensor:
        nonlocal rejected
        at, value = scaled.detach() * size, None
        if torch.allclose(region.cut(here * size, at), at, rtol=1e-9, atol=0):
            try:
                value = squares(scaled) / scale
            except OtherShape:
                raise
            except Exception as error:  # whatever a user's model raises
                raised.append(str(error) or type(error).__name__)
        if value is not None and torch.isfinite(value) and torch.isfinite(scaled.grad).all():
            scaled.grad /= scale
            return value
        rejected, away = True, scaled.detach() - here
        length = torch.linalg.vector_norm(away)
        scaled.grad = away / length
        return 10 + length  # the squares at the start are 1, and never grow

    for _ in range(iterations):
        rejected = False
        search.step(closure)
        way.append(scaled.detach() * size)
        moved, here = (scaled.detach() - here).abs().amax(), scaled.detach().clone()
        if moved <= tolerance * (here.abs().amax() + tolerance):
            return STUCK if rejected else CONVERGED, torch.stack(way)
    return UNFINISHED, torch.stack(way)


def _size(start: Tensor) -> Tensor:
    return torch.where(start.abs() > 1e-3, start.abs(), torch.ones_like(start))


def _tried(slopes: Callable, seen: Model, x: Tensor, relative_step: float, known: tuple[Tensor, Tensor],
           raised: list[str]) -> tuple[Tensor, Tensor]:
    """Misfit and Jacobian; of a start at which the model raises, NaN, and what it said goes into `raised`."""
    try:
        return slopes(seen, x, relative_step)
    except OtherShape:
        raise
    except Exception as error:  # whatever a user's model raises
        if len(x) == 1:
            raised.append(str(error) or type(error).__name__)
            return tuple(torch.full_like(k[:1], torch.nan) for k in known)
    half = len(x) // 2
    parts = [_tried(slopes, seen, part, relative_step, known, raised) for part in (x[:half], x[half:])]
    return tuple(torch.cat(pair) for pair in zip(*parts, strict=True))


def forward(seen: Model, x: Tensor, _: float) -> tuple[Tensor, Tensor]:
    """Misfit and Jacobian by forward mode, direction j of start s being sample s p + j of one batch."""
    S, p = x.shape
    directions = torch.eye(p, dtype=x.dtype, device=x.device).repeat(S, 1)
    value, slope = torch.func.jvp(seen, (x.repeat_interleave(p, 0),), (directions,))
    return value.unflatten(0, (S, p))[:, 0], slope.unflatten(0, (S, p)).mT


def difference(seen: Model, x: Tensor, relative: float) -> tuple[Tensor, Tensor]:
    """Misfit and Jacobian by central differences, all in one batch."""
    S, p = x.shape
    size = relative * torch.where(x.abs() > 1e-3, x.abs(), torch.ones_like(x))
    shift = torch.diag_embed(size)  # (S, p, p)
    values = seen(torch.cat((x[:, None], x[:, None] + shift, x[:, None] - shift), 1).flatten(0, 1)).unflatten(0, (S, 2 * p + 1))
    return values[:, 0], ((values[:, 1:p + 1] - values[:, p + 1:]) / (2 * size[..., None])).mT
