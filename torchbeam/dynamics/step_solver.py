"""One implicit solve over a step, or a part of it: by native code, or by torch operations."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ..core.derivatives import lasting
from ..core.functions_of_time import past_hooks
from ..core.status import DIVERGED, SUCCESS
from ..core.validation import concrete
from ..engine.chain.compiled_step import RIGID, CompiledStep
from ..engine.chain.coverage import VALUES, automatic_step, compiled_step, given_up, meaning
from ..engine.chain.native import NotCompiled
from ..engine.chain.steps import Steps
from ..engine.compiler.trace import NotTraceable
from ..engine.engine_use import EngineUse
from ..math.shapes import broadcast_shapes
from ..nodal.discretise import in_double
from ..nodal.model import Model
from ..solvers.implicit_gradient import differentiated, implicit_gradient
from ..solvers.newton import TOLERANCE, newton
from ..state.state import State
from .method import Extrapolation, Method, Midpoint

# iterations of a step that can still be made in parts: one that takes more is quicker so
QUICK = 12
# rad that a node may turn in one solve; larger turns have more than one solution, and the wrong one
# gains energy
TURN = 1.2


# eps: what sums of forces that cancel are held to; a finer tolerance counts as this
FINEST = 256


class Span(NamedTuple):
    """What a step goes over: dt from t on, both (...) s, from a state.

    inputs  by name; of a step of several solves `HeldInputs`, or one for each solve, see `together`
    moving  (...) bool: samples that move; None = all, of one step
    last    whether it cannot be made in parts where it fails
    """

    state: State
    dt: Tensor
    t: Tensor | None
    inputs: Any
    moving: Tensor | None
    last: bool


class StepResult(NamedTuple):
    """The state after a step, of a failed sample that before; status and iterations (...)."""

    state: State
    status: Tensor
    iterations: Tensor


def mixes_ends(model: Model) -> bool:
    """Whether native code makes a whole step of several compositions, see `Scheme`: not of what has
    more than nodes to remember.
    """
    more = model.multipliers.count, model.tendons.stretches, model.touching.present
    return not any(more) and model.scene.frame is None


class StepSolver:
    """Solves a method's problem for a model; engine, tolerance, limit: see `Stepper`."""

    def __init__(
        self, model: Model, method: Method, engine: str, tolerance: float | None, limit: int
    ) -> None:
        self.model, self.method, self.limit = model, method, limit
        finest = FINEST * torch.finfo(model.scene.dtype).eps
        self.tolerance = None if tolerance is None else max(float(tolerance), finest)
        self.engine = (
            engine if engine != "auto" else "compiled" if meaning() == "compiled" else "auto"
        )
        self._compiled, self._decided, self.use = None, self.engine == "eager", EngineUse()
        self._double: StepSolver | None = None
        self._extrapolating: StepSolver | None = None
        if self.engine == "compiled":
            _ = self.compiled  # is refused here, if at all

    @property
    def compiled(self) -> CompiledStep | None:
        """The steps by native code; None where they are made eagerly. That is decided when it is
        first asked, outside of torch.func, whose tensors are not to be kept.
        """
        if not self._decided and not functorch.peek_interpreter_stack():
            method, options = self.method.solves
            with lasting(), past_hooks():
                if self.engine == "compiled":
                    self._compiled = compiled_step(self.model, method, **options)
                else:
                    self._compiled, self.use.reason = automatic_step(self.model, method, **options)
            self._decided = True
        return self._compiled

    def __getstate__(self) -> dict[str, Any]:
        """Copies decide for themselves, where "auto" does: they may be in another process."""
        held = dict(vars(self))
        return (
            held
            if self.engine != "auto"
            else {**held, "_compiled": None, "_double": None, "_decided": False}
        ) | {"_extrapolating": None}

    def again(self) -> StepSolver:
        """The same, as if it had made no step yet."""
        _ = self.compiled  # is decided once
        other = object.__new__(StepSolver)
        vars(other).update(vars(self), use=EngineUse(self.use.reason), _extrapolating=None)
        return other

    def of(self, model: Model) -> StepSolver:
        """The same for another model, of the same structure."""
        other = copy(self)
        other.model = model
        other._compiled = other._double = other._extrapolating = None
        other._decided = self.engine != "compiled" and self._decided and self._compiled is None
        return other

    @property
    def extrapolating(self) -> StepSolver | None:
        """The same for solves whose ends are mixed, see `ExtrapolatedFunctions`; None where native
        code does not do that: for what has more than nodes to remember.
        """
        if self.compiled is None or not mixes_ends(self.model):
            return None
        if self._extrapolating is None:
            other = self._extrapolating = copy(self)
            other.method, other._double = Extrapolation(), None
            other._compiled, other._decided = None, False
        return self._extrapolating if self._extrapolating.compiled is not None else None

    def by_midpoint(self) -> StepSolver:
        """The same by the midpoint step, eagerly; by native code where beams touch, of which one
        eager step may take a minute.
        """
        other = copy(self)
        other.method = Midpoint()
        other._compiled, other.use = None, EngineUse()
        other._decided = self.compiled is None or not self.model.touching.present
        return other

    def solve(self, model: Model, span: Span) -> StepResult:
        """A solve with loads as at t of the model or of a part of its batch."""
        state, dt, t, inputs, moving, last = span
        if self.compiled is not None and model is self.model:
            shape = broadcast_shapes(
                self.compiled.batch, moving.shape, *(x.shape[:-1] for x in inputs.values())
            )
            solution = self.natively(span._replace(moving=moving.expand(shape)))
            if solution is not None:
                good = moving & (solution.status == SUCCESS)
                after = replace(
                    state, **solution.fields, t=torch.where(good, state.t + dt, state.t)
                )
                return StepResult(after, solution.status, solution.iterations)
        self.use.eagerly()
        problem = self.method.problem(model, state, dt, t, inputs)
        x, reaction, status, iterations = newton(
            problem,
            problem.predictor(),
            moving,
            self.tolerance,
            self._limit(last),
            foresee=None if model.smooth else torch.zeros_like(moving),
        )
        lost = self.model.space.cosine(x.m).amin(-1) < self._least
        if problem.conditions.between or model.touching.present or model.bodies_touch:
            through = problem.passed_through(problem.motion.kinematics(x.u, x.m))
            lost = lost if through is None else lost | through
        status = torch.where((status == SUCCESS) & lost, DIVERGED, status)
        good = moving & (status == SUCCESS)
        if differentiated(problem, x):
            x = type(x)(
                *(
                    torch.where(good[..., None, None], a, b)
                    for a, b in zip(x, problem.rest_guess(), strict=True)
                )
            )
            if not concrete(good).all():  # nothing that failed samples hold reaches a derivative
                held = {
                    name: torch.where(good[..., None], v, v.detach()) for name, v in inputs.items()
                }
                t = torch.where(good, t, t.detach()) if t.ndim else t
                problem = replace(
                    problem, start=state.where(good, state.detach()), t=t, inputs=held
                )
            x, reaction = implicit_gradient(problem, x, good)
        after = problem.finish(x, reaction)
        return StepResult(
            after if concrete(good).all() else after.where(good, state), status, iterations
        )

    def natively(
        self, span: Span, K: int | None = None, every: int = 1, mixture: Tensor | None = None
    ) -> Steps | None:
        """A solve with loads as at t, or K, see `CompiledStep`; None = to be made eagerly."""
        compiled = self.compiled
        if compiled is None:  # another thread has given it up
            return None
        if compiled.around is not None and not compiled.around.unchanged():
            # what a user's function reads has changed since it was traced: it may again
            self._compiled, self._decided = None, self.engine != "compiled"
            compiled = self.compiled
            if compiled is None:
                self.use.reason = (
                    "what a function of the motion reads has changed since the stepper "
                    f"was made{VALUES}"
                )
                return None
            if compiled.takes_time and span.t is None:
                return None  # the functions before did not
        state, *call, last = span
        tolerance = TOLERANCE[state.position.dtype] if self.tolerance is None else self.tolerance
        try:
            solution = compiled(
                state,
                *call,
                tolerance,
                self._least,
                self._limit(last),
                K,
                every=every,
                **({} if mixture is None else {"mixture": mixture}),
            )
        except (NotCompiled, NotTraceable) as error:
            if self.engine == "compiled":
                raise
            given_up(error)
            self._compiled = None
            return None
        if solution is not None:
            self.use.native += K or 1
            return solution
        self.use.reason = compiled.eager_because
        if (
            compiled.eager_because is RIGID
            and state.position.dtype is torch.float32
            and not self.model.law.rigid
        ):
            return self._in_double(span, K, every, mixture)
        return None

    def _in_double(
        self, span: Span, K: int | None, every: int, mixture: Tensor | None
    ) -> Steps | None:
        """The same in float64, as float32 makes ordinary strips of metal softer in tangents."""

        def wide(x: Tensor | None) -> Tensor | None:
            return None if x is None else x.to(torch.float64)

        if self._double is None:
            with lasting(), past_hooks():
                self._double = self.of(in_double(self.model))
                # where a user's function takes float32 alone, this gradient is made eagerly
                self._double.engine = "auto"
        if self._double.compiled is None:
            return None
        state = span.state.map(lambda x: wide(x) if x.is_floating_point() else x)
        inputs = {name: wide(x) for name, x in span.inputs.items()}
        double = Span(state, wide(span.dt), wide(span.t), inputs, span.moving, span.last)
        solution = self._double.natively(double, K, every, wide(mixture))
        if solution is None:
            return None
        return solution._replace(
            fields={name: x.to(span.state.position) for name, x in solution.fields.items()}
        )

    def _limit(self, last: bool) -> int:
        """Iterations of a solve; fewer where the step can still be made in parts, more with
        friction, which smaller steps do not make smoother.
        """
        if self.model.has_friction:
            return 2 * self.limit
        return self.limit if last else min(self.limit, QUICK)

    @property
    def _least(self) -> float:
        """Cosine of half the angle that a node may turn by up to where its unknown is."""
        return math.cos(TURN * self.method.PART / 2)
