"""Compiled step: steps of a model by native code, from tensors to tensors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.leaves import functions, wants_gradient
from ...core.validation import concrete
from ...nodal.balance import same_law
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...state.state import State, rest
from .call import Call, Field
from .constants import Constants, flattened
from .cotangents import Adjoint, Differentiated, constant_fields, state_fields
from .local_functions import LocalFunctions
from .local_problem import INTERNAL, Kinds, node_kinds
from .program import program_of

NUMBERS = {"status": ("sample", "last_status"), "iterations": ("sample", "iterations")}


class Steps(NamedTuple):
    """After each of K steps: fields of the state (K, ...), status (K, ...) and iterations (K, ...)."""

    fields: dict[str, Tensor]
    status: Tensor
    iterations: Tensor

    def after(self, start: State, k: int) -> State:
        """The state after step k, in the space's coordinates, with the start's t and status."""
        return replace(start, **{name: x[k] for name, x in self.fields.items()})


class CompiledStep:
    """Steps of a model. Its program is traced at once, so that what cannot be traced is refused here (`NotTraceable`), and
    compiled at the first step.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.constants, self.batch = model, Constants(model), model.scene.batch_shape
        like = model.length
        nothing = {name: like.new_zeros(size) for name, size in model.scene.inputs.items()}
        frame = model.space.to_reduced(rest(model.scene, ())).frame
        zero = like.new_zeros(())
        trees = *self.constants.at(like.new_ones(()), zero, nothing, frame), self.constants.supports(zero)
        # axes that functions of t may bring along; one at least, so that none of theirs is taken for that of steps
        self.dims = max(1, *(x.ndim - axes for tree in trees for x, axes in flattened(tree)))
        self.functions = any(one.axes is None for one in functions((trees[0].loads, trees[2].loads)))
        self.kinds = Kinds.of(node_kinds(model))
        self.program = program_of(LocalFunctions(model, *trees), self.kinds, bool(model.constraints.nodes), not self.functions)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies, also in other processes, are made from the model."""
        return CompiledStep, (self.model,)

    def __call__(self, start: State, dt: Tensor, t: Tensor, inputs: Inputs, moving: Tensor, tolerance: float, least: float,
                 limit: int, lanes: int | None = None) -> Steps | None:
        """K steps from `start`, in the space's coordinates; differentiable once, backwards.

        dt, t   (K) or (K, ...) s: lengths of the steps, and their middles
        inputs  by name, (..., size) held over all steps; or (K, ..., size), with as many axes between as `moving`
        moving  (...) bool: samples that step; one whose step fails keeps its state and stops
        least   cosine of half the largest angle that a node may have turned by at mid step

        A sample's status is 0 while it goes well, and for one that does not move; its iterations in a step that it does not
        make are 0. None where torch alone can do it: forward mode, samples mapped over, functions of the motion that hold what
        carries gradient, and gradients where strains are impossible, or next to.
        """
        model, K, axes = self.model, dt.shape[0], moving.ndim
        dims = max(axes, self.dims)
        dt, t = (x.reshape(K, *(1,) * (dims + 1 - x.ndim), *x.shape[1:]) for x in (dt, t))
        inputs = {name: x.reshape(K, *(1,) * (dims + 2 - x.ndim), *x.shape[1:]) if x.ndim > axes + 1 else x
                  for name, x in inputs.items()}
        middle, frame = self.constants.orientations(start.frame, dt, t)
        trees = *self.constants.at(dt, t, inputs, middle), self.constants.supports(t + dt / 2)
        given, records = [*constant_fields(trees)], state_fields(self.program.state)
        state = {name: self.constants.internal_rows(start.internal) if name == INTERNAL else getattr(start, name)
                 for name in records}
        held = [*(one.value for one in given), *state.values()]
        if any(x is not concrete(x) or torch.autograd.forward_ad.unpack_dual(x).tangent is not None for x in held):
            return None
        if self.functions and torch.is_grad_enabled() and wants_gradient(*self.constants.closures(trees)):
            return None
        exact = same_law(trees[1].C, model.law.C)
        differentiated = wants_gradient(*held)
        if differentiated and not exact.all():
            return None
        shapes = (one.value.shape[:one.value.ndim - one.axes] for one in given)
        batch = torch.broadcast_shapes(moving.shape, start.batch_shape, *(shape[len(shape) > dims:] for shape in shapes))
        call = Call(self.program, model, self.kinds, batch, K, lanes)
        with torch.no_grad():
            made = {name: call.empty(*(() if name == "work" else x.shape[-2:])) for name, x in state.items()}
            numbers = {name: call.empty() for name in NUMBERS}
            like, one = model.length, model.length.new_tensor
            numbers_given = {"total": like.sum((-1, -2)), "longest": like.amax((-1, -2)), "exact": exact,
                             "tolerance": one(tolerance), "least": one(least)}
            fields = [*given, Field("free", "free", model.constraints.moving, 2),
                      *(Field("common", name, x, 0) for name, x in numbers_given.items()),
                      Field("sample", "moving", moving, 0), Field("sample", "last_status", one(0.0), 0),
                      *(Field(*records[name], x, 0 if name == "work" else 2) for name, x in state.items())]
            out = [Field(*(records | NUMBERS)[name], x, x.ndim - 2, flat=True) for name, x in (made | numbers).items()]
            call.run(limit, inputs=fields, outputs=out)
        if differentiated:
            good = (numbers["status"] == 0) & moving.expand(batch).reshape(-1)
            adjoint = Adjoint(call, model, self.kinds, trees, good)
            made = dict(zip(made, Differentiated.apply(adjoint, tuple(made.values()), *held), strict=True))
        own = batch[dims - axes:] if batch[:dims - axes].numel() == 1 else batch
        made, numbers = ({name: x.reshape(K, *own, *x.shape[2:]) for name, x in part.items()} for part in (made, numbers))
        if INTERNAL in made:
            made[INTERNAL] = self.constants.of_rows(made[INTERNAL])
        if frame is not None:
            frame = frame.expand(K, *batch, frame.shape[-1]).reshape(K, *own, -1)
            made["frame"] = torch.where(((numbers["status"] == 0) & moving)[..., None], frame, start.frame)
        return Steps(made, *(x.long() for x in numbers.values()))
