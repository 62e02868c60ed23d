"""Ascent to an equilibrium: from no load, by load steps, or from a shape that is given, by taking
away what it lacks in balance; natively or eagerly.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..engine.chain import load_climb as compiled
from ..engine.chain.coverage import refused
from ..equations.load_steps import climb
from ..equations.steady import Configuration, Poses, SteadyProblem
from ..scene.scene import Scene
from ..state.state import State
from .arc_length import where

Ascent = tuple[Configuration, Tensor, Tensor, Tensor | None]  # shape, reaction, status, doubtful


def ascend(
    problem: SteadyProblem,
    start: Configuration,
    tolerance: float | None,
    engine: str,
    judged: bool,
    loaded: bool,
) -> Ascent:
    """From a start to the whole load of a problem: (shape, reaction, status, doubtful), of which
    the last is as in `load_climb.Climbed`; judged: likewise. loaded: the start is no shape at no
    load. Native code then tries it in one step alone, and what is left is done eagerly; so are
    samples that fail while springs and obstacles rise with the load: with these in full; and those
    that their loads pull tight: from the stress of small displacements.
    """
    out = _ascend(problem, start, tolerance, engine, judged, loaded)
    if not loaded and concrete(left := out[2] != 0).any():
        out = _again_if_taut(problem, start, tolerance, left, out)
    scene, left = problem.model.scene, out[2] != 0
    resisting = any(act.resists for act in (*scene.loads, *scene.interactions))
    if loaded or not resisting or not concrete(left).any():
        return out
    # springs that rise with the load leave the shape as soft as at no load
    whole, none = replace(problem, resisting=True), torch.zeros_like(problem.load_factor)
    x, _, status = climb(replace(whole, load_factor=none).relieved(start), start, tolerance, left)
    again = climb(whole, x, tolerance, left & (status == 0))
    return _with(out, again, left)


def _again_if_taut(
    problem: SteadyProblem, start: Configuration, tolerance: float | None, left: Tensor, out: Ascent
) -> Ascent:
    """out, with the samples `left` tried again where small displacements put all elements in
    tension. That stress resists motions across, which a soft beam at no load hardly does.
    """
    with no_derivatives():
        at_rest = problem.apply_supports(start)
        residual, *about = problem.residual(at_rest)
        change = problem.linearise(at_rest, *about).solve(residual.nodes, residual.strain)[1]
        stress = start.stress + change
        left = left & (stress[..., 0] > 0).all(-1)
        if not concrete(left).any():
            return out
        stress = torch.where(left[..., None, None], stress, start.stress)
        return _with(out, climb(problem, start._replace(stress=stress), tolerance, left), left)


def _with(out: Ascent, again: tuple[Configuration, Tensor, Tensor], left: Tensor) -> Ascent:
    """out, with what was found `again` of the samples `left` where it is an equilibrium."""
    left = left & (again[2] == 0)
    doubtful = None if out[3] is None else out[3] | left
    return *where(left, again, out[:3]), doubtful


def _ascend(
    problem: SteadyProblem,
    start: Configuration,
    tolerance: float | None,
    engine: str,
    judged: bool,
    loaded: bool,
) -> Ascent:
    """`ascend`, with all that acts raised together."""
    states = None
    if problem.past is not None:
        if engine == "compiled":
            raise ValueError(refused("an initial state that remembers"))
    elif engine != "eager" and type(problem) is SteadyProblem:
        native = compiled.climb if engine == "compiled" else compiled.automatic_climb
        of = problem.model, problem.t, problem.inputs
        states = native(*of, start, tolerance, judged, loaded)
    if states is None:
        return *climb(problem.relieved(start) if loaded else problem, start, tolerance), None
    x, reaction, status, doubtful = states
    left = status != 0
    if not loaded or not concrete(left).any():
        return states
    again = climb(problem.relieved(start), start, tolerance, left)
    doubtful = None if doubtful is None else doubtful | left
    return *where(left, again, (x, reaction, status)), doubtful


def poses_of_supports(scene: Scene, state: State) -> Poses | None:
    """Where a state has them; None = none has a motion."""
    if not any(support.displaced for support in scene.supports):
        return None
    nodes = [support.node for support in scene.supports]
    return Poses(state.position[..., nodes, :].detach(), state.rotation[..., nodes, :].detach())
