"""Scene: a beam, how it is held, how its frame moves, and the effects that act on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .beam import Beam
from .checks import as_tensor, axis_last, broadcast, precision
from .effects import Damping, Effect, Input, Inputs
from .supports import Frame, RootMotion, Support

if TYPE_CHECKING:
    from .describe import Description

PLANES = (None, "xy", "xz", "auto")
HOOKS = ("load", "strain", "inertia", "eigenstrain")


@dataclass(frozen=True)
class Scene:
    """What is simulated; only what is named exists.

    beam      `Beam`
    effects   loads, damping, point masses ..., see `torchbeam.effects`
    frame     `Frame`, None = frame a is inertial
    root      `RootMotion` of the clamp at node 0, None = it stays where the beam has it
    plane     None = 3D. "xy" or "xz": solved in that plane of frame a with three unknowns a node; what acts out of it is left
              out where it is a function or an input, and refused where it is a number. "auto": in a plane if the beam, its
              sections and all numbers lie in one and nothing else acts
    supports  `Support`s; None = a clamp at node 0, () = free
    small     small displacements and rotations: linear about the undeformed beam. A state holds rotations below pi

    Sorted once, here: `loads`, `bodies` (point masses), `eigenstrains`, `damping` (one `Damping` or None), `inputs` (name ->
    size), `supports` by node.

    Raises ValueError for an object without a hook, two dampings, a node that does not exist, a load whose dtype is not
    the beam's, two inputs of one name with different sizes, two supports of one node, or what leaves the plane.
    """

    beam: Beam
    effects: Iterable[Effect] = ()
    frame: Frame | None = None
    root: RootMotion | None = None
    plane: str | None = None
    supports: Iterable[Support] | None = None
    small: bool = False
    loads: tuple[Effect, ...] = field(init=False)
    damping: Damping | None = field(init=False)
    bodies: tuple[Effect, ...] = field(init=False)
    eigenstrains: tuple[Effect, ...] = field(init=False)
    inputs: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.beam, Beam):
            raise ValueError(f"a beam of type {type(self.beam).__name__} was given; a torchbeam.Beam is wanted")
        precision(self.beam.nodes.dtype)
        effects = tuple(self.effects) if isinstance(self.effects, Iterable) else (self.effects,)
        for effect in effects:
            if isinstance(effect, type) or getattr(effect, "hook", None) not in HOOKS:
                raise ValueError(f"{effect!r} is not an effect; see torchbeam.effects for what is")
            self._check_node(effect)
            self._check_dtype(effect)
        damping = [e for e in effects if e.hook == "strain"]
        if len(damping) > 1:
            raise ValueError(f"{len(damping)} dampings were given; at most one is wanted")
        inputs: dict[str, int] = {}
        for value in (v for e in effects for v in e.values if isinstance(v, Input)):
            if inputs.setdefault(value.name, value.size) != value.size:
                raise ValueError(f"the input {value.name!r} has the sizes {inputs[value.name]} and {value.size}; one is wanted")
        set_ = object.__setattr__
        set_(self, "effects", effects)
        for name, hook in (("loads", "load"), ("bodies", "inertia"), ("eigenstrains", "eigenstrain")):
            set_(self, name, tuple(e for e in effects if e.hook == hook))
        set_(self, "damping", damping[0] if damping else None)
        set_(self, "inputs", inputs)
        set_(self, "supports", self._supported())
        _ = self.batch_shape  # says so where the axes do not fit
        if self.plane not in PLANES:
            raise ValueError(f"plane = {self.plane!r} was given; {', '.join(map(repr, PLANES))} are there")

    @property
    def carried(self) -> bool:
        """Whether anything that holds the beam moves: frame a, or a support."""
        return self.frame is not None or any(s.moves for s in self.supports)

    def _supported(self) -> tuple[Support, ...]:
        """The supports by node, nodes counted from the root; the root's motion in that of node 0."""
        freed = any(getattr(e, "frees_root", False) for e in self.effects)
        asked = self.supports.given if isinstance(self.supports, _Found) else self.supports
        given = (() if freed else (Support(0),)) if asked is None else asked
        given = (given,) if isinstance(given, Support) else tuple(given)
        count, found = self.beam.count + 1, {}
        for support in given:
            if not isinstance(support, Support):
                raise ValueError(f"{support!r} was given as a support; a torchbeam.Support is wanted")
            if not -count <= support.node < count:
                raise ValueError(f"a support of node {support.node} was given; the beam has the nodes 0 to {count - 1}")
            if found.setdefault(support.node % count, support) is not support:
                raise ValueError(f"two supports of node {support.node % count} were given; one is wanted")
        if freed and 0 in found and any(found[0].held):
            raise ValueError("a RootSpring and a support that holds node 0 were given; one of them is wanted")
        if self.root is not None and not freed and not (0 in found and found[0].turn is self.root.rotation
                                                        and found[0].displacement is self.root.displacement):
            if 0 not in found or not found[0].clamp or found[0].moves:
                raise ValueError("root was given for a node 0 that is not clamped or has a motion of its own; one clamp with "
                                 "one motion is wanted")
            found[0] = replace(found[0], displacement=self.root.displacement, turn=self.root.rotation)
        supports = _Found(replace(found[node], node=node) for node in sorted(found))
        supports.given = None if asked is None else given
        return supports

    def _check_node(self, effect: Effect) -> None:
        node, N = getattr(effect, "node", None), self.beam.count
        if node is not None and not -(N + 1) <= node <= N:
            raise ValueError(f"node = {node} was given for a beam with the nodes 0 to {N}; -1 is the tip")

    def _check_dtype(self, effect: Effect) -> None:
        dtype = self.beam.nodes.dtype
        tensors = [*effect.values, getattr(effect, "tau", None)]
        for value in tensors:
            if isinstance(value, Tensor) and value.is_floating_point() and value.ndim and value.dtype != dtype:
                raise ValueError(f"{type(effect).__name__} of dtype {value.dtype} meets a beam of {dtype}; one dtype is wanted")

    @property
    def dtype(self) -> torch.dtype:
        return self.beam.nodes.dtype

    @property
    def device(self) -> torch.device:
        return self.beam.nodes.device

    @property
    def batch_shape(self) -> torch.Size:
        """Broadcast of the leading axes of the beam and of the loads' tensors (functions and inputs join later)."""
        loads = [v.shape[:-1] for e in self.effects for v in e.values if hasattr(v, "shape")]
        taus = [] if self.damping is None else [self.damping.tau.shape[:-1] if self.damping.six else self.damping.tau.shape]
        return broadcast("a beam and loads", self.beam.batch_shape, *loads, *taus)

    def describe(self) -> Description:
        """What is on, the unknowns that it takes, the plane in which it lies, and the forms and methods that take it or why
        they do not. Print it, or see `torchbeam.describe.Description`. Raises ValueError for what the nodal form does not take.
        """
        from .describe import describe  # which knows every form

        return describe(self)

    def tensors(self, given: dict[str, Any]) -> Inputs:
        """Inputs as tensors, by keyword or in a dictionary inputs={...}, which has room for names that are keywords of a
        function. Raises ValueError where one is missing, unknown, of the wrong size, or of axes that do not broadcast.
        """
        if isinstance(given.get("inputs"), dict):
            given = named(given["inputs"], {name: value for name, value in given.items() if name != "inputs"})
        for name in given:
            if name not in self.inputs:
                raise ValueError(f"the input {name!r} was given; the scene has {', '.join(self.inputs) or 'none'}")
        for name in self.inputs:
            if name not in given:
                raise ValueError(f"the input {name!r} is missing; the scene wants {', '.join(self.inputs)}")
        found = {name: axis_last(f"input {name!r}", as_tensor(value, self.dtype, self.device), self.inputs[name])
                 for name, value in given.items()}
        if found:
            broadcast("a scene and inputs", self.batch_shape, *(value.shape[:-1] for value in found.values()))
        return found


class _Found(tuple):
    """Supports by node; `given` is what they were found from, so that `dataclasses.replace` finds them afresh."""

    given: Iterable[Support] | None = None


def named(inputs: Any, more: dict[str, Any]) -> dict[str, Any]:
    """A scene's inputs by name, and more of them. Raises ValueError where there are no names, or a name comes twice."""
    if not isinstance(inputs, dict):
        raise ValueError(f"inputs of type {type(inputs).__name__} was given; a dictionary of values by name is wanted")
    for name in more:
        if name in inputs:
            raise ValueError(f"the input {name!r} was given twice; once is wanted")
    return {**inputs, **more}
