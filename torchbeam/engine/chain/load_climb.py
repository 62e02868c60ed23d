"""Load stepping by native code, from tensors to tensors."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.function_dependencies import Dependencies
from ...core.remembered import keep
from ...core.repetition import repetitions
from ...core.validation import broadcast
from ...equations.least_forces import least_forces
from ...equations.load_steps import LEAST, LIMIT
from ...equations.steady import Configuration
from ...math.shapes import broadcast_shapes
from ...nodal.balance import most, same_law
from ...nodal.conditions import conditions
from ...nodal.model import Model
from ...nodal.multipliers import stacked
from ...scene.effects import Inputs
from ...solvers.newton import TOLERANCE
from ...state.supported_nodes import set_node
from .call import Call, Field, Output, ProgramInstance
from .chain_constants import Trees
from .constants import Constants, sizes
from .cotangents import OF_MULTIPLIERS, constant_fields
from .coverage import MISSING, installed, meaning, natively
from .kept_programs import program_of
from .kinds import kinds_of
from .layout import FORCES
from .load_program import LoadProgram
from .load_roles import LoadRoles
from .native import NativeProgram
from .order import connectivity_of
from .program import NewtonProgram
from .steady_functions import SteadyFunctions
from .step_structure import by_numbers, keep_structure, key_of, known_structure
from .user_functions import check_batch

# samples times elements that "auto" compiles for: eager ones then take longer than tracing and
# loading. Where eager systems are dense, by tendons, each weighs as much as so many more elements.
WORTH = 2**15
CALLS = 8  # of a structure that are kept; the oldest goes first


class Climbed(NamedTuple):
    """Shape, reaction and status as of `load_steps.climb`; doubtful (...): whether the tangent
    there is not positive definite, None = not asked for.
    """

    x: Configuration
    reaction: Tensor
    status: Tensor
    doubtful: Tensor | None


def refusal(model: Model) -> str | None:
    """Why the equilibria of a model are not found by native code; None where they are."""
    scene = model.scene
    reasons = {
        "contact of beams and bodies with each other": bool(scene.pairs),
        f"the device {scene.device}": scene.device.type != "cpu",
        MISSING: not installed(),
    }
    return next((reason for reason, applies in reasons.items() if applies), None)


def climb(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    whole: bool = False,
    required: bool = True,
) -> Climbed | None:
    """Raise the load from 0 to 1, see `load_steps.climb`; judged: whether to look at the tangent at
    the end; whole: in one step, samples that this does not do for have failed. None where torch
    alone can do it: within torch.func. Raises ValueError for what native code does not take, where
    it is `required`; else that is warned of, and None.
    """
    if functorch.peek_interpreter_stack() is not None:
        return None

    def make(around: Dependencies | None) -> Climbed:
        return _climbed(model, t, inputs, x, tolerance, judged, whole, around)

    return natively("equilibria are found", model, refusal(model), make, required)


def automatic_climb(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    whole: bool = False,
) -> Climbed | None:
    """The same where "auto" takes native code: for many samples of what it takes, those of all
    calls of a run, but for what may change unnoticed. What is not taken is warned of; None where it
    is to be done eagerly.
    """
    required = meaning() == "compiled"
    samples = broadcast(
        "a scene, a start and inputs",
        model.scene.batch_shape,
        *(v.shape[:-2] for v in x),
        *(v.shape[:-1] for v in inputs.values()),
    ).numel()
    few = samples * repetitions() * _eager_weight(model) < WORTH
    if not required and (meaning() == "eager" or few or model.scene.device.type != "cpu"):
        return None
    return climb(model, t, inputs, x, tolerance, judged, whole, required)


def _eager_weight(model: Model) -> float:
    """Of a sample, in elements of a beam without tendons: of S stretches S (10 + S/8) more
    (measured: 46 of 4, 225 of 24).
    """
    stretches = len(model.tendons.stretches)
    return (model.station_count or model.node_count) + stretches * (10 + stretches / 8)


class LoadStructure(NamedTuple):
    """What load stepping of models of one structure has in common, whatever the values of their
    tensors are; calls: by the shapes and strides of these.
    """

    instance: ProgramInstance
    roles: LoadRoles
    calls: dict[Hashable, Call]

    @property
    def program(self) -> NativeProgram:
        return self.instance.program


@torch.no_grad()
def _climbed(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    whole: bool,
    around: Dependencies | None,
) -> Climbed:
    # where there are own unknowns that are no forces of constraints, it is looked at by torch
    edges = connectivity_of(model).edges
    judged = judged and not any(edge.alone for rows in edges for edge in rows)
    structure, trees = _structure(model, t, inputs, around, judged)
    instance, multiplied = structure.instance, model.multipliers.count > 0
    exact = same_law(trees.element.C, model.law.C)
    tolerance = model.length.new_tensor(tolerance or TOLERANCE[model.length.dtype])
    stress, forces = model.multipliers.split(x.stress)
    start = x._asdict() | {"stress": stress} | ({FORCES: forces} if multiplied else {})
    place = {
        "stress": ("start_stress", "stress"),
        **OF_MULTIPLIERS,
        "reaction": ("support", "last"),
    }
    fields = [
        *fields_at_rest(instance, model, trees, t, inputs),
        Field("common", "exact", exact, 0),
        Field("common", "tolerance", tolerance, 0),
        Field("common", "smallest", tolerance.new_tensor(1.0 if whole else LEAST), 0),
        *(Field(*place.get(name, ("kept", name)), v, 2) for name, v in start.items()),
    ]
    batch = broadcast_shapes(*(x.value.shape[: x.value.ndim - x.axes] for x in fields))
    check_batch(model, batch)
    key = batch, *[(x.value.shape, x.value.stride(), x.value.dtype) for x in fields]
    call = structure.calls.get(key)
    shapes = {name: v.shape[-2:] for name, v in start.items()}
    shapes["reaction"] = model.constraints.fixed.shape
    if call is None:
        out = [Output(*place.get(name, ("kept", name)), shape) for name, shape in shapes.items()]
        out += [Output("sample", name, ()) for name in ("last_status", "indefinite")]
        call = Call(instance, batch, 1, fields, out)
        keep(structure.calls, key, call, CALLS)
    found = [
        x.reshape((*batch, *x.shape[1:])) for x in call.run([x.value for x in fields], limit=LIMIT)
    ]
    solution = dict(zip(shapes, found, strict=False))
    if multiplied:
        solution["stress"] = stacked(solution["stress"], solution.pop(FORCES))
    *shape, reaction = solution.values()
    status, indefinite = found[-2:]
    return Climbed(
        Configuration(*shape), reaction, status.long(), indefinite != 0 if judged else None
    )


def _structure(
    model: Model, t: Tensor, inputs: Inputs, around: Dependencies | None, judged: bool
) -> tuple[LoadStructure, Trees]:
    """That of an earlier model if there was one, and this one's trees."""
    constants = kinds = None
    if by_numbers(model):
        constants = Constants(model, steps=False, around=around)
        kinds = kinds_of(model, constants.acts, rest=True)
    key = key_of(model, kinds, LoadProgram, judged)
    structure = known_structure(key)
    if constants is None:
        roles = None if structure is None else structure.roles
        constants = Constants(model, steps=False, around=around, roles=roles)
    trees = constants.at(t.new_ones(()), t, inputs, model.orientation(t))
    if structure is None:
        local = SteadyFunctions(model, trees)
        instance = instance_at_rest(local, constants, around, LoadProgram, judged=judged)
        structure = LoadStructure(instance, constants.roles, {})
        keep_structure(key, structure)
    return structure, trees


def instance_at_rest(
    local: SteadyFunctions,
    constants: Constants,
    around: Dependencies | None,
    program_type: type[NewtonProgram],
    **options: bool,
) -> ProgramInstance:
    """A model at rest in a program of this class, with these options."""
    model = local.model
    kinds = kinds_of(model, constants.acts, rest=True)
    held = bool(model.constraints.nodes)
    program = program_of(local, kinds, held, around, program_type, **options)
    return ProgramInstance(program, model, kinds)


def fields_at_rest(
    instance: ProgramInstance, model: Model, trees: Trees, t: Tensor, inputs: Inputs
) -> list[Field]:
    """The fields that are the same throughout."""
    p, numbers = model.space.dims.position, sizes(model)
    least = least_forces(model, trees.element.C, lambda: conditions(model, t, inputs))
    for name, columns in (("force", slice(p)), ("moment", slice(p, None))):
        parts = torch.broadcast_tensors(*(most(x[..., columns]) for x in least))
        numbers[f"least_{name}"] = torch.stack(parts).amax(0)
    fields = [
        *constant_fields(trees),
        *_poses(model, t),
        *(Field("common", name, v, 0) for name, v in numbers.items()),
    ]
    return [x for x in fields if instance.has(x.record, x.name)]


def _poses(model: Model, t: Tensor) -> list[Field]:
    """Of supports."""
    beam = model.scene.beam
    poses = {"position": beam.nodes, "rotation": beam.frames}
    for name in ("displacement", "turn"):
        poses[name] = torch.zeros_like(beam.nodes)
    for support in model.scene.supports:
        for name, value in zip(
            ("displacement", "turn"), model.prescribed_motion.displacement(support, t), strict=True
        ):
            poses[name] = (
                poses[name] if value is None else set_node(poses[name], support.node, value)
            )
    return [Field("pose", f"pose.{name}", value, 2) for name, value in poses.items()]
