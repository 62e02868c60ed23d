"""Balance at the points of a path by native code, from tensors to tensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.function_dependencies import Dependencies
from ...core.functions_of_time import rate_along
from ...equations.steady import Configuration, SteadyProblem
from ...math.block_tridiagonal import in_unit
from ...nodal.balance import same_law
from ...nodal.multipliers import stacked
from ...scene.effects import Inputs
from ...state.state import rest
from ...topology.places import take
from ...topology.protocols import System
from ..compiler.derivative import dot
from .call import Call, Field, Output
from .chain_constants import Trees
from .constants import Constants
from .cotangents import OF_MULTIPLIERS, constant_fields
from .coverage import meaning, natively
from .layout import FORCES
from .load_climb import fields_at_rest, instance_at_rest, refusal
from .load_driver import PIVOT
from .load_program import RATE, PathFunctions, PathProgram, by_rows
from .user_functions import check_batch, written

Answer = tuple[Tensor, Tensor, Tensor]


class Size(NamedTuple):
    """A residual of which the scaled size (...) is known."""

    size: Tensor
    nodes: None = None
    strain: None = None

    def measure(self) -> Tensor:
        return self.size


class NativePoint(NamedTuple):
    """See `statics.arc_length.PointBalance`; blocks: pivots, or, of a structure, the tangent's
    system that has them, found by torch where it is asked for.
    """

    residual: Size
    exact: Tensor
    by_residual: Answer
    by_factor: Answer
    blocks: Tensor | Callable[[], System]

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        if callable(self.blocks):
            return self.blocks().pivots(unit)
        sound = torch.isfinite(self.blocks)
        return in_unit(torch.where(sound, self.blocks, 0.0), unit), sound.flatten(-3).all(-1)


class NativeBalance:
    """The balance of a model at rest, and what its tangent asks for, by the load factor: of all
    loads, or of the input `load`.
    """

    def __init__(
        self, problem: SteadyProblem, load: str | None, around: Dependencies | None
    ) -> None:
        """problem: at factor 0."""
        self.model, self.problem = problem.model, problem
        model, self.by_rows = problem.model, by_rows(problem.model)
        constants = Constants(model, steps=False, around=around)
        trees, rising, rises, led = self._trees(constants, problem, load)
        how = rising, led is not None
        local = PathFunctions(model, trees, *how, resisting=problem.resisting)
        self.instance = instance_at_rest(local, constants, around, PathProgram)
        fields = fields_at_rest(self.instance, model, trees, problem.t, problem.inputs)
        self.exact, self.load = same_law(local.trees.element.C, model.law.C), load
        self.rising = [field for field in fields if field.name in rises]
        self.fields = [field for field in fields if field.name not in rises]
        self.fields += [
            field._replace(name=dot(field.name), value=rises[field.name]) for field in self.rising
        ]
        self.fields += [] if led is None else [Field("node", RATE, led, 2)]
        self.instance.program.run(1)  # raises where it cannot be compiled
        self._calls: dict[torch.Size, Call] = {}

    @staticmethod
    def _trees(
        constants: Constants, problem: SteadyProblem, load: str | None
    ) -> tuple[Trees, tuple[str, ...], dict[str, Tensor], Tensor | None]:
        """What there is at factor 0 (where the factor is of all loads: all of it); names of what
        rises with the factor, and how fast, where these are constants; how fast supports go.
        """
        model, t, inputs = constants.model, problem.t, problem.inputs

        def at_rest(inputs: Inputs) -> Trees:
            return constants.at(t.new_ones(()), t, inputs, model.orientation(t))

        trees = at_rest(inputs)
        if load is None:
            moving = any(support.displacement is not None for support in model.scene.supports)
            return trees, ("load_factor",), {}, _rate(problem) if moving else None
        none = at_rest({**inputs, load: torch.zeros_like(inputs[load])})
        pairs = zip(constant_fields(none), constant_fields(trees), strict=True)
        rises = {a.name: b.value - a.value for a, b in pairs if a.value is not b.value}
        return none, tuple(rises), rises, None

    @torch.no_grad()
    def __call__(
        self, position: Tensor, rotation: Tensor, stress: Tensor, factor: Tensor
    ) -> NativePoint:
        """At position, rotation (..., N+1, *) and stress (..., N, k), under a factor (...)."""
        batch, order, x = factor.shape, self.instance.program.order, (position, rotation, stress)
        stress, forces = self.model.multipliers.split(stress)
        share = factor if self.load is None else torch.ones_like(factor)
        fields = [
            Field(record, name, value.expand(*batch, *value.shape[-axes:]).contiguous(), axes)
            if axes
            else Field(record, name, value.contiguous(), 0)
            for record, name, value, axes in (
                ("kept", "position", position, 2),
                ("kept", "rotation", rotation, 2),
                ("start_stress", "stress", stress, 2),
                *(() if forces is None else ((*OF_MULTIPLIERS[FORCES], forces, 2),)),
                ("common", "load_factor", share, 0),
                ("common", "reached", share, 0),
            )
        ]
        for field in self.rising:
            rate = next(x.value for x in self.fields if x.name == dot(field.name))
            wide = factor[(...,) + (None,) * field.axes]
            fields.append(field._replace(value=(field.value + wide * rate).contiguous()))
        size = self.instance.program.w, self.instance.program.w
        rows = {
            ("move", "move"): (self.instance.rows("move"), size[0]),
            ("stress", "stress"): stress.shape[-2:],
            ("support", "found"): self.model.constraints.fixed.shape,
            ("sample", "size"): (),
        }
        if forces is not None:
            rows["multiplier", "force"] = forces.shape[-2:]
        if self.by_rows:
            rows["row", PIVOT] = (self.instance.rows("row"), *size)
        if self.by_rows and self.instance.has("middle pivot", PIVOT):
            rows["middle pivot", PIVOT] = (self.model.scene.beam.element_count, *size)
        call = self._calls.get(batch)
        if call is None:
            check_batch(self.model, batch)
            slope = torch.tensor((0.0, 1.0), dtype=factor.dtype).reshape(2, *(1,) * len(batch))
            fixed = [*self.fields, Field("common", "slope", slope, 0)]
            out = [Output(*name, shape, steps=True) for name, shape in rows.items()]
            call = self._calls[batch] = Call(self.instance, batch, 2, fields, out, fixed=fixed)
        found = call.run([field.value for field in fields])
        move, dstress, reaction, measure, *blocks = (
            x.reshape(2, *batch, *x.shape[2:]) for x in found
        )
        if forces is not None:
            dstress = stacked(dstress, blocks.pop(0))
        answers = zip(move[..., slice(order, -order), :], dstress, reaction, strict=True)
        signs = self._pivots(*blocks) if self.by_rows else partial(self._system, *x, factor)
        return NativePoint(Size(measure[0]), self.exact, *answers, signs)

    def _pivots(self, rows: Tensor, middle: Tensor | None = None) -> Tensor:
        """Pivots (..., n, w, w), also those of nodes that supports hold, 1."""
        rows = take(rows[0], self.model.topology.ends, 2)
        return rows if middle is None else torch.cat((middle[0], rows), -3)

    def _system(self, position: Tensor, rotation: Tensor, stress: Tensor, factor: Tensor) -> System:
        """Of the tangent at a point."""
        problem = self.problem.under(factor, self.load)
        x = Configuration(position, rotation, stress)
        return problem.linearise(x, *problem.residual(x)[1:]).system


def _rate(problem: SteadyProblem) -> Tensor:
    """(..., N+1, p) m: how far supports go with all of the load."""
    model = problem.model
    start = model.space.start(rest(model.scene))
    start = Configuration(start.position, start.rotation, start.stress)

    def position(factor: Tensor) -> Tensor:
        return replace(problem, load_factor=factor).apply_supports(start).position

    zero = model.length.new_zeros(())
    return rate_along(position, (zero,), (torch.ones_like(zero),))[1]


def path_refusal(problem: SteadyProblem, load: str | None) -> str | None:
    """Why the balances of a path are not found by native code; None where they are."""
    model = problem.model
    turned = any(support.turn is not None for support in model.scene.supports)
    # of which it is not known that they are linear in their inputs
    by_user = any(map(written, (*model.loads[1], *model.scene.eigenstrains)))
    reasons = {
        "a Tendon": bool(model.scene.tendons),
        "loads between nodes": any(load.between_nodes for load in model.scene.loads),
        f"the factor of {load!r} beside functions without motion": load is not None and by_user,
        "supports that turn with the load's factor": load is None and turned,
        "loads with internal states": bool(model.internal_states),
        "what remembers": bool(model.scene.joint_memory or model.scene.memory[1]),
        "a rigid motion that nothing holds": type(problem) is not SteadyProblem,
    }
    return refusal(model) or next((reason for reason, applies in reasons.items() if applies), None)


def native_balance(problem: SteadyProblem, load: str | None, engine: str) -> NativeBalance | None:
    """Balances of a path, of which the problem is that at factor 0, by native code; None where they
    are found eagerly, with a warning where that is for what a user wrote. Raises ValueError where
    native code alone is wanted and does not take it.
    """
    engine = meaning() if engine == "auto" else engine
    if engine == "eager" or functorch.peek_interpreter_stack() is not None:
        return None
    required, reason = engine == "compiled", path_refusal(problem, load)
    if reason is not None and not required:
        return None
    return natively(
        "a path is found",
        problem.model,
        reason,
        lambda around: NativeBalance(problem, load, around),
        required,
    )
