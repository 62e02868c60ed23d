"""Interval: how a structure moves from one reading to the next, what is read at its end, and the
derivatives of both by all that is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.arguments import instance
from ...core.status import DIVERGED
from ...core.validation import as_tensor, axis_last, refusal, shown
from ...dynamics.step_jacobian import diagonal, step_slopes
from ...dynamics.stepper import Stepper
from ...linear.chart import Place
from ...linear.linear_model import Linear
from ...math.shapes import broadcast_shapes
from ...nodal.moves import moved
from ...scene.scene import Scene
from ...state.state import State
from .instruments import Instruments
from .unknowns import Slopes, Unknowns


class Standing(NamedTuple):
    """A structure of parameters of coordinates `about` (..., p): what steps it, as made of as many
    of these as a derivative has rows, (r, ..., p) with gradient.
    """

    about: Tensor
    rows: Tensor
    stepper: Stepper

    def at(self, about: Tensor, shape: Sequence[int]) -> bool:
        """Whether it stands at these, for rows of this shape."""
        return self.rows.shape == shape and (self.about is about or self.about.equal(about))


class Moved(NamedTuple):
    """State, z (..., n) and readings (..., m) at an interval's end, and derivatives of these; more
    (..., n + m): what both change by from the parameters at which the structure stands to those
    that are estimated, to first order; places: at the begin and at the end.
    """

    state: State
    z: Tensor
    readings: Tensor
    motion_by: Slopes
    readings_by: Slopes
    more: Tensor
    places: tuple[Place, Place]


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

    def side_by_side(self, u: Any) -> Tensor:
        """Inputs (..., inputs) that were given so, or by name, those that were not 0; with `drive`
        what that takes. Raises ValueError for what are none.
        """
        sizes, like = self.inputs, self.scene.beam.nodes
        if self.drive is not None:
            if u is None or isinstance(u, Mapping):
                raise refusal(f"u = {shown(u)}", "numbers (..., k) that `drive` takes")
            return as_tensor(u, like.dtype, like.device)
        if u is not None and not isinstance(u, Mapping):
            return axis_last("u", as_tensor(u, like.dtype, like.device), sum(sizes.values()))
        u = dict(u or {})
        if lost := set(u) - set(sizes):
            raise ValueError(
                f"inputs {', '.join(map(repr, sorted(lost)))} were given; the scene has "
                f"{', '.join(map(repr, sizes)) or 'none'}"
            )
        parts = [
            axis_last(name, as_tensor(u.get(name, [0.0] * size), like.dtype, like.device), size)
            for name, size in sizes.items()
        ]
        lead = broadcast_shapes(*(part.shape[:-1] for part in parts))
        parts = [part.expand(*lead, -1) for part in parts]
        return torch.cat(parts, -1) if parts else like.new_zeros(0)

    def standing(
        self, unknowns: Unknowns, about: Tensor, lead: Sequence[int], last: Standing | None
    ) -> Standing:
        """The structure of parameters about these (..., p), or the last if it is that."""
        shape = self.model.reads.shape[-2] + self.instruments.count, *lead, about.shape[-1]
        if last is not None and last.at(about, shape):
            return last
        rows = about.detach().expand(shape).clone().requires_grad_()
        with torch.enable_grad():
            scene = instance("what scene gives", self.scene_of(unknowns.given(rows)), Scene)
            return Standing(about, rows, Stepper(scene, self.stepper.dt, self.method))

    def move(
        self,
        state: State,
        unknowns: Unknowns,
        coordinates: Tensor,
        inputs: Tensor,
        u: Tensor | None = None,
        standing: Standing | None = None,
    ) -> Moved:
        """From a state, with parameters of `coordinates` (..., p) and inputs (..., inputs) held,
        and with what `drive` makes of u (..., k) on top. standing: the structure, None without
        parameters.
        """
        model, m = self.model, self.instruments.count
        n, space = model.reads.shape[-2], self.stepper.model.space
        axes = [part.shape[:-1] for part in (coordinates, inputs, u) if part is not None]
        lead = broadcast_shapes(state.batch_shape, *axes)
        whole = self.stepper if standing is None else standing.stepper

        def step(begin: State, given: dict[str, Tensor]) -> tuple[State, Tensor]:
            stepper, now = copy(whole), begin
            parts = given["inputs"].split(tuple(self.inputs.values()), -1)
            held = dict(zip(self.inputs, parts, strict=True))
            if self.drive is not None and u is not None:
                known = unknowns.given(given["coordinates"]) if unknowns.of_model else {}
                held |= {k: held[k] + part for k, part in self.driven(known, u).items()}
            for _ in range(self.steps):
                now = stepper.advance(now, held)
            duration = self.steps * stepper.dt
            return now, self.instruments.after(stepper.scene, begin, now, held, duration)

        start = space.to_reduced(state.detach().broadcast(lead))
        given = {"coordinates": coordinates, "inputs": inputs}
        rows = () if standing is None else (standing.rows,)
        end, readings, (by_z, others, places) = step_slopes(
            step, space, model, start, given, m, rows
        )
        by_parameters, by_inputs, *by_standing = others
        more = readings.new_zeros(n + m)
        for by in by_standing:
            more = (by @ (coordinates - standing.about)[..., None])[..., 0]
            by_parameters = by_parameters + by
        by = Slopes(by_z, by_parameters, by_inputs)
        motion, read = by.rows(slice(n)), by.rows(slice(n, n + m))
        z = (model.reads @ model.charted.coordinates(end, places[1])[..., None])[..., 0]
        return Moved(space.to_public(end), z, readings, motion, read, more, places)

    def driven(self, parameters: dict[str, Tensor], u: Tensor) -> dict[str, Tensor]:
        """Inputs by name, of u (..., k). Raises ValueError for a u that `drive` does not take, and
        for what are no inputs of the scene.
        """
        try:
            inputs = self.drive(parameters, u)
        except (IndexError, RuntimeError, ValueError) as error:
            given = f"u of shape {tuple(u.shape)}"
            raise refusal(
                given, f"numbers (..., k) that `drive` takes ({error})", are=True
            ) from None
        wrong = {k: v for k, v in inputs.items() if v.shape[-1:] != (self.inputs.get(k),)}
        if wrong:
            made = ", ".join(f"{k!r} of shape {tuple(v.shape)}" for k, v in wrong.items())
            wanted = ", ".join(f"{k!r} of {size} numbers" for k, size in self.inputs.items())
            raise refusal(f"u of shape {tuple(u.shape)}, of which `drive` makes {made},", wanted)
        return inputs

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

    def changed(self, state: State, z: Tensor, place: Place | None = None) -> State:
        """The state with coordinates z (..., n) more; where there is none, its own, which fails.
        place: of the state, None = not known.
        """
        space = self.model.space
        reduced, by = space.to_reduced(state), (self.model.moves @ z[..., None])[..., 0]
        try:
            return space.to_public(self.model.charted.moved(reduced, by, place)).broadcast()
        except ValueError:
            if z.ndim == 1:
                return replace(state, status=torch.full_like(state.status, DIVERGED))
        return State.stack([self.changed(state[k], z[k]) for k in range(len(z))])
