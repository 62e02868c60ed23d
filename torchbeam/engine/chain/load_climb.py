"""Load stepping by native code, from tensors to tensors."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ...core.repetition import repetitions
from ...core.surroundings import Surroundings
from ...core.validation import broadcast
from ...equations.load_steps import LIMIT
from ...equations.steady import Configuration, least_forces
from ...math.shapes import broadcast_shapes
from ...nodal.balance import most, same_law
from ...nodal.conditions import conditions
from ...nodal.joints import stacked
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...solvers.newton import TOLERANCE
from ...state.supported_nodes import set_node
from ..compiler.trace import NotTraceable
from ..engine_use import slow_path
from .call import Call, Chain, Field, structure_fields
from .chain_constants import Trees
from .constants import Constants
from .cotangents import FORCES, OF_JOINTS, constant_fields
from .coverage import MISSING, given_up, installed, meaning, unsteady, untraceable
from .load_program import JudgedProgram, LoadProgram
from .native import NotCompiled
from .node_kinds import kinds_of
from .program import NOTHING, ChainProgram, program_of
from .steady_functions import SteadyFunctions
from .user_functions import by_function, by_sample, check_batch, known, surroundings

# samples times elements that "auto" compiles for: eager ones then take longer than tracing and
# loading
WORTH = 2**15


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
    return next((reason for reason, given in reasons.items() if given), None)


def climb(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    lanes: int | None = None,
) -> Climbed | None:
    """Raise the load from 0 to 1, see `load_steps.climb`; judged: whether to look at the tangent at
    the end. None where torch alone can do it: within torch.func. Raises ValueError for what native
    code does not take.
    """
    reason = refusal(model)
    try:
        if reason is None:
            return _climbed(model, t, inputs, x, tolerance, judged, lanes)
    except NotTraceable as error:
        reason = str(error)
    raise ValueError(
        f"engine = 'compiled' was given, which does not take this scene ({reason}); 'eager' does"
    )


def automatic_climb(
    model: Model, t: Tensor, inputs: Inputs, x: Configuration, tolerance: float | None, judged: bool
) -> Climbed | None:
    """The same where "auto" takes native code: for many samples of what it takes, those of all
    calls of a run, but for what may change unnoticed. What is not taken is warned of; None where it
    is to be done eagerly.
    """
    if meaning() == "compiled":
        return climb(model, t, inputs, x, tolerance, judged)
    samples = broadcast(
        "a scene, a start and inputs",
        model.scene.batch_shape,
        *(v.shape[:-2] for v in x),
        *(v.shape[:-1] for v in inputs.values()),
    ).numel()
    samples *= repetitions()
    if (
        meaning() == "eager"
        or samples * (model.station_count or model.node_count) < WORTH
        or model.scene.device.type != "cpu"
    ):
        return None
    reason, own = refusal(model), by_function(model)
    if reason is None and (reason := unsteady(model)) is None:
        try:
            return _climbed(
                model, t, inputs, x, tolerance, judged, None, surroundings(own) if own else NOTHING
            )
        except NotCompiled as error:
            given_up(error, "equilibria are found")
            return None
        except NotTraceable as error:
            reason = untraceable(own[0], error) if own else str(error)
        except Exception:
            if own:  # of the user's function: raised eagerly, too
                return None
            raise
    slow_path("equilibria are found", reason)
    return None


@torch.no_grad()
def _climbed(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    lanes: int | None,
    around: Surroundings | None = None,
) -> Climbed | None:
    if functorch.peek_interpreter_stack() is not None:
        return None
    if around is None:
        around = known(by_function(model)) if by_function(model) else NOTHING
    return by_sample(
        lambda own: _called(model, t, inputs, x, tolerance, judged, lanes, own), model, around
    )


def _called(
    model: Model,
    t: Tensor,
    inputs: Inputs,
    x: Configuration,
    tolerance: float | None,
    judged: bool,
    lanes: int | None,
    around: Surroundings | None,
) -> Climbed:
    constants = Constants(model, steps=False, around=around)
    local = SteadyFunctions(model, *trees_at_rest(constants, t, inputs))
    joints = model.joints.count > 0
    judged = judged and not model.scene.beam.parts  # of a structure it is looked at by torch
    chain, fields = prepared(
        local, constants, t, inputs, around, JudgedProgram if judged else LoadProgram
    )
    exact = same_law(local.elements.C, model.law.C)
    tolerance = model.length.new_tensor(tolerance or TOLERANCE[model.length.dtype])
    stress, forces = model.joints.split(x.stress)
    start = x._asdict() | {"stress": stress} | ({FORCES: forces} if joints else {})
    place = {"stress": ("start_stress", "stress"), **OF_JOINTS, "reaction": ("support", "last")}
    given = [
        *fields,
        Field("common", "exact", exact, 0),
        Field("common", "tolerance", tolerance, 0),
        *(Field(*place.get(name, ("kept", name)), v, 2) for name, v in start.items()),
    ]
    batch = broadcast_shapes(*(one.value.shape[: one.value.ndim - one.axes] for one in given))
    check_batch(model, batch)
    call = Call(chain, batch, 1, lanes)
    states = {name: call.empty(*v.shape[-2:], steps=False) for name, v in start.items()}
    states["reaction"] = call.empty(*model.constraints.fixed.shape, steps=False)
    outputs = {name: call.empty(steps=False) for name in ("last_status", "indefinite")}
    out = [Field(*place.get(name, ("kept", name)), v, 2, flat=True) for name, v in states.items()]
    out += [Field("sample", name, v, 0, flat=True) for name, v in outputs.items()]
    given += [Field("free", "free", chain.free, 2), *structure_fields(chain)]
    call.bound({}, inputs=given, outputs=out).run(LIMIT)
    solution = {name: v.reshape(*batch, *v.shape[1:]) for name, v in states.items()}
    if joints:
        solution["stress"] = stacked(solution["stress"], solution.pop(FORCES))
    *shape, reaction = solution.values()
    status, indefinite = (v.reshape(batch) for v in outputs.values())
    return Climbed(
        Configuration(*shape), reaction, status.long(), indefinite != 0 if judged else None
    )


def trees_at_rest(constants: Constants, t: Tensor, inputs: Inputs) -> Trees:
    """Those of what stands still."""
    model = constants.model
    nodes, elements, *others = constants.at(t.new_ones(()), t, inputs, model.orientation(t))
    return nodes, replace(elements, C=model.tangent_stiffness()), *others


def prepared(
    local: SteadyFunctions,
    constants: Constants,
    t: Tensor,
    inputs: Inputs,
    around: Surroundings | None,
    program_type: type[ChainProgram],
) -> tuple[Chain, list[Field]]:
    """A model at rest in a program of this class, and the fields that are the same throughout."""
    model = local.model
    kinds = kinds_of(model, constants.acts, rest=True)
    program = program_of(local, kinds, bool(model.constraints.nodes), around, program_type)
    chain = Chain(program, model, kinds)
    length, p = model.spans, model.space.dims.position
    least = least_forces(model, conditions(model, t, inputs))
    numbers = {"total": length.sum((-1, -2)), "longest": length.amax((-1, -2))}
    for name, columns in (("force", slice(p)), ("moment", slice(p, None))):
        sizes = torch.broadcast_tensors(*(most(x[..., columns]) for x in least))
        numbers[f"least_{name}"] = torch.stack(sizes).amax(0)
    if model.joints.count:
        numbers["joint_size"] = model.joints.size
    fields = [
        *constant_fields(local.trees),
        *_poses(model, t),
        *(Field("common", name, v, 0) for name, v in numbers.items()),
    ]
    return chain, [one for one in fields if chain.has(one.record, one.name)]


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
