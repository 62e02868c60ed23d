"""Interval: how a structure moves from one reading to the next, what is read at its end, and the
derivatives of both by all that is not known.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.arguments import instance
from ...core.status import DIVERGED
from ...dynamics.stepper import Stepper
from ...linear.linear_model import Linear
from ...math.shapes import broadcast_shapes
from ...nodal.moves import move_between, moved
from ...scene.scene import Scene
from ...state.state import State
from .instruments import Instruments
from .unknowns import Slopes, Unknowns


class Moved(NamedTuple):
    """The state at the end of an interval, its readings (..., m), and the derivatives of its z and
    of the readings.
    """

    state: State
    readings: Tensor
    motion_by: Slopes
    readings_by: Slopes


@dataclass(frozen=True)
class Interval:
    """steps    of the structure from one reading to the next
    model    whose coordinates are z
    scene    of the parameters' means, `stepper` its;  scene_of  what makes another, by name
    """

    scene: Scene
    scene_of: Callable[[dict[str, Tensor]], Scene]
    instruments: Instruments
    stepper: Stepper
    model: Linear
    steps: int
    method: str

    @property
    def inputs(self) -> dict[str, int]:
        return self.scene.inputs

    def move(self, state: State, unknowns: Unknowns, coordinates: Tensor, inputs: Tensor) -> Moved:
        """From a state, with parameters of `coordinates` (..., p) and inputs (..., inputs) held.

        By reverse mode: all n + m rows as one batch of as many equal intervals.
        """
        n, m, model = self.model.reads.shape[-2], self.instruments.count, self.model
        r = n + m
        lead = broadcast_shapes(state.batch_shape, coordinates.shape[:-1], inputs.shape[:-1])
        with torch.enable_grad():
            by, held = (
                x.detach().expand(r, *lead, -1).clone().requires_grad_()
                for x in (coordinates, inputs)
            )
            scene, stepper = self.scene, copy(self.stepper)
            if unknowns.of_model:
                scene = instance("what scene gives", self.scene_of(unknowns.given(by)), Scene)
                stepper = Stepper(scene, self.stepper.dt, self.method)
            space = stepper.model.space
            start = space.to_reduced(state.detach().broadcast(lead))
            move = start.position.new_zeros(r, *lead, model.reads.shape[-1], requires_grad=True)
            begin = now = space.to_public(moved(space, start, move))
            sizes = self.inputs
            given = dict(zip(sizes, held.split(tuple(sizes.values()), -1), strict=True))
            for _ in range(self.steps):
                now = stepper.advance(now, given)
            ends = space.to_reduced(now)
            end = ends.broadcast((r, *lead))[0].detach()
            readings = self.instruments.after(scene, begin, now, given, self.steps * stepper.dt)
            with torch.no_grad():
                (_, reads), (moves, _) = (
                    slope.unbind(0) for slope in model.slopes(State.stack([start, end]))
                )
            change = move_between(space, end, ends)[:n]
            slopes = torch.autograd.grad(
                (reads.movedim(-2, 0) * change).sum() + _diagonal(readings[n:]).sum(),
                (move, by, held),
                allow_unused=True,
                materialize_grads=True,
            )
        motion, *others = (slope.movedim(0, -2) for slope in slopes)
        all_rows = Slopes(motion @ moves, *others)
        return Moved(
            space.to_public(end),
            readings.detach()[0].expand(*lead, m),
            all_rows.rows(slice(n)),
            all_rows.rows(slice(n, r)),
        )

    def slope_of(self, read: Callable[[State], Tensor], state: State) -> tuple[Tensor, Tensor]:
        """read(state) (..., r) of what follows from the motion, and by z (..., r, n)."""
        space, r = self.model.space, read(state).shape[-1]
        start = space.to_reduced(state)
        with torch.enable_grad():
            move = start.position.new_zeros(
                r, *state.batch_shape, self.model.reads.shape[-1], requires_grad=True
            )
            y = read(space.to_public(moved(space, start, move)))
            (slope,) = torch.autograd.grad(
                _diagonal(y).sum(), move, allow_unused=True, materialize_grads=True
            )
        return y.detach()[0], slope.movedim(0, -2) @ self.model.slopes(start)[1]

    def changed(self, state: State, z: Tensor) -> State:
        """The state whose coordinates are z (..., n) more; a sample of which there is none keeps
        its own, and fails.
        """
        space = self.model.space
        reduced, by = space.to_reduced(state), (self.model.moves @ z[..., None])[..., 0]
        try:
            return space.to_public(self.model.chart.moved(reduced, by)).broadcast()
        except ValueError:
            if z.ndim == 1:
                return replace(state, status=torch.full_like(state.status, DIVERGED))
        return State.stack([self.changed(state[k], z[k]) for k in range(len(z))])


def _diagonal(rows: Tensor) -> Tensor:
    """(r, ...): of rows (r, ..., r) the i-th number of the i-th."""
    return torch.stack([row[..., i] for i, row in enumerate(rows)])
