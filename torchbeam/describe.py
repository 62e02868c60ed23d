"""What a scene has, which unknowns it needs, and which forms of the beam take it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from .effects import Along, Drag, Input, PerElement, RootSpring, Spring
from .integrate.stepper import METHODS, Stepper
from .mixed.chain import STRAINS, Chain
from .modes import modes
from .nodal.choice import only_numbers
from .nodal.model import Model
from .nodal.plane import PLANES, Plane
from .nodal.rates import Rates
from .scene import Scene
from .state import rest
from .statics import equilibrium
from .supports import AXES, Support

NUMBERS = 6  # at most so many numbers are said one by one
MIXED = {"minimal": (12, 0), "block_rate": (24, 12)}  # states an element, and besides


@dataclass(frozen=True)
class Description:
    """What `Scene.describe` finds; printed, it is a table of lines.

    lines      heading -> what is said under it
    plane      "xy" or "xz": the nodal form solves the scene there; None = in space
    planes     planes in which the whole scene lies: the answer there is that in space, with half the unknowns
    unknowns   of an implicit step and of an equilibrium: the moves of the nodes that are free
    states     form or method -> numbers in a state of it; None where it does not take the scene
    refusals   form or method -> why it does not
    """

    lines: dict[str, tuple[str, ...]]
    plane: str | None
    planes: tuple[str, ...]
    unknowns: int
    states: dict[str, int | None]
    refusals: dict[str, str]

    def __str__(self) -> str:
        width = max(map(len, self.lines))
        return "\n".join(f"{heading if not k else '':<{width}}  {line}"
                         for heading, lines in self.lines.items() for k, line in enumerate(lines or ("none",)))


@torch.no_grad()
def describe(scene: Scene) -> Description:
    """See `Scene.describe`."""
    model = Model.of(scene)
    space = model.space
    plane = space.name if isinstance(space, Plane) else None
    planes = () if plane or scene.small else tuple(name for name in PLANES if _fits(scene, name))
    free = model.held.count
    states, refusals = _forms(scene, free)
    nodes = scene.beam.count + 1
    unknowns = f"{free}: {space.unknowns} a node of {nodes} nodes, less {nodes * space.unknowns - free} that supports hold"
    lines = {
        "beam": tuple(_beam(scene)),
        "batch": (f"axes {tuple(scene.batch_shape)}; {str(scene.dtype).removeprefix('torch.')} on {scene.device}",),
        "effects": tuple(_effect(effect, nodes) for effect in scene.effects),
        "inputs": tuple(f"{name} ({size})" for name, size in scene.inputs.items()),
        "supports": tuple(_supports(scene)),
        "frame": _frame(scene),
        "moves in": (_space(scene, plane, planes),),
        "unknowns": (f"{unknowns}; {space.strain} stresses an element are condensed",),
        "forms": tuple(f"{name}: " + (f"no, {refusals[name]}" if count is None else f"{count} states")
                       for name, count in states.items()),
        "frequencies": _frequencies(scene),
    }
    return Description(lines, plane, planes, free, states, refusals)


def _fits(scene: Scene, plane: str) -> bool:
    with suppress(ValueError):
        Model.of(replace(scene, plane=plane))
        return True
    return False


def _forms(scene: Scene, free: int) -> tuple[dict[str, int | None], dict[str, str]]:
    """How many numbers a state of each form has, and why the others do not take the scene: what they say themselves."""
    inputs = {name: torch.zeros(size) for name, size in scene.inputs.items()}
    tries: dict[str, Callable[[], int]] = {
        f"nodal, {method!r}": lambda method=method: Stepper(scene, 1.0, method) and 2 * free for method in METHODS}
    tries["nodal, explicit"] = lambda: Rates.of(scene, {}).pack(rest(scene)).shape[-1]
    for form, (each, more) in MIXED.items():
        tries[form] = lambda form=form, each=each, more=more: each * Chain(scene, form, inputs).count + more
    states, refusals = {}, {}
    for name, attempt in tries.items():
        try:
            states[name] = attempt()
        except ValueError as error:
            states[name], refusals[name] = None, str(error)
    return states, refusals


def _beam(scene: Scene) -> Iterator[str]:
    beam = scene.beam
    length = beam.length.sum(-1)
    yield f"{beam.count} elements, {_number(length)} m long" + ("" if not beam.curved else ", curved or twisted at rest")
    known = [f"no {strain}: infinite stiffness" for strain, rigid in zip(STRAINS, beam.rigid, strict=True) if rigid]
    if all(beam.rigid[:3]):
        known = ["inextensible and unshearable", *known[3:]]
    known += ["stiffnesses coupled"] if beam.coupled else []
    known += ["centre of mass off the axis"] if beam.offset else []
    known += [] if beam.rotary else ["no rotary inertia"]
    if known:
        yield "; ".join(known)


def _effect(effect: Any, nodes: int) -> str:
    node = getattr(effect, "node", None)
    at = "" if effect.hook in ("strain", "eigenstrain") else " along the beam" if node is None else f" at node {node % nodes}"
    said = [f"{f.name} = {_value(v)}" if v is not True else f.name for f in fields(effect)
            if f.name != "node" and _named(v := getattr(effect, f.name), f.default)]
    return f"{type(effect).__name__}{at}" + (f": {', '.join(said)}" if said else "")


def _named(value: Any, default: Any) -> bool:
    """Whether there is something to say."""
    if isinstance(value, Tensor):
        return True
    return value is not None and value is not False and not (hasattr(value, "any") and not value.any()) and (
        hasattr(value, "any") or callable(value) or value != default)


def _value(value: Any) -> str:
    if isinstance(value, Input):
        return f"input {value.name!r}"
    if isinstance(value, (Along, PerElement)):
        return f"{type(value).__name__}({'a function' if callable(getattr(value, 'value', value)) else 'values'})"
    if callable(value):
        return "a function"
    if hasattr(value, "shape"):
        few = value.ndim < 2 and value.size if not isinstance(value, Tensor) else value.ndim < 2 and value.numel()
        if few is False or few > NUMBERS:
            return f"of shape {tuple(value.shape)}"
        return f"{value.tolist():g}" if value.ndim == 0 else "(" + ", ".join(f"{x:g}" for x in value.tolist()) + ")"
    return repr(value)


def _number(value: Tensor) -> str:
    least, most = value.min().item(), value.max().item()
    return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


def _support(support: Support) -> str:
    if support.clamp:
        held = "clamped"
    else:
        position = f"position {support.position} held" if support.position else "position free"
        turns = {0: "rotation free", 3: "rotation held"}
        about = next((axis for axis in AXES if axis not in support.rotation), "")
        held = f"{position}, {turns.get(len(support.rotation), f'hinged about {about}')}"
    moved = [name for name in ("displacement", "turn") if getattr(support, name) is not None]
    return f"node {support.node}: {held}" + (f", moved by its {' and '.join(moved)}" if moved else "")


def _supports(scene: Scene) -> Iterator[str]:
    yield from map(_support, scene.supports)
    if scene.root is not None and not any(s.node == 0 for s in scene.supports):
        yield "node 0: on springs whose root moves"


def _frame(scene: Scene) -> tuple[str, ...]:
    if scene.frame is None:
        return ("inertial",)
    return tuple(f"{name.replace('_', ' ')} {_value(value)}" for name, value in vars(scene.frame).items() if value is not None)


def _space(scene: Scene, plane: str | None, planes: tuple[str, ...]) -> str:
    if scene.small:
        return "space, small displacements and rotations: linear"
    if plane:
        return f"the plane {plane}" + (", found in its numbers" if scene.plane == "auto" else "")
    if not planes:
        return "space"
    choice = " or ".join(f"plane={name!r}" for name in planes)
    if only_numbers(scene):
        return f"space, but everything lies in a plane: {choice} gives the same answer with half the unknowns"
    return f"space; {choice} halves the unknowns, if what its functions and inputs do lies in it as well"


def _frequencies(scene: Scene) -> tuple[str, ...]:
    """Of the beam with its masses, springs and added mass, without loads, at rest; in double precision, whatever it has."""
    springs = [e for e in scene.loads if isinstance(e, (Spring, RootSpring)) and all(hasattr(v, "shape") for v in e.values)]
    if not (scene.supports or springs):
        return ("free: none of a rigid motion",)
    held = None if any(e.frees_root for e in springs if isinstance(e, RootSpring)) else tuple(
        replace(s, displacement=None, turn=None) for s in scene.supports)
    fluids = [replace(e, flow=None) for e in scene.loads if isinstance(e, Drag) and e.carries]
    kept = [_double(e) for e in (*scene.bodies, *springs, *fluids)]
    bare = replace(scene, beam=_double(scene.beam), effects=kept, frame=None, root=None, supports=held)
    try:
        at = equilibrium(bare) if springs else rest(bare)
        found = modes(bare, at, count=min(3, Model.of(bare).held.count)).frequency
    except (ValueError, RuntimeError) as error:
        return (f"not found: {error}",)
    return (", ".join(map(_number, found.flatten(0, -2).unbind(-1) if found.ndim > 1 else found)) + " rad/s, without loads",)


def _double(of: Any) -> Any:
    """A beam or an effect with its tensors in double precision."""
    held = {f.name: getattr(of, f.name) for f in fields(of) if f.init}
    return replace(of, **{name: v.double() for name, v in held.items() if isinstance(v, Tensor) and v.is_floating_point()})
