"""Least squares: damped Gauss-Newton steps from many starts at once, in a region, past trials that
fail. `Points` are where its starts are: values, derivatives and prior there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from ..math.dense import solve_unchecked
from .region import Region


@dataclass
class Points:
    """Where starts are: x (N, p), residuals r (N, T), J (N, T, p); minus the logarithm of the prior
    phi (N,), its gradient and curvature slope, bend (N, p).
    """

    x: Tensor
    r: Tensor
    J: Tensor
    phi: Tensor
    slope: Tensor
    bend: Tensor

    def of(self, which: Tensor) -> Points:
        return Points(*(v[which] for v in vars(self).values()))

    def put(self, which: Tensor, moved: Points) -> None:
        """The starts `which` are where they have moved to."""
        self.x = self.x.index_put((which,), moved.x)  # anew: the history has the one before
        for name in ("r", "J", "phi", "slope", "bend"):
            getattr(self, name)[which] = getattr(moved, name)

    @property
    def objective(self) -> Tensor:
        """(N,) squares, with the prior's part."""
        return self.r.square().sum(-1) + 2 * self.phi

    @property
    def gradient(self) -> Tensor:
        """(N, p) of half the objective."""
        return (self.J.mT @ self.r[..., None])[..., 0] + self.slope

    def promised(self, step: Tensor) -> Tensor:
        """(N,) decrease of the objective by steps (N, p), were the model linear."""
        return -(
            (self.gradient * step).sum(-1) * 2
            + (self.J @ step[..., None])[..., 0].square().sum(-1)
            + (self.bend * step.square()).sum(-1)
        )


def carried(J: Tensor, r: Tensor, r_trial: Tensor, step: Tensor, region: Region) -> Tensor:
    """Broyden's update: J (N, T, p) changed as little as gives what the step gave, steps in the
    parameters' sizes.
    """
    size = torch.where(region.additive, 1.0, torch.where(region.size > 0, region.size, 1.0))
    scaled = step / size**2
    length = (step * scaled).sum(-1)
    off = r_trial - r - (J @ step[..., None])[..., 0]
    return J + off[..., None] * (scaled / torch.where(length > 0, length, 1)[:, None])[:, None]


CONVERGED, UNFINISHED, STUCK = 0, 1, 2
FAILED, LEFT = 4, 5  # at the start itself; a start that others were better than
DAMPING = 1e-3  # at the start, of the diagonal of J^T J
LARGEST = 1e10
# of what damps a parameter, from one trial to the next at most: valleys that bend are not left
FALL = 0.3
AT_ONCE = 64  # samples up to which values and derivatives of a trial are asked for in one call
FAST = 0.7  # of the squares are left after a step: the next has rough derivatives
# of the decrease that was predicted: below it derivatives that were carried along are found anew
POOR = 0.3


class OtherShape(ValueError):
    """A model whose output does not fit the data."""


class LeastSquares(Protocol):
    """Half the squares of residuals, and a prior: minus the logarithm of a density."""

    def residuals(self, x: Tensor, which: Tensor) -> Tensor:
        """(N, T) at x (N, p) of the starts `which` (N,)."""

    def linearised(
        self, x: Tensor, which: Tensor, r: Tensor | None = None, rough: bool = False
    ) -> tuple[Tensor, Tensor]:
        """Residuals, and J (N, T, p); `r` where these are known. A rough J may be cheaper."""

    def prior(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(N,), gradient and diagonal of the second derivative (N, p), which is not negative."""


@dataclass
class Found:
    """Where each start ends: x (S, p), residuals r (S, T), J (S, T, p), status (S,); history
    (iterations + 1, S, p); what the model raised at trials; `first` the residuals (S, T) at the
    starts, where they are known.
    """

    x: Tensor
    r: Tensor
    J: Tensor
    status: Tensor
    history: Tensor
    raised: list[str] = field(default_factory=list)
    first: Tensor | None = None

    def of(self, which: Tensor) -> Found:
        """That of some starts."""
        return Found(
            self.x[which], self.r[which], self.J[which], self.status[which], self.history[:, which]
        )


def search(
    problem: LeastSquares,
    x: Tensor,
    region: Region,
    iterations: int,
    tolerance: float,
    known: tuple[Tensor, Tensor] | None = None,
    follow: int | None = None,
    negligible: float = 0.0,
    progress: Callable[[int, int, float], None] | None = None,
) -> Found:
    """By the method of Levenberg and Marquardt, each start (S, p) by itself, those that are not
    done as one batch.

    Args:
        known: r (S, T) and J (S, T, p) at x, which is near the end: J is then carried along by
            Broyden's update (1965), and found anew, by differences of one side, where a step does
            less than it promises, and once before a start counts as converged
        negligible: decrease of the squares: a step that promises no more is the last
        follow: so many starts at most, those that are best at first; the others stay where they
            are, with the status LEFT
        progress: gets the iteration, how many starts are at work, and the least squares so far

    Few starts have their derivatives at each trial, in one call of the model; those of many at
    steps that are taken, by differences of one side while the squares fall fast.
    """
    return _Search(problem, x, region, tolerance, known, follow, negligible).run(
        iterations, progress
    )


class _Search:
    """State of a search: where all starts are (`at`), damping, status; which J were found at x
    (`fresh`), and not roughly (`exact`); of these, which were not finite, and are those of a place
    before (`lacking`).
    """

    def __init__(
        self,
        problem: LeastSquares,
        x: Tensor,
        region: Region,
        tolerance: float,
        known: tuple[Tensor, Tensor] | None,
        follow: int | None,
        negligible: float,
    ) -> None:
        self.problem, self.region, self.tolerance, self.carry = (
            problem,
            region,
            tolerance,
            known is not None,
        )
        self.negligible, self.raised = negligible, list[str]()
        S = len(x)
        self.status = torch.full((S,), UNFINISHED, device=x.device)
        self.fresh = torch.ones(S, dtype=torch.bool, device=x.device)
        self.exact, self.lacking = self.fresh.clone(), ~self.fresh
        if known is None:
            r, J = self._at_starts(x, len(x) if follow is None else min(follow, len(x)))
        else:
            r, J = (k.clone() for k in known)
        self.at = Points(x, r, J, *problem.prior(x))
        self.damping = torch.full((S,), DAMPING, dtype=x.dtype, device=x.device)
        # (S, p) squares of the columns of J, which damp: none falls at once
        self.size = torch.zeros_like(x)
        self.blocked = torch.zeros_like(self.fresh)  # steps are small because longer ones fail
        self.history, self.first = [x], r.clone()

    def run(self, iterations: int, progress: Callable[[int, int, float], None] | None) -> Found:
        for k in range(iterations):
            active = (self.status == UNFINISHED).nonzero()[:, 0]
            if progress is not None:
                progress(k, len(active), self.at.r.square().sum(-1).amin().item())
            if not len(active):
                break
            self._iterate(active)
            self.history.append(self.at.x)
        if not self.carry:
            self._refresh((~(self.fresh & self.exact) & (self.status < FAILED)).nonzero()[:, 0])
        at = self.at
        return Found(
            at.x, at.r, at.J, self.status, torch.stack(self.history), self.raised, self.first
        )

    def _iterate(self, active: Tensor) -> None:
        """One trial of each active start."""
        here, damping = self.at.of(active), self.damping[active]
        self.region.sized(active, here.r, here.J)
        trial, whole, at_once = self._trial(active, here)
        moved, before, after = trial.x - here.x, here.objective, trial.objective
        failed = ~(torch.isfinite(after) & torch.isfinite(trial.J).flatten(1).all(-1))
        lower = (after <= before) & ~failed & whole
        promised = here.promised(moved)
        done = (
            whole
            & self._settled(here.x, moved, before, after, lower, promised)
            & (lower | (moved == 0).all(-1) | (damping <= 1))
        )
        # derivatives by which a start may fail or end
        sure = (self.fresh & (self.exact | self.carry))[active] | at_once
        again, done = (done | ~lower) & ~sure, done & sure
        blocked = (self.blocked[active] | failed) & ~(lower & (damping <= 1))
        more = torch.where(lower, damping / 10, torch.where(again, damping, damping * 10))
        stuck = (done & (blocked | self.lacking[active])) | (~done & (more > LARGEST))
        self.at.put(active[lower], trial.of(lower))
        self.fresh[active] = (self.fresh[active] & ~lower) | at_once | done
        self.exact[active] |= at_once
        self.damping[active], self.blocked[active] = more, blocked
        self.status[active] = torch.where(stuck, STUCK, torch.where(done, CONVERGED, UNFINISHED))
        if self.carry:
            poor = lower & ~(before - after >= POOR * promised)
            self._refresh(active[again | (poor & ~done)], rough=True)
        elif not at_once:
            fast = lower & (after < FAST * before)
            self._refresh(active[fast & ~done], rough=True)
            self._refresh(active[(again | (lower & ~fast)) & ~(done | stuck)])

    def _trial(self, active: Tensor, here: Points) -> tuple[Points, Tensor, bool]:
        """What is found a damped step further; whether the step is finite (N,); whether derivatives
        are those of there, else they are carried along, or of here.
        """
        region = self.region.of(active)
        size = self.size[active] = torch.maximum(
            here.J.square().sum(-2) + here.bend, FALL * self.size[active]
        )
        step = self._step(here, self.damping[active, None] * size, region)
        whole = torch.isfinite(step).all(-1)
        x = torch.where(whole[:, None], region.cut(here.x, here.x + step), here.x)
        at_once = not self.carry and len(active) * (2 * x.shape[1] + 1) <= AT_ONCE
        if at_once:
            r, J = self._tried(self.problem.linearised, x, active, (here.r, here.J))
        else:
            (r,) = self._tried(lambda a, b: (self.problem.residuals(a, b),), x, active, (here.r,))
            J = carried(here.J, here.r, r, x - here.x, region) if self.carry else here.J
        return Points(x, r, J, *self.problem.prior(x)), whole, at_once

    @staticmethod
    def _step(here: Points, damping: Tensor, region: Region) -> Tensor:
        """Damped step (N, p), of those parameters that no bound holds."""
        gradient = here.gradient
        free = ~region.held(here.x, gradient)
        A = here.J.mT @ here.J + torch.diag_embed(here.bend)
        A = A * (free[:, None] & free[..., None]) + torch.diag_embed((~free).to(A))
        eps, tiny = torch.finfo(A.dtype).eps, torch.finfo(A.dtype).tiny
        damped = A + torch.diag_embed(damping + eps * A.diagonal(dim1=-2, dim2=-1) + tiny)
        return -solve_unchecked(damped, (gradient * free)[..., None])[..., 0]

    def _settled(
        self,
        x: Tensor,
        moved: Tensor,
        before: Tensor,
        after: Tensor,
        lower: Tensor,
        promised: Tensor,
    ) -> Tensor:
        """Whether the step is small, or what it gains, or promised."""
        size = torch.where(self.region.additive, 1.0, x.abs() + self.tolerance)
        small = (moved.abs() <= self.tolerance * size).all(-1)
        idle = promised.abs() <= self.negligible if self.negligible else torch.zeros_like(small)
        return small | idle | ((before - after <= self.tolerance**2 * before) & lower)

    def _refresh(self, which: Tensor, rough: bool = False) -> None:
        """Derivatives anew. Where they are not finite the old ones stay, and no start converges."""
        if not len(which):
            return
        at = self.at
        _, J = self._tried(
            lambda a, b: self.problem.linearised(a, b, at.r[b], rough),
            at.x[which],
            which,
            (at.r[which], at.J[which]),
        )
        good = torch.isfinite(J).flatten(1).all(-1)
        at.J[which] = torch.where(good[:, None, None], J, at.J[which])
        self.fresh[which], self.exact[which] = True, not rough
        self.lacking[which] = ~good if self.carry or not rough else False

    def _at_starts(self, x: Tensor, follow: int) -> tuple[Tensor, Tensor]:
        """r and J at the starts that are followed; of those that fail infinite misfits, with the
        status FAILED. Where all fail, the first error.
        """
        S, p = x.shape
        every, phi = torch.arange(S, device=x.device), self.problem.prior(x)[0]
        if follow < S:
            (r,) = self._tried(lambda a, b: (self.problem.residuals(a, b),), x, every)
            total = torch.where(
                torch.isfinite(r).all(-1), r.square().sum(-1) + 2 * phi, torch.inf
            ).nan_to_num(nan=torch.inf)
            some = total.argsort()[:follow].sort().values
            self.status = torch.where(torch.isin(every, some), UNFINISHED, LEFT)
            J = torch.zeros(S, r.shape[1], p, dtype=r.dtype, device=r.device)
            J[some] = self._tried(
                lambda a, b: self.problem.linearised(a, b, r[b])[1:], x[some], some
            )[0]
        else:
            r, J = self._tried(self.problem.linearised, x, every)
        good = (
            torch.isfinite(r).all(-1) & torch.isfinite(J).flatten(1).all(-1) & torch.isfinite(phi)
        )
        if not good.any():
            raise ValueError(
                f"a start (0 of {S}) at which the model is not finite was given; another is wanted"
            )
        self.status = torch.where(good, self.status, FAILED)
        return torch.where(good[:, None], r, torch.inf), torch.where(good[:, None, None], J, 0)

    def _tried(
        self, evaluate: Callable, x: Tensor, which: Tensor, like: tuple[Tensor, ...] | None = None
    ) -> tuple[Tensor, ...]:
        """What the model gives; NaN of a start at which it raises, and what it said goes into
        `raised`. Where it raises at all starts, NaN `like` these or, without them, the first error.
        """
        errors: list[Exception] = []
        parts = _parts(evaluate, x, which, errors)
        like = next((part for part in parts if part is not None), like)
        if like is None:
            raise errors[0]
        self.raised += [str(error) or type(error).__name__ for error in errors]
        errors.clear()  # they hold the model's tensors, by the frames that they came through
        none = tuple(torch.full_like(v[:1], torch.nan) for v in like)
        return tuple(
            torch.cat(some)
            for some in zip(*(none if part is None else part for part in parts), strict=True)
        )


def _parts(
    evaluate: Callable, x: Tensor, which: Tensor, errors: list[Exception]
) -> list[tuple[Tensor, ...] | None]:
    """What the model gives at all starts, or at parts of them, halved until one start is left of
    those that raise: None.
    """
    try:
        return [evaluate(x, which)]
    except OtherShape:
        raise
    except Exception as error:  # whatever a user's model raises
        if len(x) == 1:
            errors.append(error)
            return [None]
    return [
        part
        for half in zip(x.tensor_split(2), which.tensor_split(2), strict=True)
        for part in _parts(evaluate, *half, errors)
    ]
