"""Stepper: one implicit step at a time, for environments, controllers and filters."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, count, duration, mask, step_size
from ..core.arguments import tolerance as check_tolerance
from ..core.batch_subset import BatchSubset
from ..core.functions_of_time import shared
from ..core.leaves import with_values
from ..core.one_thread import few_on_one_thread, numbers_of
from ..core.status import DIVERGED, SUCCESS
from ..core.validation import broadcast, concrete, positive, real
from ..core.warning import goes
from ..engine.chain.compiled_step import CompiledStep
from ..engine.chain.coverage import ENGINES
from ..math.concrete import is_vmapped
from ..nodal.blow import warn_of_blow
from ..nodal.discretise import discretise
from ..scene.effects import Inputs
from ..scene.inputs import by_name
from ..scene.scene import Scene
from ..solvers.newton import LIMIT
from ..state.start import on_supports
from ..state.state import State, rest
from ..state.state_check import check_state, of_mesh, with_optional_fields
from .composition import in_parts, natively, step
from .failure import Failures
from .instants import StepEnd, begins_of, exact, rounded
from .make_steps import last_state
from .method import Method
from .methods import METHODS
from .step_inputs import GivenInputs, HeldInputs, StateCache, StepInputs
from .step_jacobian import Coordinates, step_jacobian
from .step_solver import Span, StepSolver

HALVINGS = 6  # a failed step is made again in at most 2^6 parts


class Stepper:
    """Advances states of a scene by implicit steps of `dt` seconds (nodal form).

    Args:
        scene: its tensors may carry gradient. Stiffness, mass, damping and geometry are taken once,
            here: make another Stepper after a change of them, or for a second backward pass by them
        dt: s: a number, or a tensor (0-dim), which may carry gradient
        method: "midpoint": the mean-strain step (second order, unconditionally stable in practice,
            keeps momentum). "midpoint4": fourth order, five such steps in one, or four where
            damping is strong, see `torchbeam.dynamics.midpoint4`. "generalized_alpha": balance at
            the end of the step, high frequencies damped (second order). Its stress and reaction are
            at the end of the step; its state remembers accelerations, which `begin` starts
        rho_inf: of generalized_alpha: share of an infinitely fast motion left after a step, 0 to 1
        lumped: mass at the nodes alone, as in the explicit form. By default neighbours are coupled,
            so that the error of translational inertia is of fourth order
        conserve: scale the velocities after each step so that the energy balance closes exactly:
            for long undamped runs. A piece that nothing holds keeps its rigid motion, so its
            momentum and angular momentum stay; its steps are eager
        tolerance: of the scaled residual, default 1e-8 in float64 and 1e-4 in float32. A tolerance
            below 256 rounding errors of a number (6e-14, 3e-5) counts as that
        iterations: at most this many in a Newton solve (12 where its step can still be made in
            parts; twice as many where contacts have friction)
        halvings: a failed step is made again in 2, 4, ... 2^halvings parts
        engine: "eager": torch operations. "compiled": native code for many samples at once on the
            CPU (by llvmlite). Answers are the same up to rounding; gradients are in reverse mode.
            The first step compiles. Eager even then: forward mode, torch.func, gradients where
            strains are impossible or nearly so, some parts of a failed step. It compiles anew where
            values change that a user's function of the motion reads. "auto": compiled if llvmlite
            is installed and native code takes the scene, user's functions as long as the values
            that they read stay. Otherwise eager, with a SlowPathWarning; `describe` says which,
            and why. The environment variable TORCHBEAM_ENGINE changes "auto"

    Raises:
        ValueError: for an unknown method, a step that is not positive, or a scene that the nodal
            form or the engine does not take.

    Examples:
        >>> stepper = tb.Stepper(tb.Scene(beam, [tb.TipLoad(force=tb.Input("u", 3))]), 0.01)
        >>> state = stepper.rest()
        >>> for _ in range(3):
        ...     state = stepper(state, u=(0, 0, 1.0))
        >>> state.t  # s
        tensor(0.0300)
    """

    def __init__(
        self,
        scene: Scene,
        dt: float | Tensor,
        method: str = "midpoint",
        *,
        lumped: bool = False,
        tolerance: float | None = None,
        iterations: int = LIMIT,
        halvings: int = HALVINGS,
        conserve: bool = False,
        rho_inf: float | None = None,
        engine: str = "auto",
    ) -> None:
        choice("method", method, METHODS)
        choice("engine", engine, ENGINES)
        self.method = METHODS[method].of(method, conserve, rho_inf)
        self.scene = scene
        self.model = discretise(scene, lumped)
        self.method.check(self.model)
        self.dt = duration("dt", dt, scene.dtype, scene.device)
        self._changes = scene.changes
        tolerance = None if tolerance is None else check_tolerance("tolerance", tolerance)
        self.halvings = count("halvings", halvings, least=0)
        self.solver = StepSolver(
            self.model, self.method, engine, tolerance, count("iterations", iterations)
        )
        self.iterations: Tensor | None = None  # (...) of the last step
        self._last: StateCache | None = None
        self.latest: Tensor | None = None  # (...) s, of the state that was made last
        self._checked: tuple[StepEnd, ...] = ()  # before and after the last step
        self.failures: Failures | None = Failures()  # None = nobody asks why a step has failed

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_last": None, "latest": None, "_checked": ()}

    def again(self, dt: float | Tensor) -> Stepper:
        """This stepper with steps of another length, as if it had made none yet."""
        return with_values(
            self,
            dt=duration("dt", dt, self.scene.dtype, self.scene.device),
            solver=self.solver.again(),
            failures=Failures(),
            iterations=None,
            _last=None,
            latest=None,
            _checked=(),
        )

    @property
    def compiled(self) -> CompiledStep | None:
        """The steps by native code; None where they are made eagerly."""
        return self.solver.compiled

    @property
    def engine(self) -> str | None:
        """The engine of its steps so far: "native", "eager" or "mixed"; None before the first.

        Mixed steps have, for example, failed steps whose parts are eager. The trial step by which
        generalized alpha starts does not count.
        """
        return self.solver.use.engine

    def rest(self, batch_shape: tuple[int, ...] | None = None) -> State:
        """The beam undeformed and at rest."""
        return rest(self.scene, batch_shape)

    @few_on_one_thread(lambda self, state, **_: numbers_of(self.scene, state))
    def __call__(
        self,
        state: State,
        *,
        active: Tensor | None = None,
        dt: float | Tensor | None = None,
        **inputs: Any,
    ) -> State:
        """The state one step later.

        state   of the scene's mesh; what NumPy or `.data` writes to it may not be seen
        active  (...) bool: samples that are to move; the others, and those with a status other than
                0, stay as they are
        dt      another length for this step, as above; or (...) of each sample
        inputs  by name, (..., size), held over the step: by keyword, or all in inputs={...}

        Raises ValueError for a state of another form, mesh or dtype, an `active` that is no mask of
        the samples, a dt that is not positive, and inputs that are not the scene's.

        What is a function of time is taken at each sample's own time, at mid step. Where Newton's
        method fails, or a node turns by more than 1.2 rad, the step of that sample is made again in
        2, 4, ... smaller ones. If that fails too it keeps its state and gets a status, which a
        RuntimeWarning explains, once a stepper; its derivatives are those of standing still.
        """
        t = getattr(state, "t", None)
        known = next((end for end in self._checked if end.t is t), None)
        if known is None:
            state = of_mesh(state, self.scene, "a state")
        if is_vmapped(state.t):
            return self.advance(state, inputs, active=active, dt=dt)
        start, longest = StepEnd.of(known, state.t, self._length(dt), dt is None)
        after = self.advance(state, inputs, active=active, dt=dt)
        if self.failures:
            self.failures.warn()
        self._checked = start, start.later(after.t, longest)
        return after

    def advance(
        self,
        state: State,
        inputs: GivenInputs,
        *,
        active: Tensor | None = None,
        dt: float | Tensor | None = None,
        t: Tensor | None = None,
    ) -> State:
        """The same, with the time t (0-dim) of all samples where it is known; None = the state's.
        inputs: held over the step, or a function of the share of it that has passed.
        """
        dt, given = self._length(dt), HeldInputs(inputs).map(self.scene.tensors)
        now = given(self.method.INSTANT)
        state, well = self.started(state, dt, now)
        broadcast(
            "a scene, a state and inputs",
            self.scene.batch_shape,
            state.status.shape,
            *[x.shape[:-1] for x in now.values()],
        )
        if (
            active is None
            and self.compiled is not None
            and (t is not None or not self._changes or state.t.ndim == 0)
        ):
            if (result := self._quickly(state, well, dt, t, given)) is not None:
                return result
        moving = state.status == SUCCESS
        if active is not None:
            moving = moving & mask("active", active, moving)
        t = t if t is not None else shared(state.t, moving) if self._changes else state.t
        span = Span(state, dt, t, given, moving, last=not self.halvings)
        after, status, self.iterations = step(self.solver, self.model, span)
        lost = moving & (status != SUCCESS)
        failed = lost & (status == DIVERGED) if concrete(lost).any() else lost
        if self.halvings and failed is not lost and concrete(failed).any():
            again, well, more = in_parts(
                self.solver, self.model, span._replace(moving=failed), self.halvings
            )
            after, status = again.where(well, after), torch.where(well, SUCCESS, status)
            self.iterations = self.iterations + more
        if failed is not lost and self.failures is not None:
            remembered = torch.where(moving, status, SUCCESS)
            self.failures.remember(self.method, self.model, span, remembered)
        now = exact(state.t, self.latest)
        after = replace(
            after,
            t=torch.where(moving & (status == SUCCESS), now + dt, now),
            status=torch.where(moving, status, state.status),
        )
        if now.shape != after.status.shape:  # functions of time have brought axes along
            after = after.broadcast()
        self.latest = rounded(after.t, state.t.dtype)
        return self.model.space.to_public(replace(after, t=self.latest))

    def jacobian(
        self,
        state: State,
        u: Tensor | dict[str, Any] | None,
        model: Coordinates,
        *,
        dt: float | Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Derivatives of one step from `state`: dz = A dz + B du.

        dz are changes of the state after and before the step, in the coordinates z of a linear
        model. Iterative LQR, extended Kalman filters and Gauss-Newton steps use them.

        Args:
            u: (..., m) the inputs side by side, as in the scene's order; or by name, in a
                dictionary; None without inputs
            model: of `linearize`, of the same scene (discrete or reduced too): its `departure` is
                z, at any state. If z does not determine a state (a reduced model), the rest follows
                the model's own motion
            dt: another length for this step

        Returns:
            A (..., n, n) and B (..., n, m), exact as gradients are, constants, native where steps
            are. A failed sample stands still: A = 1, B = 0. Memories of joints and interactions are
            held; so are velocities across joints, of the order dt^2: a product of A over many steps
            errs by the order dt where joints are (`rollout_jacobian` does not).

        Raises:
            ValueError: as a step does, and for generalized_alpha, whose states remember more.
        """
        if type(self.method).begin is not Method.begin:
            raise ValueError(
                "method='generalized_alpha' was given to jacobian; a midpoint method is wanted, "
                "whose states remember nothing beside z"
            )
        values, alone = self.scene.tensors(by_name(self.scene, u)), copy(self)
        alone._last, alone.failures = None, Failures()
        state = of_mesh(state, self.scene, "a state")
        return step_jacobian(alone, model, state, values, self._length(dt))

    def repeat(
        self, state: State, count: int, inputs: dict[str, Any], active: Tensor | None = None
    ) -> State:
        """The state `count` steps later, with the inputs held: as so many calls."""
        if count == 1:
            return self.advance(state, inputs, active=active)
        t = exact(state.t, self.latest)
        begins = begins_of(shared(t) if self._changes else t, self.dt, count)
        active = None if active is None else mask("active", active, state.status)
        return last_state(self, state, begins, StepInputs(self.scene.tensors(inputs)), active)

    def _quickly(
        self, state: State, well: bool, dt: Tensor, t: Tensor | None, inputs: HeldInputs
    ) -> State | None:
        """The state one step later, where native code makes it of all samples at once; None where
        there is more to it. well: whether it is known that none has failed.
        """
        alone = None if inputs.vary else self.method.alone(self.model, dt)
        if alone is None or not (well or not concrete(state.status).any()):
            return None
        now = state.t if t is None else t
        span = Span(state, dt, now, inputs.given, None, last=not self.halvings)
        result = natively(alone, self.solver, span)
        if result is None or not result.well:
            return None
        self.iterations, now = result.iterations, exact(state.t, self.latest) + dt
        now = now if now.shape == result.status.shape else now.expand(result.status.shape)
        self.latest = now = rounded(now, state.t.dtype)
        return self.known(
            with_values(state, **result.fields, t=now, status=result.status), well=True
        )

    def started(self, state: State, dt: Tensor, inputs: Inputs) -> tuple[State, bool]:
        """The state to start a step of dt from in the space's coordinates, checked; whether it is
        known that no sample of it has failed.
        """
        known = self._known(state)
        if known is not None:
            return known.reduced, known.well
        state = of_mesh(state, self.scene, "a state")
        return self.reduced(self._begin(state, dt, inputs=inputs)), False

    def _known(self, state: State) -> StateCache | None:
        """The last state that native code has made, if it is this one, as it was."""
        last = self._last  # taken once: other threads may step too
        return None if last is None else last.if_same(state)

    def reduced(self, state: State) -> State:
        """A state in the space's coordinates, with all that the scene has, fields broadcast."""
        known = self._known(state)
        if known is not None:
            return known.reduced
        state = state if state.velocity.ndim == state.position.ndim else state.broadcast()
        return self.model.space.to_reduced(with_optional_fields(state, self.scene))

    def known(self, reduced: State, well: bool) -> State:
        """A state that native code has made, as a public one, to be known again."""
        after = self.model.space.to_public(reduced)
        self.remember(after, reduced, well)
        return after

    def remember(self, state: State, reduced: State, well: bool) -> State:
        """A public state to be known again by itself in the space's coordinates; well: that no
        sample of it has failed.
        """
        self._last = StateCache.of(state, reduced, self.model.space, well)
        return reduced

    def _length(self, dt: float | Tensor | None) -> Tensor:
        """Of a step, s."""
        if isinstance(dt, Tensor):
            return positive("dt", real(dt)).to(self.dt)
        return self.dt if dt is None else self.dt.new_tensor(step_size("dt", dt))

    def begin(self, state: State, dt: float | Tensor | None = None, **inputs: Any) -> State:
        """`state` to start from, with what the method remembers beside it. Supports that stand have
        what they hold exactly where they are (see `Support`; ValueError where it is elsewhere).
        """
        if not self.scene.has_prescribed_motion:
            state = with_optional_fields(check_state(state, self.scene), self.scene)
            state = on_supports(state, self.scene, self.dt)
        warn_of_blow(self.model, state, dt := self._length(dt))
        return self._begin(state, dt, **inputs)

    def _begin(self, state: State, dt: Tensor | None = None, **inputs: Any) -> State:
        """`state` with what the method remembers beside it, and no more."""
        dt = self.dt if dt is None else dt

        def trial(state: State) -> State:
            other = copy(self)
            other.solver = self.solver.by_midpoint()
            other.method = other.solver.method
            return other.advance(state, inputs, dt=dt)

        return self.method.begin(state, self.model, dt, trial)

    def merge(self, few: BatchSubset, part: Stepper) -> Stepper:
        """This stepper, with the samples `few` of its batch those of `part`: a stepper that was
        made for them by itself, of the same mesh and options. Raises ValueError as
        `BatchSubset.merge`.

        Deprecated: merge the scenes, and make a stepper of what comes out.
        """
        goes("Stepper.merge", "merge the scenes, by BatchSubset.merge, and make a Stepper of these")
        merged = copy(self)
        merged.scene, merged.model = few.merge((self.scene, self.model), (part.scene, part.model))
        merged.solver = self.solver.of(merged.model)
        merged.iterations, merged.failures = None, Failures()
        return merged
