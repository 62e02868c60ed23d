"""Scene: a beam, how it is held, how its frame moves, and the effects that act on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from .beam import Beam
from .checks import Value, as_tensor, axis_last, broadcast, finite
from .effects import Damping, Effect, Input, Inputs


@dataclass(frozen=True)
class Frame:
    """Prescribed motion of frame a, in its own axes: values (..., 3) or functions t -> (..., 3).

    velocity          v of the origin, m/s
    angular_velocity  omega, rad/s
    """

    velocity: Value | Callable[[Tensor], Tensor] | None = None
    angular_velocity: Value | Callable[[Tensor], Tensor] | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "angular_velocity"):
            _motion(self, name)


@dataclass(frozen=True)
class RootMotion:
    """Motion of the clamp in frame a: functions t -> (..., 3).

    displacement  of node 0 from its place in the beam, m
    rotation      of node 0 from its axes in the beam: a rotation vector, rad, frame a
    """

    displacement: Callable[[Tensor], Tensor] | None = None
    rotation: Callable[[Tensor], Tensor] | None = None

    def __post_init__(self) -> None:
        for name in ("displacement", "rotation"):
            _motion(self, name)


def _motion(owner: Any, name: str) -> None:
    value = getattr(owner, name)
    if value is not None and not callable(value):
        value = torch.as_tensor(value, dtype=None if isinstance(value, Tensor) else torch.get_default_dtype())
        object.__setattr__(owner, name, finite(name, axis_last(name, value, 3)))


@dataclass(frozen=True)
class Scene:
    """What is simulated; only what is named exists.

    beam     `Beam`, clamped at node 0
    effects  loads and damping, see `torchbeam.effects`
    frame    `Frame`, None = frame a is inertial
    root     `RootMotion`, None = node 0 stays where the beam has it

    Sorted once, here: `loads` (effects with the load hook), `damping` (one `Damping` or None), `inputs` (name -> size).

    Raises ValueError for an object without a hook, two dampings, a node that does not exist, a load whose dtype is not
    the beam's, or two inputs of one name with different sizes.
    """

    beam: Beam
    effects: Iterable[Effect] = ()
    frame: Frame | None = None
    root: RootMotion | None = None
    loads: tuple[Effect, ...] = field(init=False)
    damping: Damping | None = field(init=False)
    inputs: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.beam, Beam):
            raise ValueError(f"a beam of type {type(self.beam).__name__} was given; a torchbeam.Beam is wanted")
        effects = tuple(self.effects) if isinstance(self.effects, Iterable) else (self.effects,)
        for effect in effects:
            if isinstance(effect, type) or getattr(effect, "hook", None) not in ("load", "strain"):
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
        set_(self, "loads", tuple(e for e in effects if e.hook == "load"))
        set_(self, "damping", damping[0] if damping else None)
        set_(self, "inputs", inputs)
        _ = self.batch_shape  # says so where the axes do not fit

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
        loads = [v.shape[:-1] for e in self.loads for v in e.values if hasattr(v, "shape")]
        taus = [] if self.damping is None else [self.damping.tau.shape[:-1] if self.damping.six else self.damping.tau.shape]
        return broadcast("a beam and loads", self.beam.batch_shape, *loads, *taus)

    def tensors(self, given: dict[str, Any]) -> Inputs:
        """Inputs by name as tensors; ValueError where one is missing, unknown or of the wrong size."""
        for name in given:
            if name not in self.inputs:
                raise ValueError(f"the input {name!r} was given; the scene has {', '.join(self.inputs) or 'none'}")
        for name in self.inputs:
            if name not in given:
                raise ValueError(f"the input {name!r} is missing; the scene wants {', '.join(self.inputs)}")
        return {name: axis_last(f"input {name!r}", as_tensor(value, self.dtype, self.device), self.inputs[name])
                for name, value in given.items()}
