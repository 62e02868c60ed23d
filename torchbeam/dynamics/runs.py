"""Runs of a scene over time, by steps of a given length, adaptive ones, or an explicit method."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint as recompute

from ..core.arguments import count, step_size
from ..core.arguments import function as check_function
from ..core.derivatives import no_derivatives
from ..core.functions_of_time import within_dual_numbers
from ..core.leaves import constant
from ..core.memory import check_memory
from ..core.status import DIVERGED, FAILED, UNDERFLOW
from ..core.validation import broadcast, concrete
from ..core.warning import warn
from ..math.shapes import broadcast_shapes, largest
from ..nodal.blow import warn_of_blow
from ..nodal.deformed_elements import suspects, unsteppable, warn_of_deformed
from ..nodal.model import Model
from ..nodal.penetration import refuse_penetration
from ..nodal.rates import Rates
from ..scene.effects import PerInterval, changing, inputs_at
from ..scene.prescribed_motion import oriented
from ..scene.scene import Scene
from ..state.reduced import ReducedStates, joined, whole_of
from ..state.solution import Energy, Solution, Stats
from ..state.start import on_supports, warn_of_kink
from ..state.state import State, resting
from ..state.state_check import check_state, with_optional_fields
from .adaptive import adaptive
from .events import Events
from .failure import Failures
from .instants import check_digits
from .make_steps import StepPlan, make_steps
from .prepared import prepared
from .rollout import check_room
from .runaway import SENTENCE, stopped
from .step_control import LEAST_STEPS
from .step_inputs import StepInputs, inputs_of_steps
from .tolerance import Tolerance
from .torchdiffeq_bridge import ADAPTIVE, ADVICE, integrate, leaves

PLAN = 200  # bytes of one step in it
NO_STEP = "Newton's method did not converge in steps of this tolerance; a smaller rtol may help"
MAX_STEPS = 100_000  # of adaptive steps in a run
STEPS = 200  # of the default step, over the whole of t
LOOKED_AT = 3_000_000  # numbers of positions; of more instants the first and the last are looked at
FINER = 64  # times the first step that is tried: most steps of an adaptive run are longer


def default_step(instants: Sequence[float]) -> float:
    """s, where none is given: of the shortest interval, and a part of the whole."""
    gaps = (b - a for a, b in pairwise(instants))
    return min(*gaps, (instants[-1] - instants[0]) / STEPS)


def implicit_run(
    scene: Scene,
    t: Tensor,
    digits: torch.dtype,
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
    step, counts, lengths, begins = _equal_steps(t, digits, step, scene.dtype)
    plan = [(k, i) for k, count in enumerate(counts) for i in range(count)]  # interval, step in it
    t = t.to(scene.dtype)
    lengths, known = lengths.to(t), begins.to(t)
    stepper = prepared(scene, step, method, **options)
    changing(inputs, len(counts))
    first = inputs_at(inputs, t[0], t)
    start = _begin(stepper.model, initial, t[0])
    warn_of_blow(stepper.model, start, lengths[0])
    start = stepper._begin(start, lengths[0], inputs=first)
    begun = stepper.remember(start, stepper.reduced(start), well=False)
    check_room(stepper, start, first, len(plan), len(t), checkpoint)
    names, reported = tuple(vars(start)), 0

    def kind(*values: Any) -> State:
        return type(start)(**dict(zip(names, values, strict=True)))

    def inputs_of(first: int, end: int) -> StepInputs:
        rows = slice(first, end)
        return inputs_of_steps(
            scene, inputs, stepper.method, known[rows], lengths[rows], [k for k, _ in plan[rows]]
        )

    steps = StepPlan(lengths, begins, inputs_of, wanted=[i == counts[k] - 1 for k, i in plan])

    def carry_out(
        begin: int, end: int, state: State
    ) -> tuple[list[State], Callable[[], State], Tensor]:
        """States that are wanted of a part of the plan, reduced; the last, public; iterations."""
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
        return states, few.last.public, joined(*iterations)

    def flat(begin: int, end: int, *fields: Tensor) -> tuple[Tensor, ...]:
        """The same, from tensors to tensors."""
        states, last, iterations = carry_out(begin, end, kind(*fields))
        return *vars(whole_of(states)).values(), *vars(last()).values(), iterations

    checkpoint = checkpoint and not within_dual_numbers()  # hooks on saved tensors do not take them
    size, length = len(names), math.isqrt(len(plan)) if checkpoint else len(plan)
    parts, state, iterations = [], start, []
    for done in range(0, len(plan), length):
        span = done, min(done + length, len(plan))
        if checkpoint:
            *tensors, count = recompute(flat, *span, *vars(state).values(), use_reentrant=False)
            states, state = [kind(*tensors[:size])], kind(*tensors[size:])
        else:
            states, _, count = carry_out(*span, state)
        parts += states
        iterations.append(count)
    reason, engine = stepper.failures.reasons(), stepper.engine
    stats = Stats(steps=len(plan), iterations=joined(*iterations), reason=reason, engine=engine)
    states = ReducedStates(begun, parts, stepper.model.space)
    _look_at(stepper.model, t, states)
    return Solution(t, states, partial(_energy, stepper.model, states, t, inputs), stats)


def _equal_steps(
    t: Tensor, digits: torch.dtype, step: float | None, dtype: torch.dtype
) -> tuple[float, list[int], Tensor, Tensor]:
    """The step s, None = its default, how many of them are in each interval between instants t
    (time,), and of all steps their lengths and begins (steps,) s. Raises MemoryError for more than
    there is memory for, ValueError for what the digits of instants and states do not tell.
    """
    instants = concrete(t).tolist()
    gaps, whole = [b - a for a, b in pairwise(instants)], instants[-1] - instants[0]
    step = step_size("step", step) if step is not None else default_step(instants)
    what = f"the plan of {whole / step:.3g} steps of {step:g} s"
    check_memory(what, PLAN * whole / step, "a longer step is wanted")
    latest = max(map(abs, instants))
    check_digits(min(gaps), latest, digits)
    check_digits(step, latest, dtype)
    # of an interval, in steps; less than one is told from none by what the instants tell
    rounding = min(1e-6 + 2 * torch.finfo(digits).eps * latest / step, 0.5)
    counts = [max(1, math.ceil(gap / step - rounding)) for gap in gaps]
    lengths, begins = t.diff(), t[:-1]
    if sum(counts) > len(counts):
        number = torch.tensor(counts, device=t.device)
        interval = torch.arange(len(counts), device=t.device).repeat_interleave(number)
        part = torch.cat([torch.arange(n, device=t.device) for n in counts])
        lengths = (lengths / t.new_tensor(counts))[interval]
        begins = begins[interval] + part * lengths
    return step, counts, lengths, begins


def adaptive_run(
    scene: Scene,
    t: Tensor,
    digits: torch.dtype,
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
        called = "conserve" if options.get("conserve") else "generalized_alpha"
        raise ValueError(
            f"rtol or atol was given to {called}, whose error is no series in even powers of the "
            "step; 'midpoint' without conserve takes them"
        )
    if method == "midpoint4" and any(callable(value) for value in inputs.values()):
        raise ValueError(
            "rtol or atol was given to midpoint4 with an input that is a function of t; a load "
            "that is one is wanted, or 'midpoint'"
        )
    gap, latest = concrete(t).diff().min().item(), concrete(t).abs().max().item()
    check_digits(gap, latest, digits)
    check_digits(gap / LEAST_STEPS, latest, scene.dtype)
    t = t.to(scene.dtype)
    most, tolerance = count("max_steps", max_steps), Tolerance.of(scene, rtol, atol)
    events = Events.of(events)
    first = None if first_step is None else step_size("first_step", first_step)
    stepper = prepared(scene, (concrete(t[-1]) - concrete(t[0])).item() / STEPS, method, **options)
    changing(inputs, len(t) - 1)
    first_inputs = inputs_at(inputs, t[0], t)
    start = _begin(stepper.model, initial, t[0])
    warn_of_blow(stepper.model, start, stepper.dt / FINER)
    start = stepper._begin(start, inputs=first_inputs)
    with no_derivatives():  # functions of time bring batch axes, which a step shows
        wide = stepper.advance(
            start.detach(), first_inputs, dt=stepper.dt.detach(), t=t[0]
        ).batch_shape
    start = start.broadcast(broadcast_shapes(wide, tolerance.position.shape))
    stepper.failures = Failures()
    held = {
        name: v if isinstance(v, PerInterval) or callable(v) else scene_value
        for name, scene_value in scene.tensors(first_inputs).items()
        for v in (inputs[name],)
    }
    solution = adaptive(stepper, start, t, held, tolerance, events, most, first)
    _look_at(stepper.model, t, solution.states)
    reason = {DIVERGED: NO_STEP} | stepper.failures.reasons()
    last = solution.states.status[-1]
    for code in set(concrete(last).flatten().tolist()) & {DIVERGED, UNDERFLOW}:
        # what has failed at first may have been a trial
        on = stepper.model.space.to_reduced(solution.states)
        judged = (last == code).expand(on.status.shape)
        deformed = unsteppable(stepper.model, on.position, on.rotation, judged, t)
        reason |= {} if deformed is None else {code: deformed}
    lengths, level = solution.steps.sequence.instants.diff(dim=0), solution.proof.level
    stats = Stats(
        steps=largest(solution.steps.sequence.counts * 2**level),
        lengths=lengths,
        level=level,
        rejected=solution.steps.rejected,
        error=solution.proof.error * tolerance.position,
        reason=reason,
        engine=stepper.engine,
    )
    return Solution(
        t,
        solution.states,
        partial(_energy, stepper.model, solution.states, t, inputs),
        stats,
        solution.event,
    )


def explicit_run(
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
    _look_at(rates.model, t, trajectory)
    energy = partial(_energy, rates.model, trajectory, instants, inputs)
    return Solution(
        t, trajectory, energy, Stats(evaluations=evaluations, reason=reason, engine="eager")
    )


def _look_at(model: Model, t: Any, states: State | ReducedStates) -> None:
    """Warns of elements that are too deformed after the start, in samples that have not failed."""
    if isinstance(states, ReducedStates):
        first, parts = states.followers
    else:
        first, parts = 0, (model.space.to_reduced(states),)
    shown: list[tuple[int, Any]] = []
    for part in parts:
        rows = suspects(model, part.position, part.rotation).reshape(len(part.t), -1).any(1)
        shown += [(first + int(k), (part, int(k))) for k in rows.nonzero()[0]]
        first += len(rows)
    if not shown:
        return
    if len(shown) * shown[0][1][0].position[0].numel() > LOOKED_AT:
        shown = shown[:: max(1, len(shown) - 1)]
    with no_derivatives():
        columns = [
            torch.stack([getattr(part, name)[k] for _, (part, k) in shown])
            for name in ("position", "rotation", "status")
        ]
        position, rotation, status = columns
        warn_of_deformed(model, position, rotation, status == 0, t[[k for k, _ in shown]])


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
        warn_of_kink(start, scene)
        return start
    start = with_optional_fields(start.broadcast(), scene)
    if start.frame is not None:  # it turns on from the state's own time
        start = replace(start, frame=oriented(scene, start.frame, start.t, t))
    start = on_supports(start, scene, t).broadcast().at(t)
    warn_of_kink(start, scene)
    return start


def _energy(
    model: Model, states: State | ReducedStates, t: Iterable[Tensor], inputs: dict[str, Any]
) -> Energy:
    """Of states at the instants t; the beam's eigenstrain is that of the instant."""
    states = states.whole() if isinstance(states, ReducedStates) else model.space.to_reduced(states)
    work = states.work
    moving = states.velocity, states.spin
    kinetic = model.kinetic_energy(states.position, states.rotation, *moving)
    if not model.scene.eigenstrains:
        strain = model.strain_energy(states.position, states.rotation, crept=states.inelastic)
        return Energy(kinetic, strain, work)
    if all(map(constant, model.scene.eigenstrains)):
        eigenstrain = model.eigenstrain(states.t, {})
        return Energy(
            kinetic,
            model.strain_energy(states.position, states.rotation, eigenstrain, states.inelastic),
            work,
        )
    eigenstrain = [
        model.eigenstrain(
            now, model.scene.tensors(inputs_at(inputs, now, now, interval=max(k - 1, 0)))
        )
        for k, now in enumerate(t)
    ]
    crept = [None] * len(eigenstrain) if states.inelastic is None else states.inelastic
    strain = [
        model.strain_energy(*at)
        for at in zip(states.position, states.rotation, eigenstrain, crept, strict=True)
    ]
    return Energy(kinetic, torch.stack(strain), work)
