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
from ...dynamics.step_jacobian import diagonal, step_slopes
from ...dynamics.stepper import Stepper
from ...linear.linear_model import Linear
from ...math.shapes import broadcast_shapes
from ...nodal.moves import moved
from ...scene.scene import Scene
from ...state.state import State
from .instruments import Instruments
from .unknowns import Slopes, Unknowns


class Moved(NamedTuple):
    """State and readings (..., m) at an interval's end, and derivatives of z and of these."""

    state: State
    readings: Tensor
    motion_by: Slopes
    readings_by: Slopes


@dataclass(frozen=True)
class Interval:
    """steps    of the structure from one reading to the next
    model    whose coordinates are z
    scene    of the parameters' means, `stepper` its;  scene_of  what makes another, by name
    drive    (parameters, u) -> inputs, None = u itself
    """

    scene: Scene
    scene_of: Callable[[dict[str, Tensor]], Scene]
    instruments: Instruments
    stepper: Stepper
    model: Linear
    steps: int
    method: str
    drive: Callable[[dict[str, Tensor], Tensor], dict[str, Tensor]] | None = None

    @property
    def inputs(self) -> dict[str, int]:
        return self.scene.inputs

    def move(
        self,
        state: State,
        unknowns: Unknowns,
        coordinates: Tensor,
        inputs: Tensor,
        u: Tensor | None = None,
    ) -> Moved:
        """From a state, with parameters of `coordinates` (..., p) and inputs (..., inputs) held,
        and with what `drive` makes of u (..., k) on top.
        """
        model, m = self.model, self.instruments.count
        n, space = model.reads.shape[-2], self.stepper.model.space
        axes = [part.shape[:-1] for part in (coordinates, inputs, u) if part is not None]
        lead = broadcast_shapes(state.batch_shape, *axes)

        def step(begin: State, given: dict[str, Tensor]) -> tuple[State, Tensor]:
            scene, stepper, now, parameters = self.scene, copy(self.stepper), begin, {}
            if unknowns.of_model:
                parameters = unknowns.given(given["coordinates"])
                scene = instance("what scene gives", self.scene_of(parameters), Scene)
                stepper = Stepper(scene, self.stepper.dt, self.method)
            parts = given["inputs"].split(tuple(self.inputs.values()), -1)
            held = dict(zip(self.inputs, parts, strict=True))
            if self.drive is not None and u is not None:
                held |= {k: held[k] + part for k, part in self.drive(parameters, u).items()}
            for _ in range(self.steps):
                now = stepper.advance(now, held)
            duration = self.steps * stepper.dt
            return now, self.instruments.after(scene, begin, now, held, duration)

        start = space.to_reduced(state.detach().broadcast(lead))
        given = {"coordinates": coordinates, "inputs": inputs}
        end, readings, (by_z, others) = step_slopes(step, space, model, start, given, m)
        rows = Slopes(by_z, *others)
        return Moved(
            space.to_public(end), readings, rows.rows(slice(n)), rows.rows(slice(n, n + m))
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
                diagonal(y).sum(), move, allow_unused=True, materialize_grads=True
            )
        return y.detach()[0], slope.movedim(0, -2) @ self.model.slopes(start)[1]

    def changed(self, state: State, z: Tensor) -> State:
        """The state with coordinates z (..., n) more; where there is none, its own, which fails."""
        space = self.model.space
        reduced, by = space.to_reduced(state), (self.model.moves @ z[..., None])[..., 0]
        try:
            return space.to_public(self.model.charted.moved(reduced, by)).broadcast()
        except ValueError:
            if z.ndim == 1:
                return replace(state, status=torch.full_like(state.status, DIVERGED))
        return State.stack([self.changed(state[k], z[k]) for k in range(len(z))])
