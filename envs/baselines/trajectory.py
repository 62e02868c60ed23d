"""Gauss-Newton steps on the actions of whole stretches of time: what MPC and the optimum are made
of.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

import torchbeam as tb

from ..episodes import Episodes
from ..plant import Plant
from ..task import Task

ROUNDS = 30  # in which actions come to their bounds, or leave them, at most
LENGTHS = 1.0, 0.4, 0.1, 0.01, 1e-3  # of the steps there
ENOUGH = 1e-9  # lowering of the model, beside what a whole step promises, at which they end
SAMPLES = 400_000  # steps with gradient that are held in memory at once


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
        return self._way(now.beam, acting)

    def slopes(
        self, now: Episodes, plan: Tensor, acts: Callable[[Tensor], Tensor] = lambda plan: plan
    ) -> tuple[Tensor, Tensor]:
        """The way of a plan (n, P, a), of which acts(plan) (n, T, a) acts, and its derivatives
        (n, T, d, P, a): by reverse mode, all rows of steps that are made once, or as many at a time
        as memory takes.
        """
        with torch.enable_grad():
            plan = plan.detach().clone().requires_grad_()
            acting = acts(plan)
            way = self._way(now.beam, acting)

        n, T, _ = acting.shape
        rows = torch.eye(T * self.task.directions).to(acting).unflatten(-1, (T, 1, -1))

        def row(seed: Tensor) -> Tensor:
            seed = seed.movedim(-2, 0).expand_as(way)
            return torch.autograd.grad(way, plan, seed, retain_graph=True)[0]

        size = max(1, SAMPLES // (n * T * self.task.config.substeps))
        slopes = torch.func.vmap(row, chunk_size=size)(rows)
        return way.detach(), slopes.movedim(0, 1).unflatten(1, (T, -1))

    def _way(self, beam: tb.State, acting: Tensor) -> Tensor:
        task, substeps = self.task, self.task.config.substeps
        inputs = {
            name: tb.PerInterval(value.repeat_interleave(substeps, -2))
            for name, value in task.inputs(acting).items()
        }
        way = tb.rollout(self.plant.stepper, beam, acting.shape[-2] * substeps, inputs)
        return way.position[substeps - 1 :: substeps, ..., -1, task.vector].movedim(0, -2)

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
    change from the one given and h the largest entry on H's diagonal: Newton steps of those that
    are not at a bound, cut off at the bounds and as long as is best of `LENGTHS`, each sample by
    itself (Bertsekas 1982).
    """
    size = damping * H.diagonal(dim1=-2, dim2=-1).amax(-1)
    H = H + torch.diag_embed(size[..., None].expand_as(plan))
    lengths = torch.tensor(LENGTHS).to(plan).reshape(-1, 1, 1)
    new = plan
    for _ in range(ROUNDS):
        slope = g + (H @ (new - plan)[..., None])[..., 0]
        free = (~(((new >= 1) & (slope < 0)) | ((new <= -1) & (slope > 0)))).to(H)
        # of those held: rows and columns of the unit matrix
        own = H * free[..., None] * free[..., None, :] + torch.diag_embed(1 - free)
        step = torch.linalg.solve(own, (slope * free)[..., None])[..., 0]
        trial = (new - lengths * step).clamp(-1, 1)
        d = trial - new
        change = (slope * d).sum(-1) + ((H @ d[..., None])[..., 0] * d).sum(-1) / 2
        least, best = change.min(0)
        new = torch.where(least[:, None] < 0, trial[best, torch.arange(len(new))], new)
        if (-least <= ENOUGH * (1 + (slope * step).sum(-1).abs())).all():
            break
        if (best == 0).all() and (trial[0].abs() < 1).all():
            break  # no bound in the way: the least is reached
    return new
