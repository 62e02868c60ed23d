"""Rows: the same problem for some samples of a batch, so that the others stop costing."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .beam import Beam
from .checks import concrete
from .effects import (
    Actuation,
    Along,
    Drag,
    Gravity,
    Input,
    LineLoad,
    MassDamping,
    PerElement,
    PointLoad,
    RootSpring,
    Spring,
    TipLoad,
)
from .nodal.alpha import Alpha, AlphaState
from .nodal.inertia import Inertia
from .nodal.model import Model
from .nodal.plane import Plane
from .nodal.small import Small
from .nodal.space import Space
from .nodal.step import Step
from .nodal.still import Still
from .scene import Scene
from .state import OWN_AXES, State
from .supports import Frame, RootMotion, Support

LEAST = 64  # samples in a batch from which on a smaller one is faster (measured: even at 32, N = 8, one core)
SHARE = 0.8  # of them: where more are left, nobody is left out

PART = None  # a field that has fields of its own
FORCES = dict(force=1, moment=1)
STEP = dict(model=PART, start=PART, dt=0, inputs=1,  # and what is cached, where it is
            strain=2, own_strain=2, R=3, C=3, _dead=2)
STATE = {name: OWN_AXES.get(name, 2) for name in State.__dataclass_fields__}

# What may have batch axes, with the number of its own axes, which come last. An effect or a problem that is not here keeps its
# batch whole: what a function of the motion knows (`Load`) is not told. Effects beside loads are in the model's numbers.
FIELDS: dict[type, dict[str, int | None]] = {
    Step: STEP, Alpha: STEP, Still: dict(model=PART, inputs=1, share=0),
    State: STATE, AlphaState: {**STATE, "acceleration": 2, "straining": 2},
    Model: dict(scene=PART, space=PART, inertia=PART, length=2, reference=2, S=3, C=3, rate=3, section_mass=3, share=2),
    Inertia: dict(space=PART, mass=2, coupling=2, inertia=3, offset=2),
    Space: {}, Plane: {}, Small: dict(nodes=2, frames=2, R=3, B=3),
    Scene: dict(beam=PART, frame=PART, root=PART, supports=PART, loads=PART, eigenstrains=PART),
    Beam: dict(nodes=2, frames=2, elements=2, length=1, compliance=3, mass=3),
    Frame: dict(velocity=1, angular_velocity=1), RootMotion: dict(displacement=1, rotation=1),
    Support: dict(displacement=1, turn=1),
    PointLoad: FORCES, TipLoad: FORCES, LineLoad: FORCES, Gravity: dict(g=1), Actuation: dict(curvature=1, strain=1),
    Spring: dict(stiffness=0, to=1, length=0, damping=0), RootSpring: dict(stiffness=1, damping=1), MassDamping: dict(alpha=0),
    Drag: dict(density=0, diameter=0, normal=0, tangential=0, flow=1, added_mass=0),
}


class Whole(Exception):
    """The batch cannot be told apart."""


@dataclass(frozen=True)
class Rows:
    """Samples `index` (n,) of a batch with the one axis (count,)."""

    index: Tensor
    count: int
    made: dict[int, Any] = field(default_factory=dict)  # by id: what a tree holds twice is made once

    @classmethod
    def few(cls, going: Tensor) -> Rows | None:
        """Those that are `going` (...), where a batch of them alone is faster; else None."""
        if going.ndim != 1 or len(going) < LEAST or going is not concrete(going):
            return None
        if not 0 < int(going.sum()) <= SHARE * len(going):
            return None
        return cls(going.nonzero()[:, 0], len(going))

    def of(self, x: Any, own: int | None = PART) -> Any:
        """x for these samples: a tensor with `own` axes behind the batch's, or whatever `FIELDS` knows. What has no batch axis,
        or one of size 1, stays; a function's values are taken. Differentiable. Raises `Whole` where x is not known.
        """
        if x is None or isinstance(x, (Input, float)):
            return x
        if isinstance(x, dict):
            return {name: self.of(value, own) for name, value in x.items()}
        if isinstance(x, tuple):
            parts = [self.of(value, own) for value in x]
            return type(x)(*parts) if hasattr(x, "_fields") else tuple(parts)
        if isinstance(x, PerElement):
            return self._with(x, value=self.of(x.value, 2))
        if isinstance(x, Along):
            raise Whole
        if own is not None:
            return self._function(x, own) if callable(x) and not isinstance(x, Tensor) else self._value(x, own)
        if id(x) not in self.made:
            if type(x) not in FIELDS or (isinstance(x, Drag) and callable(x.flow)):
                raise Whole
            there = vars(x)
            self.made[id(x)] = self._with(x, **{name: self.of(there[name], n) for name, n in FIELDS[type(x)].items()
                                                if name in there})
        return self.made[id(x)]

    def put(self, x: Any, some: Any, own: int | None = PART) -> Any:
        """x, a state or a tensor, with these samples replaced by `some`. Out of place; gradients of both survive."""
        if own is None:
            new = {name: self.put(getattr(x, name), getattr(some, name), n) for name, n in FIELDS[type(x)].items()}
            return self._with(x, **new)
        if x is None:
            return x
        tail = x.shape[x.ndim - own:]
        return x.expand(self.count, *tail).index_copy(0, self.index, some.expand(len(self.index), *tail))

    def _value(self, x: Tensor | np.ndarray, own: int) -> Tensor | np.ndarray:
        axis = x.ndim - own - 1
        if axis < 0 or x.shape[axis] != self.count:
            return x
        return x.index_select(axis, self.index) if isinstance(x, Tensor) else x.take(self.index.cpu().numpy(), axis)

    def _function(self, function: Callable[[Tensor], Any], own: int) -> Callable[[Tensor], Tensor]:
        def of_time(t: Tensor) -> Tensor:
            return self._value(torch.as_tensor(function(t), dtype=t.dtype, device=t.device), own)
        return of_time

    @staticmethod
    def _with(x: Any, **fields: Any) -> Any:
        """A copy with other fields, not checked again, without whatever else x had cached."""
        new = copy(x)
        kept = {name: v for name, v in vars(x).items() if not isinstance(getattr(type(x), name, None), cached_property)}
        vars(new).clear()
        vars(new).update(kept | fields)
        return new
