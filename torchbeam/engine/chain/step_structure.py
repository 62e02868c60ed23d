"""Step structure: what native steps of scenes of one structure have in common, whatever the values
of their tensors are.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.function_dependencies import Dependencies
from ...core.remembered import keep, structure_of
from ...math.shapes import broadcast_shapes
from ...nodal.coordinates.planar import Planar
from ...nodal.model import Model
from ..compiler.trace import NotTraceable
from . import kept_programs as programs
from .adjoint import AdjointProgram
from .call import Call, Field, Output, ProgramInstance, like
from .cells import cells_of
from .chain_constants import Trees, reader_of
from .cotangents import constant_fields, state_fields
from .interactions import present
from .kinds import Kinds
from .load_roles import LoadRoles
from .local_functions import LocalFunctions
from .order import connectivity_of
from .program import StepProgram

NUMBERS = {"status": ("sample", "last_status"), "iterations": ("sample", "iterations")}
FORMS = 32  # that are kept; the oldest goes first
STRUCTURES = 64  # likewise


class Form(NamedTuple):
    """Calls with tensors of the same shapes and strides: the call, tensors like those that it
    makes, calls of the adjoint.
    """

    call: Call
    templates: list[Tensor]
    adjoints: dict[Any, Any]


class StepStructure:
    """Of the trees of a model's constants, which `values` by name are in, each a tensor of its own:
    those of a step, the other fields hold for all steps. roles: of the model's loads; by_cells: the
    model cell by cell, None = it has none.
    """

    def __init__(
        self,
        program: StepProgram,
        model: Model,
        kinds: Kinds,
        trees: Trees,
        values: dict[str, Tensor],
        roles: LoadRoles,
        by_cells: ProgramInstance | None = None,
    ) -> None:
        self.program, self.kinds, self.instance = (
            program,
            kinds,
            ProgramInstance(program, model, kinds),
        )
        self.by_cells, self.roles = by_cells, roles
        self.none, self.all = model.length.new_zeros(()), model.length.new_ones(())
        self.state = state_fields(program)
        self.axes = {name: 0 if name in program.sample_state else 2 for name in self.state}
        names = {id(x): name for name, x in values.items()}
        fields = [*constant_fields(trees)]
        # axes that functions of t may bring along; one at least, so that none of theirs is taken
        # for that of steps
        self.dims = max(1, *(field.value.ndim - field.axes for field in fields))
        self.values = tuple(values)
        self.readers = [reader_of(tree) for tree in trees.by_record.values()]
        # of all fields: record, name and axes of a constant one, None of one that changes
        self.places = [
            None if id(field.value) in names else (field.record, field.name, field.axes)
            for field in fields
        ]
        self.changing = [
            (field._replace(value=None), names[id(field.value)])
            for field in fields
            if id(field.value) in names
        ]
        self.takes_time = roles.asks or any(
            self.instance.has(x.record, x.name) for x, name in self.changing if name == "t"
        )
        self.forms: dict[Any, Form] = {}
        self.adjoints: dict[frozenset[str], ProgramInstance] = {}

    @classmethod
    def of(
        cls,
        local: LocalFunctions,
        kinds: Kinds,
        around: Dependencies | None,
        values: dict[str, Tensor],
        roles: LoadRoles,
    ) -> StepStructure:
        """From local functions of trees with these values; around: what users' functions read.
        Raises NotTraceable where these write to that.
        """
        model = local.model
        program = programs.program_of(local, kinds, bool(model.constraints.nodes), around)
        if around is not None and not around.unchanged():
            raise NotTraceable(
                "a function of the motion writes to what it reads; one without memory is wanted"
            )
        by_cells = _by_cells(program, local, kinds, around)
        return cls(program, model, kinds, local.trees, values, roles, by_cells)

    def constant(self, trees: Trees) -> list[Field]:
        """The fields of a model's trees that hold for all steps."""
        pairs = zip(self.readers, trees.by_record.values(), strict=True)
        tensors = [x for of, tree in pairs for x in of(tree)]
        return [
            Field(*place[:2], x, place[2])
            for place, x in zip(self.places, tensors, strict=True)
            if place is not None
        ]

    def instance_for(self, samples: int, lanes: int | None) -> ProgramInstance:
        """What steps so many samples; lanes: None = as this processor has them."""
        by_cells = lanes is None and self.by_cells and self.by_cells.pays(samples)
        return self.by_cells if by_cells else self.instance

    def adjoint(
        self, names: frozenset[str], model: Model, program: Callable[[], AdjointProgram]
    ) -> ProgramInstance:
        """Of the cotangents of constants of these names."""
        if names not in self.adjoints:
            self.adjoints[names] = ProgramInstance(program(), model, self.kinds)
        return self.adjoints[names]

    def form(
        self,
        tensors: list[Tensor],
        constants: list[Field],
        K: int | None,
        dims: int,
        options: tuple[Any, ...],
        shapes: Hashable,
    ) -> Form:
        """Of K steps with such tensors: those that change, `exact`, `moving`, and the state's;
        constants: values of `constant`, and the lengths. dims: axes of the samples; shapes: all of
        this but for the constants, as a key.
        """
        key = (
            shapes,
            *[(x.shape, x.stride(), x.dtype) for x in [constant.value for constant in constants]],
        )
        known = self.forms.get(key)
        if known is None:
            form = self._form(tensors, constants, K, dims, *options)
            known = keep(self.forms, key, form, FORMS)
        return known

    @torch.no_grad()
    def _form(
        self,
        tensors: list[Tensor],
        constants: list[Field],
        K: int | None,
        dims: int,
        tolerance: float,
        least: float,
        lanes: int | None,
        every: int,
    ) -> Form:
        *values, exact, moving = tensors[: -len(self.state)]
        state = dict(zip(self.state, tensors[-len(self.state) :], strict=True))
        if any(x.device.type != "cpu" for x in tensors):
            device = next(x.device for x in tensors if x.device.type != "cpu")
            raise ValueError(
                f"a state, or an active, on {device} meets a scene on the CPU; one device is wanted"
            )
        none = torch.zeros((), dtype=self.instance.dtype)
        numbers = {"tolerance": tolerance, "least": least}
        inputs = [
            *(one._replace(value=x) for (one, _), x in zip(self.changing, values, strict=True)),
            Field("common", "exact", exact, 0),
            Field("sample", "moving", moving, 0),
            *(Field(*self.state[name], x, self.axes[name]) for name, x in state.items()),
        ]
        fixed = [
            *(Field("common", name, torch.full_like(none, x), 0) for name, x in numbers.items()),
            Field("sample", "last_status", none, 0),
        ]
        leads = [
            field.value.shape[: field.value.ndim - field.axes]
            for field in (*inputs, *constants, *fixed)
        ]
        batch = broadcast_shapes(
            *(lead if K is None else lead[len(lead) > dims :] for lead in leads)
        )
        instance = self.instance_for(batch.numel(), lanes)
        axes, shape = moving.ndim or state["work"].ndim, batch
        if K is not None and batch[: dims - axes].numel() == 1:
            shape = batch[dims - axes :]
        parts = [
            *((x.shape[x.ndim - self.axes[name] :], every) for name, x in state.items()),
            *[((), 1)] * len(NUMBERS),
        ]
        outputs = [
            Output(*place, part, K is not None, each)
            for place, (part, each) in zip((self.state | NUMBERS).values(), parts, strict=True)
        ]
        call = Call(instance, batch, K or 1, inputs, outputs, constants, fixed, lanes)
        templates = [
            like((*(() if K is None else (K // each,)), *shape, *part), self.instance.dtype)
            for part, each in parts
        ]
        return Form(call, templates, {})


def _by_cells(
    program: StepProgram, local: LocalFunctions, kinds: Kinds, around: Dependencies | None
) -> ProgramInstance | None:
    """The model cell by cell, where it has any and nothing else couples them."""
    model = local.model
    alone = model.scene.batch_shape.numel() < program.lanes()
    known = around is not None and "energy" not in program.layout.records
    if not (any(sort.celled for sort in present(kinds)) and alone and known):
        return None
    connectivity = connectivity_of(model)
    cells = cells_of(connectivity, kinds)
    if cells is None:
        return None
    held = bool(connectivity.supports)
    traced = programs.traced_of(local, kinds, held, around)
    cell = programs.program_of(local, cells.kinds, held, around, known=traced)
    return ProgramInstance(cell, model, kinds, cells)


_STRUCTURES: dict[Hashable, Any] = {}  # of steps, and of load stepping: whatever has a `program`


def by_numbers(model: Model) -> bool:
    """Whether the kinds of a model's rows follow from numbers: those of joints, tendons, pairs."""
    framework = model.topology
    return bool(framework.joints or framework.ties or model.scene.pairs)


def key_of(model: Model, kinds: Kinds | None, *options: Any) -> Hashable | None:
    """What the structure of a model's steps, or load stepping, with these options follows from,
    without a look at its trees; None where it takes one: a function, or an effect of a user's own,
    is asked for what it gives. kinds: where they follow `by_numbers`; None = the rest tells them.
    """
    scene, space = model.scene, model.space
    if scene.numbers is None or scene.pairs:
        return None
    plane = space.section_axes if isinstance(space, Planar) else None
    key = (
        structure_of(scene, []),
        type(space),
        plane,
        type(model.inertia.translational),
        model.topology,
        kinds,
        options,
    )
    try:
        hash(key)
    except TypeError:
        return None
    return key


def known_structure(key: Hashable | None) -> Any | None:
    """As long as its program is kept."""
    structure = _STRUCTURES.get(key)
    held = structure is not None and any(
        program is structure.program for program, _ in programs.PROGRAMS.values()
    )
    return structure if held else None


def keep_structure(key: Hashable | None, structure: Any) -> None:
    if key is not None:
        keep(_STRUCTURES, key, structure, STRUCTURES)
