"""Steady spin of a rotor on a support that does not spin: the shape that both keep, the support as
seen from frame a, the rotor as seen from axes that turn with it.

Nodes of the rotor stand in a frame that turns with omega about the bearing's axis, as that is where
the support's deflection leaves it, all others in frame a. Loads and inertia are those of these
frames; nothing else knows of the spin.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..equations.load_steps import climb
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..solvers.implicit_gradient import differentiated, implicit_gradient
from ..solvers.newton import newton
from ..state.state import State, rest
from ..statics.internal_states import resting
from ..statics.mechanism import stressed, unheld
from .bearing import Axis, Bearing

SAME = 1e-12  # of an axis, and of the structure's size: a bearing that does not move any more
MEMORY = 6  # of the axes tried last
ROUNDS = 30  # of the bearing's place and the equilibrium under it


def drawn(
    bearing: Bearing, speed: Tensor, t: Tensor, inputs: Inputs
) -> tuple[SteadyProblem, Configuration]:
    """What is to be solved at speeds (...) rad/s, and the shape as drawn to begin with."""
    model = bearing.model
    start = model.space.start(rest(model.scene))
    x = Configuration(start.position, start.rotation, start.stress)
    frame, one = bearing.frame(x, speed, bearing.axis(x)), torch.ones_like(speed)
    problem = SteadyProblem(model, t, inputs, one, own_frame=frame)
    return problem, replace(problem, load_factor=torch.zeros_like(speed)).apply_supports(x)


def steady_spin(
    bearing: Bearing, speed: Tensor, problem: SteadyProblem, x: Configuration
) -> tuple[SteadyProblem, Configuration, State]:
    """The steady state at speeds (...) rad/s from that on, with the problem that it solves. Raises
    RuntimeError for a speed without one, ValueError where nothing holds a part.
    """
    model, axis, first = bearing.model, bearing.axis(x), problem

    def problem_at(x: Configuration, axis: Axis) -> SteadyProblem:
        return replace(first, own_frame=bearing.frame(x, speed, axis))

    with no_derivatives():
        start = x = stressed(problem, x)[0]  # hinged blades are held by their centrifugal loads
        x, reaction, status, _ = newton(problem, start)
        if concrete(status != 0).any():  # too much at once
            x, reaction, status = climb(problem, start, None)
        led, tried = [], []
        for _ in range(ROUNDS):
            if model.internal_states:
                at = problem_at(x, axis), x, reaction, status, status == 0
                problem, x, reaction, status = resting(*at, None)
                first = replace(first, near=problem.near)
            now = bearing.axis(x)
            if concrete(status != 0).any() or _near(axis, now, model):
                break
            led, tried = [*led, torch.cat(torch.broadcast_tensors(*now), -1)], [*tried, axis]
            axis = _accelerated(led, tried)
            x, reaction, status, _ = newton(problem_at(x, axis), x)
    if concrete(~torch.isfinite(x.position.detach())).any():
        _refuse_unheld(model, problem)
        status = torch.where(torch.isfinite(x.position.detach()).all(-1).all(-1), status, 1)
    _refuse_failed(speed, status)
    problem = problem_at(x, bearing.axis(x))
    if differentiated(problem, x):
        for _ in range(1 if bearing.support is None else ROUNDS):
            before = x
            x, reaction = implicit_gradient(problem, x, status == 0)
            problem = problem_at(x, bearing.axis(x))
            if _near(bearing.axis(before), bearing.axis(x), model):
                break
    return problem, x, problem.state(x, reaction, status)


def _accelerated(led: list[Tensor], tried: list[Axis]) -> Axis:
    """The axis to try next, where those tried led to others (..., 6): Anderson's (1965), which ends
    soon where few numbers follow each other linearly, however strongly.
    """
    last = torch.stack(led[-MEMORY:], -1)
    off = last - torch.stack(
        [torch.cat(x, -1).expand_as(last[..., 0]) for x in tried[-MEMORY:]], -1
    )
    best = last[..., -1]
    if last.shape[-1] > 1:
        change, moved = off.diff(dim=-1), last.diff(dim=-1)
        best = best - (moved @ (torch.linalg.pinv(change, rtol=1e-10) @ off[..., -1:]))[..., 0]
    point, direction = best[..., :3], best[..., 3:]
    return Axis(point, direction / torch.linalg.vector_norm(direction, dim=-1, keepdim=True))


def _near(a: Axis, b: Axis, model: Model) -> bool:
    size = model.scene.beam.extent.detach()[..., None]
    moved = (a.point - b.point).abs() / size, (a.direction - b.direction).abs()
    return all(bool(concrete(v <= SAME).all()) for v in moved)


def _refuse_unheld(model: Model, problem: SteadyProblem) -> None:
    """ValueError for parts that nothing holds."""
    words = unheld(model, problem.t, problem.inputs)[1]
    if words:
        raise ValueError(
            f"{words} that nothing resists were given to campbell; a joint, a support or a spring "
            "is wanted"
        )


def _refuse_failed(speed: Tensor, status: Tensor) -> None:
    failed = concrete(status != 0)
    if failed.any():
        first = float(concrete(speed).expand(failed.shape)[failed][0])
        raise RuntimeError(
            f"no steady state of the rotor was found at {first:.4g} rad/s; lower speeds, or a "
            "rotor that keeps its balance there, are wanted"
        )
