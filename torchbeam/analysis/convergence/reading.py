"""Readings: the quantity whose accuracy is asked for, of solutions on different meshes."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ...core.validation import as_tensor, shown
from ...scene.beam import Beam
from ...scene.scene import Scene
from ...sensors.sensor import Sensor
from ...state.solution import Energy, Solution
from .remesh import rows_of


@dataclass(frozen=True)
class Reader:
    """What is read of a result.

    read   a sensor, or a function of the result, or of the result and its scene
    scene  that `read` was written for: a sensor's node is a place on its beam
    size   of the quantity, that errors are relative to; None = see `errors`
    """

    read: Sensor | Callable[..., Tensor]
    scene: Scene
    size: Any = None

    def nodes(self) -> list[int]:
        """Of the scene's beam that a sensor is at: a mesh has to have nodes there."""
        return [] if self.scene.beam.parts else [*_nodes(self.read)]

    def __call__(self, result: Any, scene: Scene) -> Tensor:
        """The quantity of a result of a scene on another mesh, detached."""
        if isinstance(self.read, Sensor):
            value = on_mesh(self.read, self.scene, scene)(getattr(result, "state", result))
        elif takes_scene(self.read):
            value = self.read(result, scene)
        else:
            value = self.read(result)
        if not isinstance(value, Tensor):
            try:
                value = as_tensor(value, torch.float64)
            except (TypeError, ValueError, RuntimeError):
                raise ValueError(f"read gave {shown(value)}; a tensor is wanted") from None
        if value.is_complex() or not value.is_floating_point():
            raise ValueError(
                f"read gave a tensor of {value.dtype}; real floating numbers are wanted"
            )
        if not value.numel():
            raise ValueError(
                f"read gave a tensor of shape {tuple(value.shape)}, without a number; some are "
                "wanted"
            )
        return value.detach()

    def in_time(self, value: Tensor, result: Any, scene: Scene) -> bool:
        """Whether the first axis of what was read of a solution is its instants, and not by chance
        as long as these: it grows with one more of them, the last once more, if the function takes
        that.
        """
        count = len(result.t)
        if isinstance(self.read, Sensor) or not value.ndim or len(value) != count:
            return True
        try:
            longer = self(_with_a_last_one(result), scene)
        except Exception:  # as where what was measured at these instants is compared
            return True
        return longer.ndim > 0 and len(longer) == count + 1

    def errors(self, value: Tensor, reference: Tensor, instants: int | None) -> Tensor:
        """Relative errors (...) of the samples: RMS of the difference over the given size, or over
        the RMS by which the reference moves from its first instant; of what has no time, or does
        not move, over its own RMS.

        instants  first axis of a history behind which the batch's come; None = there are none
        """
        batch = self.scene.batch_shape
        if value.shape != reference.shape:
            raise ValueError(
                f"read gave shapes {tuple(value.shape)} and {tuple(reference.shape)} on two "
                "meshes; one that no mesh changes is wanted"
            )
        history = instants is not None and value.shape[: 1 + len(batch)] == (instants, *batch)
        if not history and value.shape[: len(batch)] != batch:
            raise ValueError(
                f"read gave a tensor of shape {tuple(value.shape)}; "
                f"({'time, ' if instants else ''}{', '.join(map(str, (*batch, '...')))}) is wanted"
            )
        axes = [k for k in range(value.ndim) if not history <= k < history + len(batch)]

        def rms(x: Tensor) -> Tensor:
            return x.square().mean(axes).sqrt() if axes else x.abs()

        size = self.size
        if size is None:
            size = rms(reference)
            if history:
                moved = rms(reference - reference[:1])
                still = torch.finfo(size.dtype).eps ** 0.5 * size  # what moves less is at rest
                size = torch.where(moved > still, moved, size)
        difference = rms(value - reference)
        error = torch.where(difference == 0, 0.0, difference / size)  # what vanishes is known
        return torch.where(error.isnan(), math.inf, error)


def _with_a_last_one(solution: Solution) -> Solution:
    """Its last instant is there twice."""
    count = len(solution.t)
    at = torch.arange(count + 1, device=solution.t.device).clamp(max=count - 1)
    return replace(
        solution,
        t=torch.cat((solution.t, 2 * solution.t[-1:] - solution.t[-2:-1])),
        states=solution.state[at],
        energies=lambda: Energy(*(x if x is None else x[at] for x in solution.energy)),
    )


def _nodes(read: Any) -> Iterator[int]:
    """Of a sensor, and of those that it is made of."""
    if isinstance(read, (tuple, list)):
        for field in read:
            yield from _nodes(field)
    elif isinstance(read, Sensor):
        for field in fields(read):
            value = getattr(read, field.name)
            if field.name == "node" and value is not None:
                yield value
            else:
                yield from _nodes(value)


def takes_scene(read: Any) -> bool:
    """Whether a function wants two arguments: the result and its scene."""
    try:
        parameters = inspect.signature(read).parameters.values()
    except (TypeError, ValueError):
        return False
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(p.kind in kinds and p.default is p.empty for p in parameters) > 1


def on_mesh(sensor: Sensor, scene: Scene, fine: Scene) -> Sensor:
    """The same sensor on another mesh: its node at the arc length of the old one, its beam or
    scene the new one's. Raises ValueError for one of an element, or that holds something else of
    the old mesh.
    """
    changed: dict[str, Any] = {}
    for field in fields(sensor):
        value = getattr(sensor, field.name)
        if not field.init or value is None:
            continue
        if field.name == "element":
            raise ValueError(
                f"{sensor.name} was given to be read on several meshes; one at a station s is "
                "wanted"
            )
        if isinstance(value, Sensor):
            changed[field.name] = on_mesh(value, scene, fine)
        elif isinstance(value, (tuple, list)) and any(isinstance(x, Sensor) for x in value):
            changed[field.name] = [on_mesh(x, scene, fine) for x in value]
        elif isinstance(value, Scene):
            changed[field.name] = fine
        elif isinstance(value, Beam):
            changed[field.name] = fine.beam
        elif field.name == "node" and not scene.beam.parts:
            changed[field.name] = rows_of(scene, fine)(value)
        elif hasattr(value, "position"):
            raise ValueError(
                f"{sensor.name} with the state {shown(value)} was given to be read on several "
                "meshes; a function of the solution and the scene is wanted"
            )
    return replace(sensor, **changed) if changed else sensor
