"""Load stepping: the load is raised from none to all of it, or what is out of balance taken away
from all to nothing (`Relief`), by Newton's method, each sample at its own pace.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from ..core.status import DIVERGED, SUCCESS
from ..core.validation import concrete
from ..nodal.coordinates.spatial import Spatial
from ..scene.prescribed_motion import STILL, moved
from ..solvers.newton import newton
from .steady import Configuration, SteadyProblem

TURN = 1.0  # rad a node may turn in one load step: beyond it Newton may land on another branch
# rad by the tangent at no load: of a first step; of one that may be the whole load
FIRST, WHOLE = 1.0, 1.2
EASY = 0.8  # rad: after a step with that turn the next is as long again
FEWEST = 1 / 64  # of the load in a first step
WOUND = 5.0  # rad in one step: more cannot be told from less than TURN the other way
LEAST = 1e-4  # smallest load step, as a share of the whole load
LIMIT = 8  # iterations in a load step: one that takes more is quicker in two
# iterations: a step that takes more may have come to another branch, and is made in two where it is
# more than FEWEST
QUICK = 6


def climb(
    whole: SteadyProblem, x: Configuration, tolerance: float | None, active: Tensor | None = None
) -> tuple[Configuration, Tensor, Tensor]:
    """Raise the load from 0 to 1, that of the problem `whole`: (shape, reaction, status), of the
    `active` samples (...), None = all.
    """
    with torch.no_grad():
        model = whole.model
        probe = whole.residual(x)[0]
        shape = probe.measure().shape
        x = Configuration(*(v.expand(*shape, *v.shape[-2:]) for v in x))
        whole = replace(whole, load_factor=probe.nodes.new_ones(shape))
        reached, step = torch.zeros_like(whole.load_factor), _first_step(whole, x)
        reaction = probe.nodes.new_zeros(*shape, *model.constraints.fixed.shape)
        status = torch.zeros(shape, dtype=torch.long, device=x.position.device)
        status = status if active is None else torch.where(active, status, DIVERGED)
        while True:
            climbing, share = shares(reached, step, status)
            if not concrete(climbing).any():
                return x, reaction, status
            problem = replace(whole, load_factor=share)
            outcome = newton(
                problem, problem.apply_supports(x), climbing, tolerance, LIMIT, foresee=share < 1
            )
            turn = model.space.multiply(model.space.inverse(x.rotation), outcome.x.rotation)
            cosine = model.space.cosine(turn).abs().amin(-1)
            good, reached, step, status = advanced(
                climbing, share, reached, step, status, outcome.status, cosine, outcome.iterations
            )
            x = Configuration(
                *(
                    torch.where(good[..., None, None], a, b)
                    for a, b in zip(outcome.x, x, strict=True)
                )
            )
            reaction = torch.where(good[..., None, None], outcome.reaction, reaction)


def _first_step(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(...) share of the load to begin with: that under which no node would turn by more than 1 rad
    if the beam stayed as soft as it is, and no support does, where one turns by most of a turn; all
    of it where none would turn by more than 1.2.
    """
    model = problem.model
    residual, *about = problem.residual(x)
    move, *_ = problem.linearise(x, *about).solve(residual.nodes, residual.strain)
    turn = torch.linalg.vector_norm(move[..., model.space.dims.position :], dim=-1).amax(-1)
    return first_step(with_supports(turn, turn_of_supports(problem, x)))


def with_supports(turn: Tensor, led: Tensor) -> Tensor:
    """(...) rad, the larger of a turn of nodes and one of supports, which counts above WOUND."""
    return torch.where(led > WOUND, torch.maximum(turn, led), turn)


def turn_of_supports(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(...) rad, the largest `way_of_support` of the problem's supports under the whole load."""
    model, turn = problem.model, torch.zeros_like(x.position[..., 0, 0])
    for support in model.scene.supports if model.space.turns else ():
        by = model.prescribed_motion.displacement(support, problem.t)[1]
        if by is not None:
            space, still = model.space.of_nodes(support.node), model.scene.beam.frames
            still, now = (q[..., support.node, :] for q in (still, x.rotation))
            turn = torch.maximum(turn, way_of_support(space, now, still, by))
    return turn


def way_of_support(space: Spatial, now: Tensor, still: Tensor, turn: Tensor) -> Tensor:
    """(...) rad by which a support turns its node from the rotation that it has `now`, in the
    space's coordinates: all of its `turn` (..., 3) from where the beam has the node, a quaternion
    `still`, turns and turns again included, which no rotation tells; else what is left.
    """
    at = torch.zeros_like(turn)
    first, last = (space.pose(at, q)[1] for q in (still, moved(at, still, None, turn)[1]))
    begun, left = (
        2 * torch.arccos(space.cosine(space.multiply(space.inverse(now), q)).abs().clamp(max=1))
        for q in (first, last)
    )
    return torch.where(begun < STILL, torch.linalg.vector_norm(turn, dim=-1), left)


# Rules of a sample: turn, reached, step, share and cosine (...)


def first_step(turn: Tensor) -> Tensor:
    """By the largest turn (rad) of a node under the whole load, were the beam as soft as it is."""
    return torch.where(turn > WHOLE, (FIRST / turn).clamp(min=FEWEST), 1.0)


def shares(reached: Tensor, step: Tensor, status: Tensor) -> tuple[Tensor, Tensor]:
    """Which samples are on their way, and the share of the load that each comes to next."""
    climbing = (reached < 1) & (status == SUCCESS)
    return climbing, torch.where(climbing, (reached + step).clamp(max=1), reached)


def advanced(
    climbing: Tensor,
    share: Tensor,
    reached: Tensor,
    step: Tensor,
    status: Tensor,
    step_status: Tensor,
    cosine: Tensor,
    iterations: Tensor,
    smallest: Tensor | float = LEAST,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """After a step that Newton's method has `step_status` for in so many iterations; cosine: of
    half the largest angle that a node turned by; none is tried below the smallest. Whether it went
    well, reached, step, status.
    """
    direct = (iterations <= QUICK) | (share - reached <= FEWEST)
    good = climbing & (step_status == SUCCESS) & (cosine > math.cos(TURN / 2)) & direct
    turned = 2 * torch.arccos(cosine.clamp(max=1))
    step = torch.where(good, (EASY / turned).clamp(1.5, 4.0) * step, step / 2)
    stuck = climbing & ~good & (step < smallest)
    return (
        good,
        torch.where(good, share, reached),
        step,
        torch.where(stuck, step_status.clamp(min=DIVERGED), status),
    )
