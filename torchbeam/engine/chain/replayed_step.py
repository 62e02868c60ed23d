"""Replayed step: native steps of a scene whose structure is known, by a tape of how constants of
another scene of it were made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from ...core.leaves import leaves, map_leaves
from ...core.tape import Recording
from ...nodal.discretise import discretise
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...scene.scene import Scene
from .compiled_step import CompiledStep

FORMS = 8  # tapes of a structure that are kept: of how many steps, and with what, they are called
# of steps, what their structure decides
SHARED = (
    "structure", "batch", "none", "all", "around", "function", "options", "_functions", "_own",
)  # fmt: skip
MISSES = 3  # scenes that decide otherwise than the one before, from which on there are no tapes


def keeps_structure(step: Any) -> bool:
    """Whether steps have a structure that those of other numbers find again."""
    return type(step) is CompiledStep and step.key is not None


class Tapes:
    """Of the constants of native steps of scenes of one structure, by the shapes of what a call is
    given; known: steps of one of them.
    """

    def __init__(self, known: CompiledStep, lumped: bool) -> None:
        self.known, self.lumped = known, lumped
        self._tapes: dict[Any, tuple[Callable[..., Any], tuple[str, ...]] | None] = {}
        self._misses = 0

    def values(
        self, scene: Scene, given: Sequence[Tensor | None], inputs: Inputs
    ) -> tuple[list[Tensor], dict[str, Tensor]] | None:
        """Of the constant fields and of the lengths, one after the other, and by name those that
        change, see `Constants.changing`; given: dt, t and the frame's orientation. None where they
        are to be made without a tape.
        """
        tensors = [x for x in (*given, *inputs.values()) if x is not None]
        absent = tuple(x is None for x in given)
        key = absent, *inputs, *[(x.shape, x.stride(), x.dtype) for x in tensors]
        if self._misses > MISSES or (key not in self._tapes and len(self._tapes) >= FORMS):
            return None
        if key not in self._tapes:
            self._tapes[key] = self._recorded(scene, given, inputs)
            return None
        if self._tapes[key] is None:
            return None
        tape, names = self._tapes[key]
        with torch.no_grad():
            values = tape(*scene.numbers, *tensors)
        if values is None:
            self._misses += 1
            self._tapes.pop(key, None)
            return None
        constant = len(values) - len(names)
        return values[:constant], dict(zip(names, values[constant:], strict=True))

    @torch.no_grad()
    def _recorded(
        self, scene: Scene, given: Sequence[Tensor | None], inputs: Inputs
    ) -> tuple[Callable[..., Any], tuple[str, ...]] | None:
        """By numbers of its own, of which nothing is known yet."""
        own = map_leaves(lambda x, axes: x.clone() if isinstance(x, Tensor) else x, scene)
        numbers = [leaf.value for leaf in leaves(own) if isinstance(leaf.value, Tensor)]
        given = [None if x is None else x.detach().clone() for x in given]
        inputs = {name: x.detach().clone() for name, x in inputs.items()}
        tensors = [x for x in (*given, *inputs.values()) if x is not None]
        with Recording([*numbers, *tensors]) as recording:
            step = CompiledStep(discretise(own, self.lumped), **self.known.options)
            values = step.constants.changing(given[0], given[1], inputs, given[2])
        constant = [field.value for field in (*step.constant, *step.lengths)]
        tape = recording.tape([*constant, *values.values()])
        return None if tape is None else (tape, tuple(values))


class ReplayedStep(CompiledStep):
    """Steps of a model whose constants are made by a tape at the first call. It becomes a plain
    `CompiledStep` where it is called for other times or inputs, and where there is no tape.
    """

    def __init__(self, model: Model, tapes: Tapes) -> None:
        vars(self).update((name, vars(tapes.known)[name]) for name in SHARED)
        self.model, self.sources, self.tapes = model, [*model.scene.numbers], tapes
        self.eager_because, self._seen, self._forms = None, None, {}
        self._known: tuple[list[Any], dict[str, Tensor]] | None = None  # of the first call

    def __getattr__(self, name: str) -> Any:
        if name not in ("constants", "constant", "lengths"):
            raise AttributeError(name)
        self._become()
        return vars(self)[name]

    def _become(self) -> None:
        vars(self).update(vars(CompiledStep(self.model, **self.options)))
        self.__class__ = CompiledStep
        self._look()

    def _look(self) -> None:
        """Numbers are those of the first call: a scene that was written to has other steps."""

    def _changing(
        self, dt: Tensor, t: Tensor, inputs: Inputs, frame: Tensor | None
    ) -> dict[str, Tensor]:
        given = [*inputs, dt, t, frame, *inputs.values()]
        if self._known is not None:
            known, values = self._known
            if len(known) == len(given) and all(map(_same, known, given)):
                return values
            self._become()
        elif (found := self.tapes.values(self.model.scene, (dt, t, frame), inputs)) is not None:
            constants, values = found
            step, count = self.tapes.known, len(self.tapes.known.constant)
            like = zip((*step.constant, *step.lengths), constants, strict=True)
            fields = [field._replace(value=x) for field, x in like]
            self.constant, self.lengths = fields[:count], fields[count:]
            self._known = [x.clone() if isinstance(x, Tensor) else x for x in given], values
            return values
        return self.constants.changing(dt, t, inputs, frame)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, Tensor) and isinstance(b, Tensor):
        return a.shape == b.shape and torch.equal(a, b)
    return a is b or a == b
