"""Description of a scene: its contents, unknowns, and the forms and methods that take it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ..core.leaves import batch_shapes, constant, functions, sent
from ..core.summary import counted, span
from ..dynamics.forms import FORMS, mixed_forms
from ..dynamics.methods import METHODS
from ..dynamics.stepper import Stepper
from ..engine.chain.coverage import why_eager
from ..linear.modes import modes
from ..nodal.coordinates.planar import PLANES
from ..nodal.coordinates.selection import only_numbers
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..nodal.rates import Rates
from ..scene.effects import (
    POSITION,
    Along,
    Contact,
    Damping,
    DynamicStall,
    Effect,
    Input,
    MassDamping,
    Obstacle,
    PerElement,
    PointMass,
    Polar,
    WindField,
)
from ..scene.effects.contact_terms import ContactTerms
from ..scene.effects.tendon import Eyelet
from ..scene.parts import part_of
from ..scene.scene import Scene
from ..scene.section import notes
from ..scene.stations import Table
from ..scene.supports import AXES, Support
from ..state.state import rest
from ..statics.equilibrium import equilibrium
from ..statics.mechanism import unheld
from .convergence.on_request import choices_of

NUMBERS = 6  # at most so many numbers are said one by one


@dataclass(frozen=True)
class Description:
    """Result of `describe`; printed, it is a table of lines.

    Args:
        lines: heading -> text below it
        plane: "xy" or "xz": the nodal form solves the scene there; None = in space
        planes: planes in which the whole scene lies: the answer there is the same, with half the
            unknowns
        unknowns: of an implicit step and of an equilibrium: the moves of the nodes that are free
        states: form or method -> numbers in a state of it; None where it does not take the scene
        refusals: form or method -> why it does not

    Examples:
        >>> tb.describe(scene).unknowns  # of a step
        24
        >>> tb.describe(scene).planes  # in which the whole scene lies
        ('xz',)
    """

    lines: dict[str, tuple[str, ...]]
    plane: str | None
    planes: tuple[str, ...]
    unknowns: int
    states: dict[str, int | None]
    refusals: dict[str, str]

    def __str__(self) -> str:
        width = max(map(len, self.lines))
        return "\n".join(
            f"{heading if not k else '':<{width}}  {line}"
            for heading, lines in self.lines.items()
            for k, line in enumerate(lines or ("none",))
        )


@torch.no_grad()
def describe(scene: Scene) -> Description:
    """Description of a scene: effects, supports, planes that it lies in, unknowns of a step, first
    frequencies, mechanisms, and which forms and methods take it. Raises ValueError for a scene that
    the nodal form does not take.

    Examples:
        >>> description = tb.describe(scene)  # print it
        >>> description.unknowns, description.planes
        (24, ('xz',))
    """
    model = discretise(scene)
    space = model.space
    plane = space.plane
    planes = () if plane else tuple(name for name in PLANES if _fits(scene, name))
    free = model.constraints.count
    held = model.joints.held_count
    arms = scene.arms * scene.beam.station_count * space.dims.strain
    states, refusals = _forms(scene, 2 * (free - held) + sum(scene.internal_states) + arms)
    nodes = scene.beam.node_count
    unknowns = (
        f"{free}: {space.unknowns} a node of {nodes} nodes, less "
        f"{nodes * space.unknowns - free} that supports hold"
    )
    unknowns += f"; {held} forces of joints" * bool(held)
    lines = {
        "beam": tuple(_beam(scene)),
        "batch": tuple(_batch(scene)),
        "effects": tuple(_effect(effect, scene) for effect in scene.effects),
        "inputs": tuple(f"{name} ({size})" for name, size in scene.inputs.items()),
        "supports": tuple(_supports(scene)),
        **({"joints": tuple(_joints(scene))} if scene.beam.parts else {}),
        "frame": _frame(scene),
        "moves in": (_space(scene, plane, planes),),
        "unknowns": (
            f"{unknowns}; {space.dims.strain * scene.beam.order} stresses an element are condensed",
        ),
        "forms": tuple(
            f"{name}: " + (f"no, {refusals[name]}" if count is None else f"{count} states")
            for name, count in states.items()
        ),
        "engine": _engine(model),
        "frequencies": _frequencies(scene),
    }
    if choices := choices_of(scene):
        lines["accuracy"] = tuple(map(str, choices))
    return Description(lines, plane, planes, free, states, refusals)


def _fits(scene: Scene, plane: str) -> bool:
    with suppress(ValueError):
        discretise(replace(scene, plane=plane))
        return True
    return False


def _forms(scene: Scene, size: int) -> tuple[dict[str, int | None], dict[str, str]]:
    """Size of the state of each form that takes the scene, of implicit ones `size`, and why each
    other form does not.
    """
    tries: dict[str, Callable[[], int]] = {
        f"nodal, {method!r}": lambda method=method: Stepper(scene, 1.0, method) and size
        for method in METHODS
    }
    tries["nodal, explicit"] = lambda: Rates.of(scene, {}).pack(rest(scene)).shape[-1]
    for form in FORMS[1:]:
        tries[form] = lambda form=form: mixed_forms().state_size(scene, form)
    states, refusals = {}, {}
    for name, attempt in tries.items():
        try:
            states[name] = attempt()
        except ValueError as error:
            states[name], refusals[name] = None, str(error)
    return states, refusals


def _engine(model: Model) -> tuple[str, ...]:
    """Which engine steps the scene, and why the eager one does."""
    reason = why_eager(model, "midpoint")
    return ("compiled: native code" if reason is None else f"eager: {reason}",)


def _beam(scene: Scene) -> Iterator[str]:
    if scene.beam.parts:
        yield from scene.beam.words()
        return
    beam = scene.beam
    length = beam.length.sum(-1)
    order = f" of order {beam.order}" if beam.order > 1 else ""
    shape = ", curved or twisted at rest" if beam.curved else ""
    yield f"{beam.element_count} elements{order}, {span(length)} m long{shape}"
    known = notes(beam)
    if known:
        yield "; ".join(known)


def _batch(scene: Scene) -> Iterator[str]:
    shape, beam = tuple(scene.batch_shape), scene.beam
    yield f"axes {shape}; {str(scene.dtype).removeprefix('torch.')} on {scene.device}"
    if not shape or beam.parts or shape[-1] not in (beam.element_count, beam.node_count):
        return
    owners = ["the beam"] if any(map(len, batch_shapes(beam))) else []
    owners += [effect.called for effect in scene.effects if any(map(len, batch_shapes(effect)))]
    if len(owners) == 1:
        yield (
            f"by {owners[0]} alone, as many as its elements or nodes: a value a sample; along the "
            "beam Stations, Table, Along or PerElement are wanted"
        )


def _effect(effect: Effect, scene: Scene) -> str:
    node, beam = effect.node, scene.beam
    whole = "all" if beam.parts else "the beam"
    at = "" if effect.kind in ("strain", "eigenstrain", "interaction") else f" along {whole}"
    at = at if effect.on is None else f" on {effect.on!r}"
    at = at if node is None else f" at node {node if beam.parts else node % beam.node_count}"
    said = [
        (f"{f.name} = {_value(v)}" if v is not True else f.name)
        + " (by default)" * (f.name in getattr(effect, "follows", ()))
        for f in fields(effect)
        if f.init
        and f.name not in ("node", "on")
        and _named(v := getattr(effect, f.name), f.default)
    ]
    if isinstance(effect, ContactTerms) and node is None:
        names = [name for name in (effect.on, getattr(effect, "partner", None)) if name is not None]
        if not any(part_of(beam.parts, name).body for name in names):
            capped = any(isinstance(x, Contact) and x.node is not None for x in scene.effects)
            ends = ["no round ends: a tip that pushes sinks in"] * (not capped)
            said += ["no radius: axes touch"] if effect.radius is None else ends
    return f"{effect.called}{at}" + (f": {', '.join(said)}" if said else "")


def _named(value: Any, default: Any) -> bool:
    """Whether there is something to say."""
    if isinstance(value, Tensor):
        return True
    return (
        value is not None
        and value is not False
        and not (hasattr(value, "any") and not value.any())
        and (hasattr(value, "any") or callable(value) or value != default)
    )


def _value(value: Any) -> str:
    if isinstance(value, Input):
        return f"input {value.name!r}"
    if isinstance(value, (Along, PerElement)):
        held = getattr(value, "value", value)
        named = "a function" if callable(held) else "values"
        named = _value(held) if isinstance(held, Input) else named
        return f"{type(value).__name__}({named})"
    if isinstance(value, tuple) and value and isinstance(value[0], Eyelet):
        ends = ("the ground" if x.node is None else f"node {x.node}" for x in (value[0], value[-1]))
        return f"{len(value)} from {' to '.join(ends)}"
    if isinstance(value, Table):
        return f"a Table of {value.s.shape[-1]} places"
    if isinstance(value, Obstacle):
        return f"{value.called}{', which moves' if functions(value) else ''}"
    if isinstance(value, (WindField, Polar, DynamicStall)):
        return str(value)
    if callable(value):
        return "a function"
    if hasattr(value, "shape"):
        if value.ndim > 1 or math.prod(value.shape) > NUMBERS:
            return f"of shape {tuple(value.shape)}"
        if value.ndim == 0:
            return f"{value.tolist():g}"
        return "(" + ", ".join(f"{x:g}" for x in value.tolist()) + ")"
    return repr(value)


def _support(support: Support) -> str:
    if support.clamp:
        held = "clamped"
    else:
        position = f"position {support.position} held" if support.position else "position free"
        turns = {0: "rotation free", 3: "rotation held"}
        about = next((axis for axis in AXES if axis not in support.rotation), "")
        held = f"{position}, {turns.get(len(support.rotation), f'hinged about {about}')}"
    motion = {name: getattr(support, name) for name in ("displacement", "turn")}
    moved = [name for name, value in motion.items() if callable(value)]
    pairs = zip(("displaced", "turned"), motion.values(), strict=True)
    still = [word for word, value in pairs if value is not None and not callable(value)]
    return (
        f"node {support.node}: {held}"
        + (f", moved by its {' and '.join(moved)}" if moved else "")
        + (f", {' and '.join(still)}" if still else "")
    )


def _supports(scene: Scene) -> Iterator[str]:
    yield from map(_support, scene.supports)
    if scene.root is not None and not any(s.node == 0 for s in scene.supports):
        yield "node 0: on springs whose root moves"


def _joints(scene: Scene) -> Iterator[str]:
    """Each joint, and how many constraints and loops they make."""
    for joint in scene.joints:
        laws = [type(law).__name__ for law in (joint.hysteresis, joint.drive) if law is not None]
        yield ", ".join((f"{joint}: holds {counted(joint.holds, 'component')}", *laws))
    yield (
        f"{counted(scene.beam.loops(tuple(s.node for s in scene.supports)), 'closed loop')}, "
        "of parts and of the ground"
    )


def _frame(scene: Scene) -> tuple[str, ...]:
    if scene.frame is None:
        return ("inertial",)
    return tuple(
        f"{name.replace('_', ' ')} {_value(value)}"
        for name, value in vars(scene.frame).items()
        if value is not None
    )


def _space(scene: Scene, plane: str | None, planes: tuple[str, ...]) -> str:
    where = f"the plane {plane}" if plane else "space"
    where += ", found in its numbers" * (plane is not None and scene.plane == "auto")
    where += ", small displacements and rotations: linear" * scene.small
    if not planes:
        return where
    choice = " or ".join(f"plane={name!r}" for name in planes)
    if only_numbers(scene):
        return (
            f"{where}, but everything lies in a plane: {choice} gives the same answer with half "
            "the unknowns"
        )
    return (
        f"{where}; {choice} halves the unknowns, if what its functions and inputs do lies in it "
        "as well"
    )


def _frequencies(scene: Scene) -> tuple[str, ...]:
    """Of the beam with masses, springs and added mass, unloaded, at rest; in double precision."""
    acts = (*scene.loads, *scene.interactions)
    vibrating = (act.in_free_vibration() for act in acts)
    in_vibration = [e for e in vibrating if e is not None and constant(e)]
    springs = [e for e in in_vibration if POSITION in e.depends and e.kind == "load"]
    if not (scene.supports or springs):
        return ("free: none of a rigid motion",)
    held = tuple(replace(s, displacement=None, turn=None) for s in scene.supports)
    effects = (*scene.bodies, *in_vibration)
    bare = replace(scene, effects=effects, frame=None, root=None, supports=held)
    bare = sent(bare, torch.float64)
    try:
        model = discretise(bare)
        batch = (0,) * len(bare.batch_shape)
        count, loose = unheld(model, bare.beam.nodes.new_zeros(()), {}, batch)
        if loose and springs:
            return (f"a mechanism: nothing holds {loose}",)
        at = equilibrium(bare) if springs else rest(bare)
        most = min(3 + count, model.constraints.count)
        frequencies = modes(bare, at, count=most).frequency[..., count:]
    except (ValueError, RuntimeError) as error:
        return (f"not found: {error}",)
    each = frequencies.flatten(0, -2).unbind(-1) if frequencies.ndim > 1 else frequencies
    numbers = f"{', '.join(map(span, each))} rad/s, without loads"
    if not scene.joints and all(isinstance(e, PointMass) for e in in_vibration):
        numbers += _ratios(scene, each)
    return (f"a mechanism: nothing holds {loose}; beside that {numbers}" if loose else numbers,)


def _ratios(scene: Scene, each: Any) -> str:
    """Damping ratios at frequencies, of damping that is the same in all of the beam."""
    damping = [e for e in scene.effects if isinstance(e, (Damping, MassDamping))]
    rates = [(getattr(e, "tau", 0.0), getattr(e, "alpha", 0.0)) for e in damping]
    numbers = (*each, *(x for pair in rates for x in pair))
    many = any(torch.as_tensor(x).numel() > 1 for x in numbers)
    if not rates or many or scene.viscoelastic or any(e.on is not None for e in damping):
        return ""
    tau, alpha = (sum(column) for column in zip(*rates, strict=True))
    ratios = ", ".join(f"{float(tau * w / 2 + alpha / (2 * w)):.2g}" for w in each)
    return f"; damping ratios {ratios} (1 = critical)"
