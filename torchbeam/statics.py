"""Equilibrium of a scene."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from .newton import DIVERGED, STATUS, attach, dependencies, newton, no_derivatives, wants_gradient
from .nodal.external import internal
from .nodal.model import Model
from .nodal.still import Shape, Still
from .scene import Scene
from .solve import positive_definite
from .state import State, fitting, orientation, rest, turning

TURN = 1.0  # rad a node may turn in one load step: beyond it Newton may land on another branch
LEAST = 1e-4  # smallest load step, as a share of the whole load
LIMIT = 12  # iterations in a load step: one that takes more is quicker in two
REASON = {**STATUS, DIVERGED: "Newton's method found none; the load may be past a limit point"}


def equilibrium(scene: Scene, *, initial: State | None = None, t: float = 0.0, tolerance: float | None = None,
                throw: bool = True, **inputs: Any) -> State:
    """Static equilibrium under the scene's loads at time t (s).

    initial    where to start, at no load; None = the undeformed beam
    tolerance  of the scaled residual; default 1e-8 in float64
    throw      raise where a sample has no equilibrium; otherwise its `status` says so and it holds the last shape on the way
    inputs     by name, (..., size)

    The load is raised in steps, per sample, where Newton's method needs it: a step in which it fails, or a node turns by more
    than 1 rad, is halved. Infinite stiffness is taken as it is. Differentiable by the implicit function theorem.

    Past a point of buckling the way up may keep to a branch that is no longer stable. Where all loads are conservative (dead
    forces, gravity) a RuntimeWarning names the samples whose tangent is not positive definite.

    Returns a `State` at rest with stress and reaction. Raises ValueError for what the nodal form does not take and
    RuntimeError for a sample without equilibrium.
    """
    model = Model.of(scene)
    given = scene.tensors(inputs)
    start = rest(scene) if initial is None else fitting(initial, scene)
    time = torch.as_tensor(t, dtype=scene.dtype, device=scene.device)
    start = model.space.enter(start)
    start = Shape(start.position, start.rotation, start.stress)
    x, reaction, status = _climb(model, time, given, start, tolerance)
    good = status == 0
    problem = Still(model, time, given, torch.ones_like(status, dtype=scene.dtype))
    if wants_gradient(*dependencies(problem, x), *start):
        held = {name: torch.where(good[..., None], v, v.detach()) for name, v in given.items()}
        problem = replace(problem, inputs=held)
        x, reaction = _attached(problem, x, reaction, start, good)
    if throw and not good.all():
        first = (~good).nonzero()[0].tolist()
        which = f"sample {first[0] if len(first) == 1 else tuple(first)} of {tuple(good.shape)}" if first else "the scene"
        raise RuntimeError(f"{which} has no equilibrium: {REASON[int(status[~good][0])]}")
    if all(load.conservative for load in scene.loads) and not turning(scene):
        _warn_of_unstable(problem, x, good)
    velocity, spin = problem.velocity(x)
    zero = torch.zeros_like(status, dtype=scene.dtype)
    return model.space.leave(State(
        *x[:2], velocity=velocity, spin=model.space.to_section(x.rotation, spin), stress=x.stress, reaction=reaction, work=zero,
        defect=zero, t=time.expand(status.shape), status=status, frame=orientation(scene, status.shape),
        internal=internal(model, problem.nodes(x), time, given, status.shape)))


def _warn_of_unstable(problem: Still, x: Shape, good: Tensor) -> None:
    with no_derivatives():
        _, kin = problem.residual(x)
        tangent = problem.linearise(x, kin)
        unstable = good & ~positive_definite(tangent.D, tangent.L, tangent.U)
    if unstable.any():
        first = unstable.nonzero()[0].tolist()
        which = f"sample {first[0] if len(first) == 1 else tuple(first)} " if first else "the beam "
        warnings.warn(f"{which}({int(unstable.sum())} of {good.numel()}) is in unstable equilibrium: a small disturbance or "
                      "imperfection leads to another", RuntimeWarning, stacklevel=3)


def _climb(model: Model, t: Tensor, inputs: dict[str, Tensor], x: Shape, tolerance: float | None
           ) -> tuple[Shape, Tensor, Tensor]:
    """Raise the load from 0 to 1, each sample at its own pace: (shape, reaction, status)."""
    with torch.no_grad():
        probe, _ = Still(model, t, inputs, t.new_ones(())).residual(x)
        shape = probe.measure().shape
        x = Shape(*(v.expand(*shape, *v.shape[-2:]) for v in x))
        reached, step = t.new_zeros(shape), t.new_ones(shape)
        reaction = probe.nodes.new_zeros(*shape, *model.held.fixed.shape)
        status = torch.zeros(shape, dtype=torch.long, device=t.device)
        while True:
            climbing = (reached < 1) & (status == 0)
            if not climbing.any():
                return x, reaction, status
            share = torch.where(climbing, (reached + step).clamp(max=1), reached)
            outcome = newton(Still(model, t, inputs, share), x, climbing, tolerance, LIMIT)
            turn = model.space.multiply(model.space.inverse(x.rotation), outcome.x.rotation)
            cosine = model.space.cosine(turn).abs().amin(-1)
            calm = cosine > torch.cos(torch.as_tensor(TURN / 2))
            good = climbing & (outcome.status == 0) & calm
            x = Shape(*(torch.where(good[..., None, None], a, b) for a, b in zip(outcome.x, x, strict=True)))
            reaction = torch.where(good[..., None, None], outcome.reaction, reaction)
            reached = torch.where(good, share, reached)
            step = torch.where(good, 1.5 * step, step / 2)
            stuck = climbing & ~good & (step < LEAST)
            status = torch.where(stuck, outcome.status.clamp(min=DIVERGED), status)


def _attached(problem: Still, x: Shape, reaction: Tensor, start: Shape, good: Tensor) -> tuple[Shape, Tensor]:
    """The solution with its derivatives, those by the supports included, whose place and axes come from the scene. A sample
    that is not good keeps its shape and has none.
    """
    mask = good[..., None, None]
    safe = Shape(start.position.detach(), start.rotation.detach(), torch.zeros_like(start.stress))
    solved = Shape(*(torch.where(mask, a, b) for a, b in zip(x, safe, strict=True)))
    attached, moved = attach(problem, problem.held(solved), good)
    x = Shape(*(torch.where(mask, a, b) for a, b in zip(attached, x, strict=True)))
    return x, torch.where(mask, moved, reaction)
