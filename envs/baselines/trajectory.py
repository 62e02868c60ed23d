"""Gauss-Newton steps on the actions of whole stretches of time: what MPC and the optimum are made
of.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from ..episodes import Episodes
from ..plant import Plant
from ..task import Task

ROUNDS = 500  # in which actions come to their bounds, or leave them, at most
ENOUGH = 1e-12  # of a slope inward from a bound, beside the largest at the start


class Linearised(NamedTuple):
    """The way of the tip about actions (n, T, a): tips (n, T, d) m, by actions (n, T, d, T, a), and
    by changes of the beam at its start (n, T, d, k).
    """

    acting: Tensor
    tips: Tensor
    by_acting: Tensor
    by_start: Tensor

    def at(self, acting: Tensor) -> Tensor:
        """The tips under other actions, to first order."""
        change = (acting - self.acting).flatten(1)[:, None, :, None]
        return self.tips + (self.by_acting.flatten(3) @ change)[..., 0]

    def after(self, change: Tensor) -> Linearised:
        """The way from a beam that is another one by a change (n, k), to first order."""
        more = (self.by_start @ change[:, None, :, None])[..., 0]
        return self._replace(tips=self.tips + more)


class TipWay:
    """The way of the tip as a function of the actions, with exact derivatives by all of them, and
    the quadratic model of what it costs.

    plant  what is simulated: the episodes' own, or that of the usual parameters

    Raises ValueError for a task with a memory beside its beam, or whose inputs follow the motion.
    """

    def __init__(self, task: Task, plant: Plant) -> None:
        self.task, self.plant = task, plant
        inputs = plant.scene.inputs
        if type(task).next_memory is not Task.next_memory or set(inputs) != {
            drive.input for drive in task.drives
        }:
            raise ValueError(
                f"{type(task).__name__} was given, of which actions alone do not tell the inputs "
                f"{', '.join(inputs)}; a task of which they do is wanted"
            )

    def __call__(self, now: Episodes, acting: Tensor) -> Tensor:
        """(n, T, d) m: the tip's positions at the ends of T intervals with actions (n, T, a); d the
        components that change.
        """
        every, inputs = self.task.config.substeps, self._inputs(acting)
        states = tb.rollout(self.plant.stepper, now.beam, acting.shape[-2] * every, inputs)
        return self._tip(states)[every - 1 :: every].movedim(0, -2)

    def linearised(
        self, beam: tb.State | Callable[[Tensor], tb.State], acting: Tensor, size: int = 0
    ) -> Linearised:
        """The way from a beam under actions (n, T, a), and its derivatives. beam: a state, or a
        function of changes (n, size) of it, of which that at 0 is meant.
        """
        n, numbers = acting.shape[0], acting[0].numel()
        by = torch.cat((acting.detach().flatten(1), acting.new_zeros(n, size)), 1).requires_grad_()
        with torch.enable_grad():
            actions, change = by.split((numbers, size), 1)
            inputs = self._inputs(actions.view_as(acting))
            start = beam(change) if callable(beam) else beam
        every = self.task.config.substeps
        way, slopes = tb.rollout_jacobian(
            self.plant.stepper,
            start,
            acting.shape[-2] * every,
            inputs,
            self._tip,
            by=by,
            every=every,
        )
        by_acting, by_start = slopes.movedim(2, 0).split((numbers, size), -1)
        by_acting = by_acting.unflatten(-1, acting.shape[1:])
        return Linearised(acting, way.movedim(0, -2), by_acting, by_start)

    def _inputs(self, acting: Tensor) -> dict[str, tb.PerInterval]:
        """Of each step."""
        return {
            name: tb.PerInterval(value.repeat_interleave(self.task.config.substeps, -2))
            for name, value in self.task.inputs(acting).items()
        }

    def _tip(self, states: tb.State) -> Tensor:
        """(..., d) m"""
        return states.position[..., -1, self.task.vector]

    def gaps(self, now: Episodes, way: Tensor) -> Tensor:
        """(n, T, d) m: from the targets to the tip; where there are none, from its start."""
        target = self.task.target(now, way.shape[1])
        target = now.start.position[:, None, -1] if target is None else target[:, 1:]
        return way - target[..., self.task.vector]

    def quadratic(
        self, gap: Tensor, slopes: Tensor, plan: Tensor, weight: Tensor | float = 1.0
    ) -> tuple[Tensor, Tensor]:
        """Gradient (n, m) and Gauss-Newton matrix (n, m, m) of the cost of gaps (n, T, d), times
        weights (T,), and of the plan (n, m), by its m numbers; slopes (n, T, d, m).

        Squares weigh as much as gives them the slope of the task's `square_cost`: as that is
        concave, the model lies above it (iteratively reweighted least squares).
        """
        with torch.enable_grad():
            square = gap.square().sum(-1).detach().requires_grad_()
            slope = torch.autograd.grad(self.task.square_cost(square).sum(), square)[0]
        cost, J = 2 * self.task.config.control_cost, slopes.flatten(1, 2)
        weighted = ((2 * weight * slope)[..., None, None] * slopes).flatten(1, 2)
        eye = torch.eye(plan.shape[-1], dtype=plan.dtype, device=plan.device)
        g = (weighted.mT @ gap.flatten(1)[..., None])[..., 0] + cost * plan
        return g, J.mT @ weighted + cost * eye


def within_bounds(g: Tensor, H: Tensor, plan: Tensor, damping: float | Tensor = 0.0) -> Tensor:
    """The plan (n, m) within [-1, 1] at which g'd + d'(H + damping h I) d / 2 is least, d the
    change from the one given and h the largest entry on H's diagonal; each sample by itself. Where
    several plans are, one of them; a sample whose g or H is not finite keeps its own.
    """
    size = damping * H.diagonal(dim1=-2, dim2=-1).amax(-1)
    H = H + torch.diag_embed(size[..., None].expand_as(plan))
    g, H, x = (x.detach().double().cpu().numpy() for x in (g, H, plan))
    sound = np.isfinite(g).all(-1) & np.isfinite(H).all((-2, -1))
    if sound.all():
        return torch.from_numpy(_least(g, H, x)).to(plan)
    least = x.copy()
    if sound.any():
        least[sound] = _least(g[sound], H[sound], x[sound])
    return torch.from_numpy(least).to(plan)


def _least(g: np.ndarray, H: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Of n samples, each by an active set of its own (Nocedal and Wright 2006, section 16.5):
    Newton steps of the numbers that are not held at a bound, cut off at the bounds where that
    lowers the model enough (Bertsekas 1982), else as far as the first bound. Once those are at
    their least, the held one with the largest slope inward is let go, until there is none. The
    model falls from one such least to the next: no set of held ones comes twice.
    """
    least, own = x.copy(), np.arange(len(x))  # those that are not there yet
    enough = ENOUGH * np.abs(g).max(-1)
    # in the place of H where a number is held: of its size
    unit = H.diagonal(axis1=-2, axis2=-1).max(-1)[:, None, None] * np.eye(x.shape[-1])
    held = ((x >= 1) & (g < 0)) | ((x <= -1) & (g > 0))
    for _ in range(ROUNDS):
        step = _newton(g, H, ~held, unit)
        there = x + step
        beyond = np.abs(there) > 1
        d = np.minimum(np.maximum(there, -1.0), 1.0) - x
        change = (H @ d[..., None])[..., 0]
        inside = ~beyond.any(-1)
        if not inside.all():
            slope = (d * g).sum(-1)
            lowers = (slope + (d * change).sum(-1) / 2 < slope / 4) & (slope < 0)
            k = np.flatnonzero(~(inside | lowers))
            if len(k):
                way = step[k]
                size, away = np.abs(way), 1 - x[k] * np.sign(way)
                room = np.divide(away, size, out=np.full_like(size, np.inf), where=size > 0)
                d[k] = room.min(-1)[:, None] * way
                change[k] = (H[k] @ d[k][..., None])[..., 0]
                beyond[k] = False
                beyond[k, room.argmin(-1)] = True
            held |= beyond
        x, g = x + d, g + change
        x[held] = np.sign(x[held])
        if not inside.any():
            continue
        inward = np.where(held & inside[:, None], g * np.sign(x), 0.0)
        done = inside & (inward.max(-1) <= enough)
        k = np.flatnonzero(inside & ~done)
        held[k, inward[k].argmax(-1)] = False
        if done.any():
            least[own[done]] = x[done]
            if done.all():
                break
            g, H, x, held, enough, unit, own = (
                v[~done] for v in (g, H, x, held, enough, unit, own)
            )
    else:
        least[own] = x
    return least


def _newton(g: np.ndarray, H: np.ndarray, free: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Steps (n, m) to the least of the numbers that are free, `unit` in the place of H for the
    others. Of a matrix without an inverse the shortest of those that lead there, and where none
    does, a step that leaves the bounds along what is flat, downhill.
    """
    A = np.where(free[:, :, None] & free[:, None, :], H, unit)
    b = np.where(free, -g, 0.0)
    try:
        return np.linalg.solve(A, b[..., None])[..., 0]
    except np.linalg.LinAlgError:
        curvature, V = np.linalg.eigh(A)
    along = (V.mT @ b[..., None])[..., 0]
    flat = curvature <= b.shape[-1] * np.finfo(b.dtype).eps * curvature.max(-1, keepdims=True)
    step = np.divide(along, curvature, out=np.zeros_like(along), where=~flat)
    step, fall = ((V @ x[..., None])[..., 0] for x in (step, np.where(flat, along, 0.0)))
    most = np.abs(fall).max(-1, keepdims=True)
    falls = most > ENOUGH * np.abs(b).max(-1, keepdims=True)
    step += np.divide(3 * fall, most, out=np.zeros_like(fall), where=falls)
    return np.where(free, step, 0.0)
