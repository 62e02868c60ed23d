"""simulate: a scene over time, by any form and method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instance, keywords, non_default, not_here
from ..core.arguments import instants as check_instants
from ..core.arguments import options as check_options
from ..core.docstrings import with_arguments_of
from ..core.one_thread import numbers_of, one_thread
from ..core.status import STATUS, kept, stopped
from ..core.validation import as_tensor, concrete, dtype_of, increasing, shown
from ..core.warning import warn
from ..scene.effects import PerInterval
from ..scene.inputs import merge_inputs
from ..scene.scene import Scene
from ..solvers.newton import LIMIT
from ..state.solution import Solution
from .forms import FORMS, mixed_forms
from .instants import explicit_instants
from .methods import METHODS as IMPLICIT_METHODS
from .runs import MAX_STEPS, adaptive_run, explicit_run, implicit_run
from .stepper import HALVINGS, Stepper
from .torchdiffeq_bridge import METHODS as ODE_METHODS

TOLERANCES = "rtol", "atol"  # of implicit methods: adaptive steps
FIXED = "step", "checkpoint", "progress"  # options of steps that are given
SWITCHES = "throw", "lumped", "conserve", "checkpoint", "adjoint", "project"
OF_ALL = "form", "inputs", "throw", "accuracy"  # keywords that are no options of a method


class StepOptions:
    """Options of implicit methods. Steps have a fixed length, or are adaptive with `rtol` or
    `atol`.

    Args:
        step: s, of implicit methods; each interval of t is split into ceil(interval/step) equal
            steps. None: the shortest interval, or 1/200 of the whole, whichever is less.
        rtol, atol: of implicit methods: adaptive steps (see `torchbeam.dynamics.adaptive`);
            numbers, or (...). They bound the largest error over the run (see `Tolerance`). The
            bound is atol m + rtol times the length of the beam for a position, and rtol +
            atol/length rad for a rotation. The error is measured on positions; rotations in
            undamped twist were off by up to 4.1 times that bound. For torchdiffeq's methods:
            numbers, None = 1e-6 and 1e-8.
        events: with adaptive steps: a function of the state that returns one number (...) a sample,
            of that sample alone, or a list of such. A sample stops where one crosses zero, and
            `sol.event` says which, when and how.
        max_steps: adaptive steps in a run, at most.
        first_step: s, of adaptive steps; None = found by a trial.
        engine, lumped, conserve, rho_inf, tolerance, iterations, halvings: of implicit methods, see
            `Stepper`.
        checkpoint: keep the graph at sqrt(steps) instants and compute the rest again in backward.
            Long horizons then fit in memory, for one more forward run. It does nothing under
            torch.autograd.forward_ad, whose derivatives go forward with the steps and need no
            memory of the past.
        progress: called with (steps done, steps in all) after each step of a given length.
    """


class IntegratorOptions:
    """Of torchdiffeq's methods.

    Args:
        options, adjoint: of torchdiffeq's methods, see
            `torchbeam.dynamics.torchdiffeq_bridge.integrate`.
        begin: of torchdiffeq's methods: (...) s, the instant of each sample from which t counts;
            None = t is that of all.
        project, solver: of the form "block_rate", see
            `torchbeam.mixed.simulate.simulate_mixed`.
    """


@with_arguments_of(StepOptions, IntegratorOptions)
def simulate(
    scene: Scene,
    t: Any,
    initial: Any = None,
    method: str | None = None,
    *,
    form: str = "nodal",
    inputs: dict[str, Any] | None = None,
    step: float | None = None,
    rtol: Any = None,
    atol: Any = None,
    events: Any = None,
    max_steps: int = MAX_STEPS,
    first_step: float | None = None,
    engine: str = "auto",
    lumped: bool = False,
    conserve: bool = False,
    rho_inf: float | None = None,
    tolerance: float | None = None,
    iterations: int = LIMIT,
    halvings: int = HALVINGS,
    checkpoint: bool = False,
    progress: Callable[[int, int], None] | None = None,
    options: dict[str, Any] | None = None,
    adjoint: bool = False,
    begin: Tensor | None = None,
    project: bool = False,
    solver: str = "sweep",
    throw: bool = False,
    accuracy: Any = None,
) -> Solution:
    """Simulate a scene: its motion at the instants t.

    Methods: None is "midpoint" of the nodal form and "dopri5" of the others.

    - "midpoint" (implicit, mean strain, second order), "midpoint4" (fourth order, see
      `torchbeam.dynamics.midpoint4`) and "generalized_alpha" belong to the nodal form. Steps have a
      given length. The first two also make adaptive steps, separate for each sample.
    - All methods of torchdiffeq are explicit and take any form. They follow the highest frequency
      of the mesh, so stiff, long or batched scenes need "midpoint". Longer fixed steps create
      energy. A sample of the nodal form then gets a status and keeps its last output.

    Args:
        scene: its tensors may carry gradient, and everything is differentiable.
        t: (time,) s, strictly increasing; the first is the time of the initial state. A tensor has
            the scene's dtype; NumPy's numbers may be more precise, and are rounded to it.
        initial: a state of the form; None = undeformed and at rest. Supported nodes must be where
            their supports are at t[0], see `Support`, and at rest if neither the supports nor frame
            a move. States of `rest`, `equilibrium`, `State.from_nodes` and solutions are. Rounding
            errors are corrected. From a state of another time, frame a turns on until t[0].
        method: by name, see above.
        form: "nodal" (energy consistent, for everything), "minimal" or "block_rate" (the
            index-reduced derivation).
        inputs: of the scene, by name: (..., size) held throughout; a function of t; or for implicit
            methods `PerInterval`, values (..., time - 1, size), each held over one interval of t.
            "midpoint" evaluates a function at mid step, "midpoint4" at each solve,
            "generalized_alpha" at the end.
        throw: raise if a sample fails; otherwise `sol.status` and a warning say so, and the sample
            keeps its last good state.
        accuracy: relative error of the whole motion, in place of method and step: of positions and
            axes of the middle and the tip, as in `converge`. Or a result of `converge`. The scene
            has a single beam, which gets a new mesh, so `initial` is None or a function of its
            scene. A single search (some runs, which logging shows) serves scenes of the same
            structure whose numbers differ by up to half

    Returns:
        `Solution`: the states at t, status (...) of the samples, statistics.

    Raises:
        ValueError: for a t that does not increase, an unknown form or method, or an option that the
            method does not have.
        RuntimeError: with `throw`, if a sample fails.

    Examples:
        >>> solution = tb.simulate(scene, torch.linspace(0, 0.1, 11), step=0.01)
        >>> solution.tip.position.shape, solution.status
        (torch.Size([11, 3]), tensor(0))
        >>> sure = tb.simulate(scene, [0.0, 0.1], rtol=1e-2)  # steps by an error bound
    """
    return _simulated(locals())


def _simulated(asked: dict[str, Any]) -> Solution:
    """`simulate` of its arguments by name."""
    with one_thread(numbers_of(asked["scene"], asked["initial"], asked["inputs"])):
        return _solved(asked)


def _solved(asked: dict[str, Any]) -> Solution:
    scene, initial, form, method, throw = (
        asked[name] for name in ("scene", "initial", "form", "method", "throw")
    )
    not_here("accuracy", asked["accuracy"], "torchbeam.simulate")
    choice("form", form, FORMS)
    method = ("midpoint" if form == "nodal" else "dopri5") if method is None else method
    if not isinstance(method, str) or method not in (*IMPLICIT_METHODS, *ODE_METHODS):
        names = dict.fromkeys((*IMPLICIT_METHODS, *ODE_METHODS))
        raise ValueError(f"method = {shown(method)} was given; there are {', '.join(names)}")
    instance("a scene", scene, Scene)
    for name in SWITCHES:
        boolean(name, asked[name])
    begin = asked["begin"]
    begin = None if begin is None else check_instants("begin", begin, scene.beam.nodes)
    names = [name for name in keywords(simulate) if name not in OF_ALL]
    selected = non_default(simulate, {name: asked[name] for name in names} | dict(begin=begin))
    t = increasing("t", as_tensor(asked["t"], torch.float64, scene.device))
    digits = dtype_of(asked["t"])
    run = _run_of(form, method, selected)
    inputs = merge_inputs(asked["inputs"], {})
    if run in (adaptive_run, implicit_run):
        return _judged(
            run(scene, t, digits, initial, method, inputs, **selected), throw, warned=True
        )
    if any(isinstance(value, PerInterval) for value in inputs.values()):
        raise ValueError(
            f"a PerInterval input was given to {method!r}; 'midpoint' and 'generalized_alpha' of "
            "the nodal form take it, and ExplicitStepper holds inputs over its steps"
        )
    t = explicit_instants(scene, t, digits, begin, asked["options"])
    if run is explicit_run:
        return _judged(run(scene, t, initial, method, inputs, **selected), throw)
    return _judged(run(scene, t, form, initial, method, inputs=inputs, **selected), throw)


def _run_of(form: str, method: str, selected: dict[str, Any]) -> Callable[..., Solution]:
    """What makes the run; ValueError for options that it does not have."""
    mixed, implicit = form != "nodal", method in IMPLICIT_METHODS
    controlled = not mixed and implicit and any(name in selected for name in TOLERANCES)
    if controlled and (fixed := [name for name in FIXED if name in selected]):
        raise ValueError(
            f"{fixed[0]} was given with rtol or atol, which choose the steps; one of them is wanted"
        )
    if not controlled and "events" in selected:
        raise ValueError(
            "events were given without rtol or atol; the adaptive steps of an implicit method "
            "take them"
        )
    if mixed:
        run = mixed_forms().simulate_mixed
    else:
        run = adaptive_run if controlled else implicit_run if implicit else explicit_run
    takers = (run,) if mixed or not implicit else (run, Stepper)
    check_options(f"form {form!r}" if mixed else f"method {method!r}", selected, keywords(*takers))
    return run


def _judged(solution: Solution, throw: bool, warned: bool = False) -> Solution:
    """The solution, with a sentence on every kind of failure in its stats; raised, or warned of
    where the solver has not.
    """
    statuses = concrete(solution.states.status)
    if not statuses.any():
        return solution
    status, steps = statuses[-1], (statuses == 0).sum(0)
    warned = not kept(status) and warned
    for code in sorted(set(status.flatten().tolist()) - {0}):
        failed = status == code
        reason = solution.stats.reason.get(code) or STATUS[code]
        sentence = stopped(failed, solution.t[(steps - 1).clamp(min=0)], reason)
        solution.stats.reason[code] = sentence
        if throw:
            raise RuntimeError(sentence)
        if warned:
            warn(sentence)
    return solution
