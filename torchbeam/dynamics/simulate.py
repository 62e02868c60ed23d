"""simulate: a scene over time, by any form and method."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint as recompute

from ..core.arguments import boolean, choice, chosen, count, instance, keywords, step_size
from ..core.arguments import function as check_function
from ..core.arguments import instants as check_instants
from ..core.arguments import options as check_options
from ..core.derivatives import no_derivatives
from ..core.functions_of_time import within_dual_numbers
from ..core.leaves import constant
from ..core.memory import check_memory
from ..core.status import FAILED, STATUS
from ..core.validation import as_tensor, broadcast, concrete, increasing, shown
from ..core.warning import warn
from ..math.shapes import broadcast_shapes
from ..nodal.model import Model
from ..nodal.penetration import refuse_penetration
from ..nodal.rates import Rates
from ..scene.effects import PerInterval, changing, inputs_at
from ..scene.prescribed_motion import oriented
from ..scene.scene import Scene, merge_inputs
from ..solvers.newton import LIMIT
from ..state.reduced import ReducedStates, joined, whole_of
from ..state.solution import Energy, Solution, Stats
from ..state.start import on_supports
from ..state.state import State, check_state, resting, with_optional_fields
from .adaptive import adaptive
from .events import Events
from .failure import Failures
from .make_steps import StepPlan, make_steps
from .methods import METHODS as IMPLICIT_METHODS
from .mixed_forms import simulate_mixed
from .prepared import prepared
from .rollout import check_room
from .runaway import SENTENCE, stopped
from .step_inputs import StepInputs, inputs_of_steps
from .stepper import HALVINGS, Stepper
from .tolerance import Tolerance
from .torchdiffeq_bridge import ADAPTIVE, ADVICE, integrate, leaves
from .torchdiffeq_bridge import METHODS as ODE_METHODS

FORMS = ("nodal", "minimal", "block_rate")
PLAN = 200  # bytes of one step in it
MAX_STEPS = 100_000  # of adaptive steps in a run
STEPS = 200  # of the default step, over the whole of t
TOLERANCES = "rtol", "atol"  # of implicit methods: adaptive steps
FIXED = "step", "checkpoint", "progress"  # options of steps that are given


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
) -> Solution:
    """Motion of a scene at the instants t.

    Methods: None is "midpoint" of the nodal form and "dopri5" of the others.
    "midpoint" (implicit, mean strain, second order), "midpoint4" (of fourth order, see
    `torchbeam.dynamics.midpoint4`) and "generalized_alpha" are of the nodal form, by steps of a
    given length or, but for the last, by adaptive ones, each sample's own. Any method of
    torchdiffeq is explicit, of any form: it steps with the highest frequency of the mesh, so stiff,
    long or batched scenes want "midpoint"; one of fixed steps that are longer than that makes
    energy, and a sample of the nodal form then gets a status and keeps the last output before. An
    option that the method does not have is refused.

    Args:
        scene: what is simulated; its tensors may carry gradient, and everything is differentiable.
        t: (time,) s, strictly increasing; the first is that of the initial state.
        initial: a state of the form; None = undeformed and at rest. What supports hold has to be
        where they have it at t[0],
            see `Support`, and at rest where neither they nor frame a move: `rest`, `equilibrium`,
            `State.from_nodes` and states of a solution are. What is off by rounding is put there.
            Of a state of another time than t[0] frame a turns on until then, see `State.frame`.
        method: by name, see above.
        form: "nodal" (energy consistent, the work horse), "minimal" or "block_rate" (the
            index-reduced derivation).
        inputs: of the scene, by name: (..., size) held throughout; a function of t: "midpoint"
            takes it at mid step, "midpoint4" at that of each solve, "generalized_alpha" at its end;
            or, for these, `PerInterval`: values (..., time - 1, size), each held over one of the
            intervals of t.
        step: s, of implicit methods; each interval of t is split into ceil(interval/step) equal
            steps. None: the shortest interval, or 1/200 of the whole, whichever is less.
        rtol, atol: of implicit methods: adaptive steps (see `torchbeam.dynamics.adaptive`). The
            largest error of a position over the run is to be at most atol m + rtol times the length
            of the beam, that of a rotation rtol + atol/length rad (see `Tolerance`; measured on
            positions, rotations of light undamped nodes have missed it by 2.4); numbers, or (...).
            Of torchdiffeq's: numbers, None = 1e-6 and 1e-8.
        events: with adaptive steps: a function of the state that gives one number (...) a sample,
            or a list of such: a sample stops where one crosses zero, and `sol.event` says which,
            when and how.
        max_steps: adaptive steps in a run, at most.
        first_step: s, of adaptive steps; None = found by a trial.
        engine, lumped, conserve, rho_inf, tolerance, iterations, halvings: of implicit methods, see
        `Stepper`. checkpoint: keep the graph at sqrt(steps) instants and compute the rest again in
        backward: long horizons then fit in
            memory, for one more forward. Nothing under torch.autograd.forward_ad, whose derivatives
            go forward with the steps: they are right, and need no memory of the past.
        progress: called with (steps done, steps in all) after each step of a given length.
        options, adjoint: of torchdiffeq's methods, see
            `torchbeam.dynamics.torchdiffeq_bridge.integrate`.
        begin: of torchdiffeq's methods: (...) s, the instant of each sample from which t counts;
            None = t is that of all.
        project, solver: of the form "block_rate", see
            `torchbeam.dynamics.mixed_forms.simulate_mixed`.
        throw: raise where a sample fails; otherwise `sol.status` and a warning say so, and it keeps
            its last good state.

    Returns:
        `Solution`: the states at t, status (...) of the samples, statistics.

    Raises:
        ValueError: for a t that does not increase, an unknown form or method, an option that the
        method does not have. RuntimeError: with `throw`, where a sample fails.
    """
    choice("form", form, FORMS)
    method = ("midpoint" if form == "nodal" else "dopri5") if method is None else method
    if not isinstance(method, str) or method not in (*IMPLICIT_METHODS, *ODE_METHODS):
        names = dict.fromkeys((*IMPLICIT_METHODS, *ODE_METHODS))
        raise ValueError(f"method = {shown(method)} was given; there are {', '.join(names)}")
    instance("a scene", scene, Scene)
    switches = dict(
        throw=throw,
        lumped=lumped,
        conserve=conserve,
        checkpoint=checkpoint,
        adjoint=adjoint,
        project=project,
    )
    for name, value in switches.items():
        boolean(name, value)
    begin = None if begin is None else check_instants("begin", begin, scene.beam.nodes)
    given = chosen(
        simulate,
        dict(
            step=step,
            rtol=rtol,
            atol=atol,
            events=events,
            max_steps=max_steps,
            first_step=first_step,
            engine=engine,
            lumped=lumped,
            conserve=conserve,
            rho_inf=rho_inf,
            tolerance=tolerance,
            iterations=iterations,
            halvings=halvings,
            checkpoint=checkpoint,
            progress=progress,
            options=options,
            adjoint=adjoint,
            begin=begin,
            project=project,
            solver=solver,
        ),
    )
    t = increasing("t", as_tensor(t, scene.dtype, scene.device))
    mixed, implicit = form != "nodal", method in IMPLICIT_METHODS
    controlled = not mixed and implicit and any(name in given for name in TOLERANCES)
    if controlled and (fixed := [name for name in FIXED if name in given]):
        raise ValueError(
            f"{fixed[0]} was given with rtol or atol, which choose the steps; one of them is wanted"
        )
    if not controlled and events is not None:
        raise ValueError(
            "events were given without rtol or atol; the adaptive steps of an implicit method "
            "take them"
        )
    known = keywords(
        *(
            (simulate_mixed,)
            if mixed
            else (_adaptive, Stepper)
            if controlled
            else (_implicit, Stepper)
            if implicit
            else (_explicit,)
        )
    )
    check_options(f"form {form!r}" if mixed else f"method {method!r}", given, known)
    inputs = merge_inputs(inputs, {})
    if (mixed or not implicit) and any(isinstance(value, PerInterval) for value in inputs.values()):
        raise ValueError(
            f"a PerInterval input was given to {method!r}; 'midpoint' and 'generalized_alpha' of "
            "the nodal form take it, and ExplicitStepper holds inputs over its steps"
        )
    if mixed:
        return _judged(
            simulate_mixed(scene, t, form, initial, method, inputs=inputs, **given), throw
        )
    run = _adaptive if controlled else _implicit if implicit else _explicit
    return _judged(run(scene, t, initial, method, inputs, **given), throw, warned=implicit)


def _implicit(
    scene: Scene,
    t: Tensor,
    initial: State | None,
    method: str,
    inputs: dict[str, Any],
    *,
    step: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    checkpoint: bool = False,
    **options: Any,
) -> Solution:
    if progress is not None:
        check_function("progress", progress, "done", "steps")
    instants = concrete(t).tolist()
    gaps, whole = [b - a for a, b in pairwise(instants)], instants[-1] - instants[0]
    step = step_size("step", step) if step is not None else min(*gaps, whole / STEPS)
    check_memory(
        f"the plan of {whole / step:.3g} steps of {step:g} s",
        PLAN * whole / step,
        "a longer step is wanted",
    )
    # of an interval, in steps
    rounding = 1e-6 + 2 * torch.finfo(t.dtype).eps * max(map(abs, instants)) / step
    counts = [max(1, math.ceil(gap / step - rounding)) for gap in gaps]
    plan = [(k, i) for k, count in enumerate(counts) for i in range(count)]  # interval, step in it
    lengths, begins = t.diff(), t[:-1]
    if len(plan) > len(counts):
        interval, part = (torch.tensor(x, device=t.device) for x in zip(*plan, strict=True))
        lengths = (lengths / t.new_tensor(counts))[interval]
        begins = begins[interval] + part * lengths
    stepper = prepared(scene, step, method, **options)
    changing(inputs, len(counts))
    first = inputs_at(inputs, t[0], t)
    start = stepper._begin(_begin(stepper.model, initial, t[0]), lengths[0], inputs=first)
    begun = stepper.remember(start, stepper.reduced(start), well=False)
    check_room(stepper, start, first, len(plan), len(t), checkpoint)
    names, reported = tuple(vars(start)), 0

    def kind(*values: Any) -> State:
        return type(start)(**dict(zip(names, values, strict=True)))

    def inputs_of(first: int, end: int) -> StepInputs:
        rows = slice(first, end)
        return inputs_of_steps(
            scene, inputs, stepper.method, begins[rows], lengths[rows], [k for k, _ in plan[rows]]
        )

    steps = StepPlan(lengths, begins, inputs_of, wanted=[i == counts[k] - 1 for k, i in plan])

    def carry_out(
        begin: int, end: int, state: State
    ) -> tuple[list[State], Callable[[], State], Tensor]:
        """States that are wanted of a part of the plan, in the space's coordinates; the last, a
        public one; iterations.
        """
        nonlocal reported
        states, iterations, done = [], [], begin
        for few in make_steps(stepper, state, steps.part(begin, end)):
            states.append(few.states())
            iterations.append(few.iterations)
            for _ in range(len(few.iterations)):
                done += 1
                # not again where backward makes a part once more
                if progress is not None and done > reported:
                    reported = done
                    progress(done, len(plan))
        return states, few.last, joined(*iterations)

    def flat(begin: int, end: int, *fields: Tensor) -> tuple[Tensor, ...]:
        """The same, from tensors to tensors."""
        states, last, iterations = carry_out(begin, end, kind(*fields))
        return *vars(whole_of(states)).values(), *vars(last()).values(), iterations

    checkpoint = checkpoint and not within_dual_numbers()  # hooks on saved tensors do not take them
    size, length = len(names), math.isqrt(len(plan)) if checkpoint else len(plan)
    parts, state, iterations = [begun.map(lambda x: x[None])], start, []
    for done in range(0, len(plan), length):
        span = done, min(done + length, len(plan))
        if checkpoint:
            *tensors, count = recompute(flat, *span, *vars(state).values(), use_reentrant=False)
            states, state = [kind(*tensors[:size])], kind(*tensors[size:])
        else:
            states, _, count = carry_out(*span, state)
        parts += states
        iterations.append(count)
    stats = Stats(
        steps=len(plan),
        iterations=joined(*iterations),
        reason=stepper.failures.reasons(),
        engine=stepper.engine,
    )
    states = ReducedStates(tuple(parts), stepper.model.space)
    return Solution(t, states, partial(_energy, stepper.model, states, t, inputs), stats)


def _adaptive(
    scene: Scene,
    t: Tensor,
    initial: State | None,
    method: str,
    inputs: dict[str, Any],
    *,
    rtol: Any = None,
    atol: Any = None,
    events: Any = None,
    max_steps: int = MAX_STEPS,
    first_step: float | None = None,
    **options: Any,
) -> Solution:
    if method == "generalized_alpha" or options.get("conserve"):
        what = "conserve" if options.get("conserve") else "generalized_alpha"
        raise ValueError(
            f"rtol or atol was given to {what}, whose error is no series in even powers of the "
            "step; 'midpoint' without conserve takes them"
        )
    if method == "midpoint4" and any(callable(value) for value in inputs.values()):
        raise ValueError(
            "rtol or atol was given to midpoint4 with an input that is a function of t; a load "
            "that is one is wanted, or 'midpoint'"
        )
    most, tolerance = count("max_steps", max_steps), Tolerance.of(scene, rtol, atol)
    events = Events.of(events)
    first = None if first_step is None else step_size("first_step", first_step)
    stepper = prepared(scene, (concrete(t[-1]) - concrete(t[0])).item() / STEPS, method, **options)
    changing(inputs, len(t) - 1)
    given = inputs_at(inputs, t[0], t)
    start = stepper._begin(_begin(stepper.model, initial, t[0]), inputs=given)
    with no_derivatives():  # functions of time bring batch axes, which a step shows
        wide = stepper.advance(start.detach(), given, dt=stepper.dt.detach(), t=t[0]).batch_shape
    start = start.broadcast(broadcast_shapes(wide, tolerance.position.shape))
    stepper.failures = Failures()
    held = {
        name: v if isinstance(v, PerInterval) or callable(v) else scene_value
        for name, scene_value in scene.tensors(given).items()
        for v in (inputs[name],)
    }
    solution = adaptive(stepper, start, t, held, tolerance, events, most, first)
    lengths, level = solution.steps.sequence.instants.diff(dim=0), solution.proof.level
    stats = Stats(
        steps=int((solution.steps.sequence.counts * 2**level).max()),
        lengths=lengths,
        level=level,
        rejected=solution.steps.rejected,
        error=solution.proof.error * tolerance.position,
        reason=stepper.failures.reasons(),
        engine=stepper.engine,
    )
    return Solution(
        t,
        solution.states,
        partial(_energy, stepper.model, solution.states, t, inputs),
        stats,
        solution.event,
    )


def _explicit(
    scene: Scene,
    t: Tensor,
    initial: State | None,
    method: str,
    inputs: dict[str, Any],
    *,
    rtol: float = 1e-6,
    atol: float = 1e-8,
    options: dict[str, Any] | None = None,
    adjoint: bool = False,
    begin: Tensor | None = None,
) -> Solution:
    """`begin` (...) s: the instant of each sample from which t counts; None = t is that of all."""
    instants = t if begin is None else [begin + now for now in t]
    held = {name: value for name, value in inputs.items() if not callable(value)}
    moving = {name: value for name, value in inputs.items() if callable(value)}
    rates = Rates.of(scene, scene.tensors({**held, **inputs_at(moving, instants[0], t)}))

    def rhs(now: Tensor, y: Tensor) -> Tensor:
        now = now if begin is None else begin + now
        return (
            Rates(rates.model, scene.tensors({**held, **inputs_at(moving, now, now)}))
            if moving
            else rates
        )(now, y)

    first = instants[0]
    y0 = rates.pack(_begin(rates.model, initial, first))
    broadcast("a scene, an initial state and begin", y0.shape[:-1], first.shape)
    # functions and inputs may have axes too
    acting = rates.balance(rates.conditions(first), rates.unpack(first, y0)[0])[0]
    y0 = y0.expand(*broadcast_shapes(y0.shape[:-1], acting.shape[:-2], first.shape), -1)
    ys, status, evaluations = integrate(
        rhs,
        y0,
        t,
        method=method,
        rtol=rtol,
        atol=atol,
        options=options,
        adjoint=adjoint,
        parameters=leaves(rhs, y0.detach(), t, adjoint),
    )
    trajectory = State.stack([rates.state(*at) for at in zip(instants, ys, status, strict=True)])
    reason = {FAILED: f"{method} failed; {ADVICE}"} if status.any() else {}
    if method not in ADAPTIVE:
        trajectory, lost = stopped(
            rates.model, trajectory, partial(_energy, rates.model, trajectory, instants, inputs)
        )
        if number := int(concrete(lost).sum()):
            reason = {FAILED: f"{method} {SENTENCE}; {ADVICE}"}
            warn(f"{reason[FAILED]} ({number} of {lost.numel()} samples)")
    energy = partial(_energy, rates.model, trajectory, instants, inputs)
    return Solution(
        t, trajectory, energy, Stats(evaluations=evaluations, reason=reason, engine="eager")
    )


def _begin(model: Model, initial: State | None, t: Tensor) -> State:
    start = _started(model, initial, t)
    refuse_penetration(model, start, t)
    return start


def _started(model: Model, initial: State | None, t: Tensor) -> State:
    scene = model.scene
    start = resting(scene, scene.batch_shape, t) if initial is None else check_state(initial, scene)
    if initial is not None or scene.has_prescribed_motion:
        model.space.start(start)  # says so where it does not fit
    if initial is None:
        return start
    start = with_optional_fields(start.broadcast(), scene)
    if start.frame is not None:  # it turns on from the state's own time
        start = replace(start, frame=oriented(scene, start.frame, start.t, t))
    return on_supports(start, scene, t).broadcast().at(t)


def _energy(
    model: Model, states: State | ReducedStates, t: Iterable[Tensor], inputs: dict[str, Any]
) -> Energy:
    """Of states at the instants t; the beam's eigenstrain is that of the instant."""
    states = states.whole() if isinstance(states, ReducedStates) else model.space.to_reduced(states)
    work = states.work
    kinetic = model.kinetic_energy(states.rotation, states.velocity, states.spin)
    if not model.scene.eigenstrains:
        return Energy(kinetic, model.strain_energy(states.position, states.rotation), work)
    if all(map(constant, model.scene.eigenstrains)):
        own = model.eigenstrain(states.t, {})
        return Energy(kinetic, model.strain_energy(states.position, states.rotation, own), work)
    own = [
        model.eigenstrain(
            now, model.scene.tensors(inputs_at(inputs, now, now, interval=max(k - 1, 0)))
        )
        for k, now in enumerate(t)
    ]
    strain = [
        model.strain_energy(*at) for at in zip(states.position, states.rotation, own, strict=True)
    ]
    return Energy(kinetic, torch.stack(strain), work)


def _judged(solution: Solution, throw: bool, warned: bool = False) -> Solution:
    """The solution, with a sentence on every kind of failure in its stats; raised, or warned of
    where the solver has not.
    """
    statuses = concrete(solution.states.status)
    if not statuses.any():
        return solution
    status, steps = statuses[-1], (statuses == 0).sum(0)
    for code in sorted(set(status.flatten().tolist()) - {0}):
        failed = (status == code).nonzero().tolist()
        which = (
            f"sample {failed[0][0] if len(failed[0]) == 1 else tuple(failed[0])}"
            if failed[0]
            else "the sample"
        )
        moved = steps.flatten()[(status == code).flatten().nonzero()[0, 0]]
        when = solution.t[max(int(moved) - 1, 0)].item()
        shown = solution.stats.reason.get(code)
        sentence = (
            f"{which} ({len(failed)} of {status.numel()}) stopped after t = {when:.6g} s: "
            f"{shown or STATUS[code]}"
        )
        solution.stats.reason[code] = sentence
        if throw:
            raise RuntimeError(sentence)
        if warned:
            warn(sentence)
    return solution
