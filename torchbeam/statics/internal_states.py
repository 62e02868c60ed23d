"""Internal states of loads in an equilibrium: where their laws come to rest, linear or not."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.status import DIVERGED, SUCCESS
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.shapes import broadcast_shapes
from ..nodal.loads import internal
from ..solvers.newton import newton

LIMIT = 25  # linearisations
STAYS = 0.5  # power of the dtype's rounding: change of the states, relative, up to which they stay


def resting(
    problem: SteadyProblem,
    x: Configuration,
    reaction: Tensor,
    status: Tensor,
    going: Tensor,
    tolerance: float | None,
) -> tuple[SteadyProblem, Configuration, Tensor, Tensor]:
    """Equilibria whose internal states were found by laws linearised at zero, those that are
    `going` with the laws linearised where the states are: Newton's method for z' = 0 beside that
    for the shape, until the states stay; the problem so, shape, reaction, status. Where laws are
    linear they are as they were.
    """
    with no_derivatives():
        for _ in range(LIMIT):
            states = _states(problem, x, status.shape)
            after = _states(replace(problem, near=states), x, status.shape)
            going = going & (status == SUCCESS) & ~_stays(states, after)
            if not concrete(going).any():
                return problem, x, reaction, status
            problem = replace(problem, near=torch.where(going[..., None], after, states))
            outcome = newton(problem, problem.apply_supports(x), going, tolerance)
            good = (going & (outcome.status == SUCCESS))[..., None, None]
            x = Configuration(*(torch.where(good, a, b) for a, b in zip(outcome.x, x, strict=True)))
            reaction = torch.where(good, outcome.reaction, reaction)
            status = torch.where(going, outcome.status, status)
    return problem, x, reaction, torch.where(going, DIVERGED, status)


def linearised(problem: SteadyProblem, x: Configuration) -> SteadyProblem:
    """The same with laws of internal states linearised where these come to rest at x; a sample
    whose states do not settle has no balance (NaN).
    """
    shape = broadcast_shapes(
        x.position.shape[:-2],
        problem.model.scene.batch_shape,
        problem.load_factor.shape,
        *(value.shape[:-1] for value in problem.inputs.values()),
    )
    with no_derivatives():
        z = _states(problem, x, shape)
        for _ in range(LIMIT):
            before, z = z, _states(replace(problem, near=z), x, shape)
            stays = _stays(before, z)
            if stays.all():
                break
        return replace(problem, near=torch.where(stays[..., None], z, torch.nan))


def _stays(before: Tensor, after: Tensor) -> Tensor:
    """(...) whether internal states (..., z) do."""
    limit = torch.finfo(after.dtype).eps ** STAYS
    return ((after - before).abs() <= limit * after.abs().amax(-1, keepdim=True)).all(-1)


def _states(problem: SteadyProblem, x: Configuration, shape: torch.Size) -> Tensor:
    """(..., z)"""
    return internal(problem.model, problem.nodes(x), problem.conditions, shape)
