"""Building blocks of the cases: one cantilever, sudden loads, and the balance of energy."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from .case import Answer

# a strip of L/h = 115 with L = 1: T1 = 0.8 s
BASE = dict(EA=4e4, GA=1.48e4, GJ=0.769, EI=1.0, mass=0.2, inertia=5e-6)


def section(p: Tensor, **changed: Any) -> tb.Section:
    """The base section with some values changed, in p's dtype."""

    def tensors(v):
        return [p.new_tensor(x) for x in v] if isinstance(v, tuple) else p.new_tensor(v)

    return tb.Section.from_stiffness(
        **{name: tensors(v) for name, v in {**BASE, **changed}.items()}
    )


def cantilever(
    p: Tensor, elements: int, *effects: Any, L: float = 1.0, of: Any = None, **changed: Any
) -> tb.Scene:
    return tb.Scene(
        tb.Beam.straight(p.new_tensor(L), elements, of or section(p, **changed)),
        effects,
        dtype=p.dtype,
    )


def vector(p: Tensor, *v: float) -> Tensor:
    """(B, 3)"""
    return p[:, None] * p.new_tensor(v)


def tip_force(p: Tensor, *v: float, follower: bool = False) -> tb.TipLoad:
    return tb.TipLoad(force=vector(p, *v), follower=follower)


def tip_moment(p: Tensor, *v: float) -> tb.TipLoad:
    return tb.TipLoad(moment=vector(p, *v))


def motion(scene: tb.Scene, steps: int, dt: float, **options: Any) -> tb.Solution:
    """From rest (or `initial`) over `steps` steps; at most 20 outputs after the start."""
    outputs = next(n for n in range(min(steps, 20), 0, -1) if steps % n == 0)
    # as exact as it can be in single precision, so that each output interval is a whole number of
    # steps
    t = (torch.arange(outputs + 1, dtype=torch.float64) * (steps // outputs * dt)).to(scene.dtype)
    return tb.simulate(scene, t, step=dt * 1.0001, **options)


def energy_error(sol: tb.Solution) -> Tensor:
    """(B,) the largest |kinetic + strain - work| over the largest kinetic + strain."""
    T, U, W = (x.detach() for x in sol.energy)
    start = (T + U)[:1]
    size = (T + U).abs().amax(0)
    gap = (T + U - start - W).abs().amax(0)
    return torch.where(size > 0, gap / size, gap)


def moved(sol: tb.Solution, error: Tensor | None = None) -> Answer:
    """Value: the tip at the end. Error: the energy's unless another is given."""
    return Answer(
        sol.status, sol.tip.position[-1], energy_error(sol) if error is None else error,
        sol.stats.iterations.double().mean().item(), next(iter(sol.stats.reason.values()), ""),
    )  # fmt: skip


def held(state: tb.State, error: Tensor) -> Answer:
    """Of an equilibrium. Value: the tip."""
    failed = bool((state.status != 0).any())
    return Answer(
        state.status, state.tip.position, error, why="no equilibrium was found" if failed else ""
    )
