"""Least squares: damped Gauss-Newton steps from many starts at once, in a region, past trials that fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from .region import Region

CONVERGED, UNFINISHED, STUCK = 0, 1, 2
FAILED = 4  # the start itself
DAMPING = 1e-3  # at the start, of the diagonal of J^T J
LARGEST = 1e10
AT_ONCE = 64  # samples up to which values and derivatives of a trial are asked for in one call
POOR = 0.3  # of the decrease that was predicted: below it derivatives that were carried along are found anew


class OtherShape(ValueError):
    """A model whose output does not fit the data."""


class LeastSquares(Protocol):
    """Half the squares of residuals, and a prior: minus the logarithm of a density."""

    def residuals(self, x: Tensor, which: Tensor) -> Tensor:
        """(N, T) at x (N, p) of the starts `which` (N,)."""

    def linearised(self, x: Tensor, which: Tensor, r: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Residuals, and J (N, T, p); `r` where these are known."""

    def prior(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(N,), gradient and diagonal of the second derivative (N, p), which is not negative."""


@dataclass
class Found:
    """Where each start ends: x (S, p), residuals r (S, T), J (S, T, p), status (S,); history (iterations + 1, S, p); what the
    model raised at trials; evaluations of the model, in samples.
    """

    x: Tensor
    r: Tensor
    J: Tensor
    status: Tensor
    history: Tensor
    raised: list[str] = field(default_factory=list)


def search(problem: LeastSquares, x: Tensor, region: Region, iterations: int, tolerance: float,
           known: tuple[Tensor, Tensor] | None = None, progress: Callable[[int, int, float], None] | None = None) -> Found:
    """By the method of Levenberg and Marquardt, each start (S, p) by itself, those that are not done as one batch.

    known     r (S, T) and J (S, T, p) at x;  progress  gets iteration, starts at work, least squares so far

    Few starts have their derivatives at each trial. Those of many are carried along by Broyden's update (1965), and found anew
    where a step does less than they promise, and before a start counts as converged.
    """
    return _Search(problem, x, region, tolerance, known).run(iterations, progress)


class _Search:
    """State of a search: x, r, J of all starts, whether J is that of x (`fresh`), damping, status."""

    def __init__(self, problem: LeastSquares, x: Tensor, region: Region, tolerance: float,
                 known: tuple[Tensor, Tensor] | None) -> None:
        self.problem, self.x, self.region, self.tolerance = problem, x, region, tolerance
        self.raised: list[str] = []
        S = len(x)
        self.status = torch.full((S,), UNFINISHED, device=x.device)
        if known is None:
            self.r, self.J = self._at_starts()
        else:
            self.r, self.J = (k.clone() for k in known)
        self.phi, self.slope, self.bend = problem.prior(x)
        self.damping = torch.full((S,), DAMPING, dtype=x.dtype, device=x.device)
        self.fresh = torch.ones(S, dtype=torch.bool, device=x.device)
        self.blocked = torch.zeros_like(self.fresh)  # steps are small because longer ones fail
        self.history = [x]

    def run(self, iterations: int, progress: Callable[[int, int, float], None] | None) -> Found:
        for k in range(iterations):
            active = (self.status == UNFINISHED).nonzero()[:, 0]
            if progress is not None:
                progress(k, len(active), self.r.square().sum(-1).nan_to_num(nan=torch.inf).amin().item())
            if not len(active):
                break
            self._iterate(active)
            self.history.append(self.x)
        stale = (~self.fresh).nonzero()[:, 0]
        if len(stale):
            self._refresh(stale)
        return Found(self.x, self.r, self.J, self.status, torch.stack(self.history), self.raised)

    def _iterate(self, active: Tensor) -> None:
        """One trial of each active start."""
        x, r, J, damping = self.x[active], self.r[active], self.J[active], self.damping[active]
        self.region.sized(active, r, J)
        region = self.region.of(active)
        gradient = (J.mT @ r[..., None])[..., 0] + self.slope[active]
        step = self._step(x, gradient, J, self.bend[active], damping, region)
        whole = torch.isfinite(step).all(-1)
        trial = torch.where(whole[:, None], region.cut(x, x + step), x)
        at_once = len(active) * (2 * x.shape[1] + 1) <= AT_ONCE
        if at_once:
            r_trial, J_trial = self._tried(lambda a, b: self.problem.linearised(a, b), trial, active, (r, J))
            good = torch.isfinite(J_trial).flatten(1).all(-1)
        else:
            (r_trial,) = self._tried(lambda a, b: (self.problem.residuals(a, b),), trial, active, (r,))
            J_trial, good = _carried(J, r, r_trial, trial - x, region), True
        phi, slope, bend = self.problem.prior(trial)
        before, after = r.square().sum(-1) + 2 * self.phi[active], r_trial.square().sum(-1) + 2 * phi
        failed = ~(torch.isfinite(after) & good)
        lower = (after <= before) & ~failed & whole
        fresh, blocked = self.fresh[active], self.blocked[active]
        blocked = (blocked | failed) & ~(lower & (damping <= 1))
        settled = self._settled(x, trial, before, after, lower)
        moved = (trial - x)
        promised = -((gradient * moved).sum(-1) * 2 + (J @ moved[..., None])[..., 0].square().sum(-1)
                     + (self.bend[active] * moved.square()).sum(-1))
        poor = before - after < POOR * promised
        done = whole & settled & (lower | (moved == 0).all(-1) | (damping <= 1))
        take = lower[:, None]
        self.x = self.x.index_put((active,), torch.where(take, trial, x))
        self.r[active] = torch.where(take, r_trial, r)
        self.J[active] = torch.where(take[..., None], J_trial, J)
        self.phi[active] = torch.where(lower, phi, self.phi[active])
        self.slope[active] = torch.where(take, slope, self.slope[active])
        self.bend[active] = torch.where(take, bend, self.bend[active])
        again = torch.zeros_like(lower)
        if not at_once:
            again = (~fresh & (poor | ~lower | done)) | (fresh & lower & poor & ~done)
        more = torch.where(lower, damping / 10, torch.where(fresh, damping * 10, damping))
        done = done & (at_once | fresh)
        stuck = (done & blocked) | (~done & (more > LARGEST))
        self.damping[active], self.blocked[active] = more, blocked
        self.fresh[active] = (fresh & ~lower) | at_once | done
        self.status[active] = torch.where(stuck, STUCK, torch.where(done, CONVERGED, UNFINISHED))
        if again.any():
            self._refresh(active[again])

    def _step(self, x: Tensor, gradient: Tensor, J: Tensor, bend: Tensor, damping: Tensor, region: Region) -> Tensor:
        """Damped step (N, p), of those parameters that no bound holds."""
        A = J.mT @ J + torch.diag_embed(bend)
        held = region.held(x, gradient)
        free = ~held
        A = A * (free[:, None] & free[..., None]) + torch.diag_embed(held.to(A))
        eps, tiny = torch.finfo(x.dtype).eps, torch.finfo(x.dtype).tiny
        damped = A + torch.diag_embed((damping[:, None] + eps) * A.diagonal(dim1=-2, dim2=-1) + tiny)
        return -torch.linalg.solve_ex(damped, (gradient * free)[..., None])[0][..., 0]

    def _settled(self, x: Tensor, trial: Tensor, before: Tensor, after: Tensor, lower: Tensor) -> Tensor:
        """Whether the step is small, or what it gains."""
        size = torch.where(self.region.additive, 1.0, x.abs() + self.tolerance)
        small = ((trial - x).abs() <= self.tolerance * size).all(-1)
        return small | ((before - after <= self.tolerance**2 * before) & lower)

    def _refresh(self, which: Tensor) -> None:
        """Derivatives anew."""
        _, J = self._tried(lambda a, b: self.problem.linearised(a, b, self.r[b]), self.x[which], which,
                           (self.r[which], self.J[which]))
        good = torch.isfinite(J).flatten(1).all(-1)
        self.J[which] = torch.where(good[:, None, None], J, self.J[which])
        self.fresh[which] = True

    def _at_starts(self) -> tuple[Tensor, Tensor]:
        """r and J at the starts; of those that fail zeros, with the status FAILED. Where all fail, the first error."""
        S = len(self.x)
        every = torch.arange(S, device=self.x.device)
        try:
            r, J = self.problem.linearised(self.x, every)
        except OtherShape:
            raise
        except Exception as error:
            if S == 1:
                raise
            r, J = self._some_starts(every, error)
        good = torch.isfinite(r).all(-1) & torch.isfinite(J).flatten(1).all(-1) & torch.isfinite(self.problem.prior(self.x)[0])
        if not good.any():
            raise ValueError(f"a start ({0} of {S}) at which the model is not finite was given; another is wanted")
        self.status = torch.where(good, self.status, FAILED)
        return torch.where(good[:, None], r, torch.inf), torch.where(good[:, None, None], J, 0)

    def _some_starts(self, every: Tensor, error: Exception) -> tuple[Tensor, Tensor]:
        """At the starts at which the model does not raise; the error where there is none."""
        found: dict[int, tuple[Tensor, Tensor]] = {}

        def look(which: Tensor) -> None:
            try:
                r, J = self.problem.linearised(self.x[which], which)
            except OtherShape:
                raise
            except Exception as said:  # whatever a user's model raises
                if len(which) == 1:
                    self.raised.append(str(said) or type(said).__name__)
                    return
                for half in which.tensor_split(2):
                    look(half)
            else:
                found.update({k: (r[i], J[i]) for i, k in enumerate(which.tolist())})

        for half in every.tensor_split(2):
            look(half)
        if not found:
            raise error
        like = next(iter(found.values()))
        none = tuple(torch.full_like(v, torch.nan) for v in like)
        return tuple(torch.stack([found.get(k, none)[i] for k in every.tolist()]) for i in (0, 1))

    def _tried(self, evaluate: Callable, x: Tensor, which: Tensor, like: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """What a trial gives; NaN of a start at which the model raises, and what it said goes into `raised`."""
        try:
            return evaluate(x, which)
        except OtherShape:
            raise
        except Exception as error:  # whatever a user's model raises
            if len(x) == 1:
                self.raised.append(str(error) or type(error).__name__)
                return tuple(torch.full_like(k[:1], torch.nan) for k in like)
        parts = [self._tried(evaluate, a, b, like) for a, b in zip(x.tensor_split(2), which.tensor_split(2), strict=True)]
        return tuple(torch.cat(some) for some in zip(*parts, strict=True))


def _carried(J: Tensor, r: Tensor, r_trial: Tensor, step: Tensor, region: Region) -> Tensor:
    """Broyden's update: J (N, T, p) changed as little as gives what the step gave, steps in the parameters' sizes."""
    size = torch.where(region.additive, 1.0, torch.where(region.size > 0, region.size, 1.0))
    scaled = step / size**2
    length = (step * scaled).sum(-1)
    off = r_trial - r - (J @ step[..., None])[..., 0]
    return J + off[..., None] * (scaled / torch.where(length > 0, length, 1)[:, None])[:, None]
