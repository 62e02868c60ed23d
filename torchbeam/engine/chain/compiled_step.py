"""Compiled step: steps of a model by native code, from tensors to tensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import torch
from torch import Tensor
from torch._C import _functorch as functorch
from torch.autograd import forward_ad

from ...core.derivatives import lasting, no_derivatives
from ...core.function_dependencies import Dependencies
from ...core.functions_of_time import past_hooks
from ...core.leaves import functions, wants_gradient
from ...core.numbers import Numbers
from ...math.shapes import broadcast_shapes
from ...nodal.model import Model
from ...nodal.multipliers import stacked
from ...scene.effects import Inputs
from ...state.state import State
from .call import Field, ProgramInstance, empty_like
from .chain_constants import Trees
from .constants import Constants, sizes
from .cotangents import Adjoint, Differentiated
from .frame_orientations import of_samples, orientations
from .internal_states import InternalStates
from .kept_programs import NOTHING, adjoint_of
from .kinds import Kinds, kinds_of
from .layout import FORCES
from .local_functions import LocalFunctions
from .local_problem import INTERNAL
from .method_functions import OTHER, AlphaFunctions, ConservingFunctions, ExtrapolatedFunctions
from .program import StepProgram
from .step_structure import (
    FORMS,
    Form,
    StepStructure,
    by_numbers,
    keep_structure,
    key_of,
    known_structure,
)
from .steps import Steps, in_steps
from .user_functions import by_function, by_sample, check_batch, known

EXTRAPOLATION = "extrapolation"  # means of midpoint steps, see `ExtrapolatedFunctions`
# by the method, and whether it conserves energy
FUNCTIONS = {
    ("midpoint", False): LocalFunctions,
    ("midpoint", True): ConservingFunctions,
    ("generalized_alpha", False): AlphaFunctions,
    (EXTRAPOLATION, False): ExtrapolatedFunctions,
}
TRIED = 1e-6  # s, of the step that is traced; functions of time are asked near 0
CLOSURE = (
    "a function of the motion holds a tensor that carries gradient; tb.Load(values=) takes "
    "it natively"
)
RIGID = (
    "a gradient is asked for where strains are impossible, or next to, in this dtype; lower "
    "stiffnesses of stretching and shear, or float64, are wanted"
)


class CompiledStep:
    """Steps of a model. Its program is traced at once, so that what cannot be traced is refused
    here (`NotTraceable`), and compiled at the first step.

    What holds for all steps is looked up once; should a tensor of the scene be written to, it is
    looked up again.
    """

    def __init__(
        self,
        model: Model,
        method: str = "midpoint",
        conserve: bool = False,
        *,
        around: Dependencies | None = None,
        like: CompiledStep | None = None,
        **options: Any,
    ) -> None:
        """like: steps of the same scene, of which other pairs touch."""
        functions_of = self._functions = FUNCTIONS[method, conserve]
        self.model, self.batch = model, model.scene.batch_shape
        self._own, self._options = options, {"method": method, "conserve": conserve, **options}
        kinds = None
        if by_numbers(model):
            roles = None if like is None else like.structure.roles
            self.constants = Constants(model, True, functions_of.INSTANT, around, roles)
            kinds = kinds_of(model, self.constants.acts)
        key = key_of(model, kinds, method, conserve, *sorted(options.items()))
        self.structure = known_structure(key)
        if kinds is None:
            roles = None if self.structure is None else self.structure.roles
            self.constants = Constants(model, True, functions_of.INSTANT, around, roles)
        if self.structure is not None:
            self.around, self.function = NOTHING, False
        else:
            self.tried = self._tried() if like is None else like.tried
            self.structure = self._traced(around, kinds)
            keep_structure(key, self.structure)
        self._internal = InternalStates(self.constants.acts, model.node_count)
        self.none, self.all = self.structure.none, self.structure.all
        self.constant = self._constant()
        self._sizes = [Field("common", name, x, 0) for name, x in sizes(model).items()]
        self.sources = [*[field.value for field in self.constant], *self.constants.sources]
        self.eager_because: str | None = None  # of the last call: what a user may mend
        # where a model is made of its scene's numbers, these alone are written to
        self._watched = self.sources if model.scene.numbers is None else self.constants.sources
        self._seen = Numbers.of(self._watched)
        self._checked = not by_function(model)  # whether these keep samples apart
        self._forms: dict[tuple, Form] = {}

    def _constant(self) -> list[Field]:
        """Fields of the trees that no step changes: the model's tensors, or made of them."""
        trees = self.constants.trees(dict.fromkeys(self.structure.values, self.none))
        return self.structure.constant(trees)

    def _tried(self) -> dict[str, Tensor]:
        """Values of the step that is traced, one tensor each, by which their fields are found."""
        model, none = self.model, self.model.length.new_zeros(())
        nothing = {name: none.new_zeros(size) for name, size in model.scene.inputs.items()}
        dt, orientation = torch.full_like(none, TRIED), self.constants.orientation
        values = self.constants.changing(dt, self._functions.INSTANT * dt, nothing, orientation)
        if self._functions is ExtrapolatedFunctions:
            values["mixture"] = none.new_zeros(4)
        return {name: x.clone() for name, x in values.items()}

    def _traced(self, around: Dependencies | None, kinds: Kinds | None) -> StepStructure:
        """The structure, by a look at all trees; its program is that of an earlier one, or
        traced. kinds: None = not known yet.
        """
        trees = self.constants.trees(self.tried)
        self.function = any(
            leaf.axes is None for leaf in functions((trees.node.now.loads, trees.common.now.loads))
        )
        self.around = around if by_function(self.model) else NOTHING
        local, roles = self.local(trees), self.constants.roles
        kinds = kinds_of(self.model, self.constants.acts) if kinds is None else kinds
        return StepStructure.of(local, kinds, self.around, self.tried, roles)

    def local(self, trees: Trees) -> LocalFunctions:
        """What programs are traced of."""
        return self._functions(self.model, trees, **self._own)

    @property
    def program(self) -> StepProgram:
        return self.structure.program

    @property
    def takes_time(self) -> bool:
        """Whether anything is a function of t."""
        return self.structure.takes_time

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies, also in other processes, are made from the model."""
        return partial(_again, **self._options), (self.model,)

    def __call__(
        self,
        start: State,
        dt: Tensor,
        t: Tensor | None,
        inputs: Inputs,
        moving: Tensor | None,
        tolerance: float,
        least: float,
        limit: int,
        K: int | None = None,
        lanes: int | None = None,
        every: int = 1,
        mixture: Tensor | None = None,
        into: Callable[[list[Tensor]], list[Tensor]] | None = None,
        values: Callable[[], dict[str, Tensor]] | None = None,
    ) -> Steps | None:
        """A step from `start`, in the space's coordinates, or K; differentiable once, backwards.

        dt, t   (...) s: lengths of the step, and its middle (None = not wanted, see `takes_time`);
                of K steps (K) or (K, ...)
        inputs  by name, (..., size) held over all steps; or (K, ..., size), with as many axes
                between as `moving`
        moving  (...) bool: samples that step, None = all; one that fails keeps its state and stops
        every   a divisor of K: the states after every so many steps are enough, where they are less
                work
        mixture (K, 4) of K solves, see `ExtrapolatedFunctions`
        least   cosine of half the largest angle that a node may have turned by at mid step
        into    from tensors like those that K steps are put into to these; None = new ones
        values  of these steps, see `changing`; None = to be found

        A sample's status is 0 while it goes well, and for one that does not move; its iterations in
        a step that it does not make are 0. None where torch alone can do it: forward mode,
        torch.func, functions of the motion that hold what carries gradient, and gradients where
        strains are impossible, or next to.
        """
        structure, t, dims = self.structure, self.none if t is None else t, 0
        self.eager_because = None
        if K is not None:
            axes = start.status.ndim if moving is None else moving.ndim
            dims = max(axes, structure.dims)
            dt, t, inputs = in_steps(K, axes, dims, dt, t, inputs)
        states = [self._of_state(start, name) for name in structure.state]
        if functorch.peek_interpreter_stack() is not None:
            return None
        if not self._checked:
            self._check(start.status.shape if moving is None else moving.shape)
        if _forward_mode(*self.sources, dt, t, *inputs.values(), *states):
            return None
        self._look()
        middle, frame = orientations(self.model, start.frame, dt, t, K, dims)
        changing = partial(self.constants.changing, dt, t, inputs, middle)
        values = (values or changing)()
        if mixture is not None:
            values["mixture"] = mixture.reshape(K, *(1,) * dims, 4)
        given = [values[name] for _, name in structure.changing]
        if _forward_mode(*given):
            return None
        recorded = torch.is_grad_enabled()
        held = [*given, *(field.value for field in self.constant), *states] if recorded else []
        wanted = self._wanted(held, values) if recorded else []
        if self.eager_because is not None:
            return None
        tensors = [*given, values["exact"], self.all if moving is None else moving, *states]
        every = 1 if wanted or frame is not None else every
        form = self._form(tensors, K, dims, (tolerance, least, lanes, every))
        outputs = (empty_like if wanted or into is None else into)(form.templates)
        *outputs, status, iterations = form.call.run(tensors, outputs, limit)
        if wanted or frame is not None:
            good = status == 0 if moving is None else (status == 0) & moving
        if wanted:
            instance = self._adjoint_of(form, given, values, good.expand(status.shape), wanted)
            outputs = Differentiated.apply(instance, states, outputs, *(held[k] for k in wanted))
        fields = self._fields(outputs)
        if frame is not None:
            frame = of_samples(frame, status, K)
            fields["frame"] = torch.where(good[..., None], frame, start.frame)
        return Steps.of(fields, status, iterations, every)

    def _wanted(self, held: list[Tensor], values: dict[str, Tensor]) -> list[int]:
        """Numbers of the tensors that cotangents are asked of; says where torch alone finds
        them.
        """
        # what carries gradient is an input
        known = self.around is not None and forward_ad._current_level < 0
        if self.function and not known and wants_gradient(*self.constants.closures(values)):
            self.eager_because = CLOSURE
            return []
        wanted = [k for k, x in enumerate(held) if x.requires_grad]
        if wanted and not values["exact"].all():
            self.eager_because = RIGID
        return wanted

    def _adjoint_of(
        self,
        form: Form,
        given: list[Tensor],
        values: dict[str, Tensor],
        good: Tensor,
        wanted: list[int],
    ) -> Adjoint:
        """What the cotangents of steps that were made with these tensors are found from."""
        pairs = zip(self.structure.changing, given, strict=True)
        changing = [field._replace(value=x) for (field, _), x in pairs]
        known, call = [*changing, *self.constant], form.call
        names = frozenset(known[k].name for k in wanted if k < len(known))
        return Adjoint(
            self.adjoint(names, values),
            call.batch,
            None if call.instance.cells else call.lanes,
            form.adjoints,
            changing,
            self.constant,
            good.reshape(call.K, -1),
            wanted,
        )

    def _fields(self, outputs: Sequence[Tensor]) -> dict[str, Tensor]:
        """Those of the state, from `StepStructure.state`."""
        fields = dict(zip(self.structure.state, outputs, strict=True))
        fields = {name: x for name, x in fields.items() if not name.startswith(OTHER)}
        if INTERNAL in fields:
            fields[INTERNAL] = self._internal.of_rows(fields[INTERNAL])
        if FORCES in fields:
            fields["stress"] = stacked(fields["stress"], fields.pop(FORCES))
        return fields

    def changing(
        self, dt: Tensor, t: Tensor | None, inputs: Inputs, K: int | None, axes: int
    ) -> Callable[[slice], dict[str, Tensor]]:
        """What changes in these steps of samples with so many axes, of those of a slice; all of it
        is found at once, when it is asked for first. Frame a does not turn.
        """
        dims = max(axes, self.structure.dims)
        rank = {name: field.axes for field, name in self.structure.changing} | {"exact": 0}

        @cache
        def whole() -> dict[str, Tensor]:
            self._look()
            instants = dt, self.none if t is None else t, inputs
            return self.constants.changing(
                *(instants if K is None else in_steps(K, axes, dims, *instants))
            )

        def of(rows: slice) -> dict[str, Tensor]:
            if K is None or rows == slice(0, K):
                return whole()
            return {
                name: x[rows] if name in rank and x.ndim - rank[name] > dims and len(x) == K else x
                for name, x in whole().items()
            }

        return of

    def _check(self, batch: torch.Size) -> None:
        """What users wrote, at the first call with several samples."""
        batch = broadcast_shapes(self.batch, batch)
        check_batch(self.model, batch)
        self._checked = batch.numel() > 1

    def _of_state(self, start: State, name: str) -> Tensor:
        """A field of `StepStructure.state`."""
        name = name.removeprefix(OTHER)
        if name == INTERNAL:
            return self._internal.rows(start.internal)
        if name in ("stress", FORCES):
            return self.model.multipliers.split(start.stress)[name == FORCES]
        return getattr(start, name)

    def _look(self) -> None:
        """Take afresh what was looked up, where a tensor that it came from has been written to
        since.
        """
        if self._seen is None or not self._seen.stand(self._watched):
            with lasting(), past_hooks():
                self.constant = self._constant()
            self.constants.forget()
            self._forms.clear()
            self._seen = Numbers.of(self._watched)

    def _form(
        self, tensors: list[Tensor], K: int | None, dims: int, options: tuple[Any, ...]
    ) -> Form:
        """Of the structure, with this model's constants."""
        key = (K, dims, options, *[(x.shape, x.stride(), x.dtype) for x in tensors])
        form = self._forms.get(key)
        if form is None:
            if len(self._forms) >= FORMS:
                self._forms.pop(next(iter(self._forms)), None)
            constants = [*self.constant, *self._sizes]
            form = self.structure.form(tensors, constants, K, dims, options, key)
            form = form._replace(call=form.call.holding(constants))
            self._forms[key] = form
        return form

    def compile(self, samples: int, lanes: int | None = None) -> None:
        """What steps of so many samples take, which the first of them does otherwise."""
        instance = self.structure.instance_for(samples, lanes)
        instance.program.run(lanes or instance.lanes(samples), instance.lanes_each)

    def adjoint(self, names: frozenset[str], values: dict[str, Tensor]) -> ProgramInstance:
        """Of the cotangents of constants of these names; values: of those that change. Traced once,
        and no part of the graph: a part of torch.utils.checkpoint that is made again does not find
        it missing there.
        """

        @no_derivatives()
        def make() -> ProgramInstance:
            trees = self.constants.trees(values)
            return adjoint_of(self.program, self.local(trees), names, self.around)

        return self.structure.adjoint(names, self.model, make)


def _forward_mode(*tensors: Tensor) -> bool:
    """Whether any of them carries a tangent."""
    return forward_ad._current_level >= 0 and any(
        forward_ad.unpack_dual(x).tangent is not None for x in tensors
    )


def _again(model: Model, **options: Any) -> CompiledStep:
    return by_sample(
        lambda around: CompiledStep(model, around=around, **options),
        model,
        known(by_function(model)),
    )
