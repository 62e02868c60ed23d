"""Equilibrium of a scene."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instant, not_here
from ..core.arguments import tolerance as check_tolerance
from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.one_thread import numbers_of, one_thread
from ..core.status import DIVERGED, first_named, kept
from ..core.validation import concrete
from ..core.warning import warn
from ..engine.chain.coverage import ENGINES
from ..equations.steady import Configuration, Past, SteadyProblem
from ..nodal.balance import Linearisation
from ..nodal.deformed_elements import warn_of_deformed
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..solvers.implicit_gradient import differentiated, implicit_gradient
from ..state.state import State, rest
from ..state.state_check import check_state
from . import relaxation
from .arc_length import LoadedProblem, where
from .ascent import ascend, poses_of_supports
from .friction import refuse_friction
from .internal_states import resting
from .lower_equilibrium import lower_equilibrium
from .mechanism import braced, stressed
from .no_equilibrium import reason
from .path import stable_branch
from .stability import HAIR, NEUTRAL, asymmetry, eigenvalues, sign, unresisted

# of the resistance of the softest motion at no load
SINGULAR = {torch.float64: 1e-6, torch.float32: 1e-4}
SWEEPS = 2  # of inverse iteration, towards the softest motion
SHARE = 1e-3  # of the loads in the softest motion: less does not bring it about
# how the warning of what is unstable ends
FALLS = "relax=True falls to it where a beam is soft, as a slack cable"
LOOKS = f"{FALLS}; branch='stable' looks for it where a column buckles"
NOT_FOUND = (
    "branch='stable' did not come to it; a load across, a millionth of what presses, says to which "
    f"side where a beam buckles alike to all, as a round column does; {FALLS}"
)


def equilibrium(
    scene: Scene,
    *,
    initial: State | None = None,
    t: float = 0.0,
    tolerance: float | None = None,
    throw: bool = True,
    branch: str = "first",
    relax: bool = False,
    engine: str = "auto",
    inputs: dict[str, Any] | None = None,
    accuracy: Any = None,
) -> State:
    """Static equilibrium under the scene's loads at time t (s). In a moving frame it is the steady
    state, with the frame as it is at t (its axes are the inertial axes at t = 0).

    Args:
        initial: start of the solution; None = undeformed, without load. Its unbalanced forces are
            removed in steps. Supported nodes move to their supports, by the shorter rotation
        tolerance: of the scaled residual, which is measured before the last update; default 1e-8 in
            float64
        throw: raise where a sample has none; else it stays, as `status` and a warning say
        branch: "first": the branch to which load steps lead. "stable": an unstable sample is
            followed again from zero load by arc length (see `path`). At a bifurcation it takes the
            new branch, to the side to which it leans
        relax: replace load steps by a motion without inertia in a viscous fluid, then use Newton's
            method. It is for large motions of little stiffness: a slack cable, a hinged beam that
            swings down. Loads grow first, or act at once on `initial`, then supports move. Under
            conservative loads it ends in a minimum of the energy. An even push along each axis, to
            both sides, tests this minimum: a RuntimeWarning names a push to a lower minimum
        engine: "eager": torch operations. "compiled": the load is raised by native code, many
            samples at once; gradients and `branch` are eager. "auto": compiled for 32,768 or more
            samples times elements (all samples of a `monte_carlo` count). It needs llvmlite and a
            scene that native code takes; else eager, with a warning. TORCHBEAM_ENGINE overrides it
        inputs: of the scene by name, (..., size)
        accuracy: relative error of positions and axes of the middle and the tip. The mesh is chosen
            by the function, see `simulate`

    Where Newton's method needs it, the load of a sample is raised in steps. A step is halved after
    a failure, a turn of a node by more than 1 rad, or, if long, six iterations. Infinite stiffness
    is exact. Differentiable by the implicit function theorem. A scene in single precision is solved
    in double, and the state rounded. Returns a `State` at rest, with stress and reaction.

    Past a point of buckling, load steps may stay on an unstable branch. A RuntimeWarning names the
    samples whose tangent is not positive definite; under loads that are not conservative
    (followers, moments in space, a turning frame) those of a negative determinant. These diverge,
    whatever their mass and damping; `modes` tells the others (`unstable`). A derivative does not
    exist at a limit point: a RuntimeError says so, or with throw=False the sample is a constant. At
    a bifurcation some do not exist: a RuntimeWarning says so.

    A pendulum is held by its loads once they stress it; a swing of more than 0.5 rad needs
    relax=True. Relaxation starts by itself where load steps fail and joints have limits. A free
    rigid motion without a load stays as it starts; derivatives hold it at the first support, or
    node 0.

    Raises:
        ValueError: for a scene that the nodal form does not take.
        RuntimeError: for a sample without equilibrium; it names a free rigid motion.

    Examples:
        >>> state = tb.equilibrium(scene)
        >>> state.tip.position, state.root.moment  # m, N m
        (tensor([0.9004, 0.0000, 0.3972]), tensor([0.0000, 1.8008, 0.0000]))
    """
    _check(accuracy, throw, branch, relax, engine)
    model = discretise(scene)
    refuse_friction(scene)
    tolerance = None if tolerance is None else check_tolerance("tolerance", tolerance)
    given, time = scene.tensors(inputs), instant("t", t, scene.beam.nodes)
    initial = None if initial is None else check_state(initial, scene)

    def found(double: Scene, *start: Any) -> State:
        here = model if double is scene else discretise(double)
        with one_thread(numbers_of(scene, initial, given)):
            return _equilibrium(here, *start, tolerance, throw, branch, relax, engine)

    return in_double(found, scene, initial, given, time)


def _check(accuracy: Any, throw: bool, branch: str, relax: bool, engine: str) -> None:
    not_here("accuracy", accuracy, "torchbeam.equilibrium")
    choice("branch", branch, ("first", "stable"))
    choice("engine", engine, ENGINES)
    boolean("relax", relax)
    if relax and engine == "compiled":
        raise ValueError("engine = 'compiled' was given with relax=True; 'eager' does that")
    boolean("throw", throw)


def _equilibrium(
    model: Model,
    initial: State | None,
    given: Inputs,
    time: Tensor,
    tolerance: float | None,
    throw: bool,
    branch: str,
    relax: bool,
    engine: str,
) -> State:
    """`equilibrium`, in the dtype of the model's scene."""
    start = model.space.start(rest(model.scene) if initial is None else initial)
    start = Configuration(start.position, start.rotation, start.stress)
    doubtful = driven = None
    # with those, the tangent of what is held is not that of what comes to rest
    judged = not model.internal_states
    begun = None if initial is None else poses_of_supports(model.scene, initial)
    past = Past.of(model.scene, initial)
    problem = SteadyProblem(model, time, given, time.new_ones(()), begun=begun, past=past)
    if initial is None:  # at no load
        start = replace(problem, load_factor=time.new_zeros(())).apply_supports(start)
    whole, begin = problem, start
    if not relax:
        start, driven = stressed(problem, start)
        problem = problem if driven is None else braced(problem, start)
    if relax:
        x, reaction, status = relaxation.relax(problem, start, tolerance, initial is not None)
        if model.conservative:  # which ends in minima
            doubtful = torch.zeros_like(status, dtype=torch.bool)
    else:
        judges = judged or branch == "stable"
        x, reaction, status, doubtful = ascend(
            problem, start, tolerance, engine, judges, initial is not None
        )
    start = Configuration(*(v.expand(*status.shape, *v.shape[-2:]) for v in start))
    problem = replace(problem, load_factor=torch.ones_like(status, dtype=time.dtype))
    problem = braced(problem, x) if relax else problem
    if driven is not None:
        x, status = where(driven, start, x), torch.where(driven, DIVERGED, status)
    if not relax and model.joints.limited and concrete(status != 0).any():
        # nothing holds a joint between its limits: load steps find no way there
        relaxed = relaxation.relax(whole, begin, tolerance, initial is not None)
        lost = status != 0
        x, reaction, status = where(lost & (relaxed[-1] == 0), relaxed, (x, reaction, status))
        problem = replace(braced(whole, x), load_factor=problem.load_factor)
        doubtful = None
    good = status == 0
    if branch == "stable":
        unstable = good & _unstable(
            problem, x, start, doubtful, torch.zeros_like(good, dtype=time.dtype)
        )
        if concrete(unstable).any():
            doubtful = None
            with no_derivatives():
                loaded = LoadedProblem(model, time, given, past=past)
                loaded = loaded.braced(start).by(engine)
                *stable, states = stable_branch(model, loaded, start, unstable, tolerance)
            x, reaction = where(states, tuple(stable), (x, reaction))
    if model.internal_states:
        problem, x, reaction, status = resting(problem, x, reaction, status, good, tolerance)
        good = good & (status == 0)
    if differentiated(problem, x) or wants_gradient(*start):
        problem, x, reaction, good = _differentiable(problem, x, reaction, start, good, throw)
    failed = status != 0
    _tell_of_lost(problem, x, status, relax, throw)
    if judged:
        _warn_of_unstable(problem, x, start, doubtful, ~failed, branch)
    if relax and model.conservative and concrete(~failed).any():
        lower = lower_equilibrium(whole, Configuration(*(v.detach() for v in x)), ~failed)
        if concrete(lower.below > 0).any():
            warn(f"{_which(lower.below > 0)} has a lower equilibrium nearby: {lower.sentence()}")
    warn_of_deformed(model, x.position, x.rotation, ~failed)
    return problem.state(x, reaction, status)


def _differentiable(
    problem: SteadyProblem,
    x: Configuration,
    reaction: Tensor,
    start: Configuration,
    good: Tensor,
    throw: bool,
) -> tuple[SteadyProblem, Configuration, Tensor, Tensor]:
    """The same, with derivatives where there are some: not at a limit point."""
    limit, fork = _singular(problem, x, start, good)
    if throw and concrete(limit).any():
        raise RuntimeError(
            f"{_which(limit)} is at a limit point: the equilibrium has no derivative by the load "
            "there (`path` goes through it)"
        )
    if concrete(fork).any():
        warn(
            f"{_which(fork)} is at a point of bifurcation: derivatives by what pushes it off its "
            "path do not exist"
        )
    good = good & ~limit
    held = {name: torch.where(good[..., None], v, v.detach()) for name, v in problem.inputs.items()}
    problem = replace(problem, inputs=held)
    return problem, *_attached(problem, x, reaction, start, good), good


def _tell_of_lost(
    problem: SteadyProblem, x: Configuration, status: Tensor, relax: bool, throw: bool
) -> None:
    """Raise, or warn, of which sample no equilibrium was found, if of any, and why."""
    failed = status != 0
    if not concrete(failed).any() or (kept(concrete(status)) and not throw):
        return
    alike = failed is not concrete(failed)  # one of many that torch.func.vmap has
    failed, status = concrete(failed), concrete(status)
    which = _which(failed) if failed.ndim else "the scene"
    first = None if alike else tuple(failed.nonzero()[0].tolist())
    why = reason(problem, x, int(status[failed][0]), first, relax)
    sentence = f"found no equilibrium of {which}: {why}"
    if throw:
        raise RuntimeError(sentence)
    warn(sentence)


def _warn_of_unstable(
    problem: SteadyProblem,
    x: Configuration,
    start: Configuration,
    doubtful: Tensor | None,
    states: Tensor,
    branch: str,
) -> None:
    """Of the samples `states`; doubtful: see `_unstable`."""
    doubtful = None if doubtful is None else doubtful & states
    unstable = states & _unstable(problem, x, start, doubtful)
    if concrete(unstable).any():
        warn(
            f"{_which(unstable)} is in unstable equilibrium: a small disturbance or imperfection "
            f"leads to another ({NOT_FOUND if branch == 'stable' else LOOKS})"
        )


def _which(mask: Tensor) -> str:
    return first_named(concrete(mask), "the beam")


def _tangent(problem: SteadyProblem, x: Configuration) -> Linearisation:
    return problem.linearise(x, *problem.residual(x)[1:])


def _unstable(
    problem: SteadyProblem,
    x: Configuration,
    start: Configuration,
    doubtful: Tensor | None,
    uneven: Tensor | None = None,
) -> Tensor:
    """(...) whether a pivot is negative by more than `unresisted`, and next to nothing beside the
    softest one at no load; doubtful: samples whose tangent is not positive definite, None = not
    known. What rounding leaves of a motion that nothing resists has no sign. Of a tangent K
    whose `asymmetry`, uneven (...), None = not known, is no hair beside that pivot: whether its
    determinant is negative, and no pivot next to nothing. Then det(M s^2 + D s + K) has a zero
    s > 0, whatever mass and damping are, as it is positive for large s: a motion grows without
    oscillating. (Where it is positive two may, or one may flutter.)
    """
    if doubtful is not None and not concrete(doubtful).any():
        return doubtful
    few = None if doubtful is None else BatchSubset.worthwhile(doubtful)
    if few is not None:
        with suppress(NotSeparable):
            at, begin = (Configuration(*(few.take(v, 2) for v in shape)) for shape in (x, start))
            uneven = None if uneven is None else few.take(uneven, 0)
            unstable = _unstable(few.gather(problem), at, begin, None, uneven)
            return few.put(torch.zeros_like(doubtful), unstable, 0)
    with no_derivatives():
        tangent = _tangent(problem, x)
        doubtful = ~tangent.system.positive_definite()
        if not concrete(doubtful).any():
            return doubtful
        uneven = asymmetry(problem, x) if uneven is None else uneven
        unloaded, size = _tangent(problem, start), problem.model.unit
        (here, sound), (usual, _) = (k.system.pivots(size) for k in (tangent, unloaded))
        none = unresisted(problem, x, here)
        soft, least = (torch.linalg.svdvals(p).amin((-1, -2)) for p in (here, usual))
        diverges = sound & (sign(here) < 0) & (soft > torch.maximum(NEUTRAL * least, none))
        soft, least = (eigenvalues(p).amin((-1, -2)) for p in (here, usual))
        negative = (soft < -torch.maximum(NEUTRAL * least, none)) | ~sound
        return doubtful & torch.where(uneven <= HAIR * -soft.clamp(max=0), negative, diverges)


def _singular(
    problem: SteadyProblem, x: Configuration, start: Configuration, good: Tensor
) -> tuple[Tensor, Tensor]:
    """(...) whether the softest motion is resisted by next to nothing beside that at no load: at a
    limit point, where the load brings that motion about, or at a point of bifurcation, where it
    does not. (A pivot may be next to nothing past a point of buckling and no motion soft: that of a
    part of the beam whose other nodes are held.)
    """
    with no_derivatives():
        (soft, share), (usual, _) = (_softness(problem, at) for at in (x, start))
        singular = good & (soft < SINGULAR[x.stress.dtype] * usual)
        limit = singular & (share > SHARE)
        return limit, singular & ~limit


def _softness(problem: SteadyProblem, x: Configuration) -> tuple[Tensor, Tensor]:
    """(...) the resistance N/m of the softest motion, and the share that a change of the loads by
    themselves has in it, by `Model.unit`.
    """
    residual, *about = problem.residual(x)
    tangent, none = problem.linearise(x, *about), torch.zeros_like(residual.strain)
    unloaded = replace(problem, load_factor=torch.zeros_like(problem.load_factor)).residual(x)[0]
    size = problem.model.unit[..., None, :]
    load = (residual.nodes - unloaded.nodes) * problem.model.constraints.moving * size
    soft = torch.cos(1.0 + torch.arange(math.prod(load.shape[-2:])).to(load)).view(load.shape[-2:])
    for _ in range(SWEEPS):
        length = torch.linalg.vector_norm(soft, dim=(-1, -2), keepdim=True)
        soft = tangent.solve((soft / length).expand_as(load) / size, none)[0] / size
    length, most = (torch.linalg.vector_norm(v, dim=(-1, -2)) for v in (soft, load))
    share = (soft * load).sum((-1, -2)).abs() / (length * most)
    return 1 / length, torch.where(most > 0, share, 0.0)


def _attached(
    problem: SteadyProblem, x: Configuration, reaction: Tensor, start: Configuration, good: Tensor
) -> tuple[Configuration, Tensor]:
    """The solution with its derivatives, those by the supports included, whose place and axes come
    from the scene. A sample that is not good keeps its shape and has none.
    """
    mask = good[..., None, None]
    safe = Configuration(
        start.position.detach(), start.rotation.detach(), torch.zeros_like(start.stress)
    )
    solved = Configuration(*(torch.where(mask, a, b) for a, b in zip(x, safe, strict=True)))
    attached, moved = implicit_gradient(problem, problem.apply_supports(solved), good)
    x = Configuration(*(torch.where(mask, a, b) for a, b in zip(attached, x, strict=True)))
    return x, torch.where(mask, moved, reaction)
