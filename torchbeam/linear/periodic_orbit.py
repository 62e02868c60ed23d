"""Periodic orbits of a rotor whose loads change with its azimuth, as gravity across the axis does,
and small motions about these.

The rotor is led by its bearing. The map of a state over a turn, by midpoint steps in frame a, has
the orbit as its fixed point: Newton's method finds it (shooting). Central differences over the same
steps, all as one batch, give the derivative of the map, whose eigenvalues tell Floquet's exponents,
and what becomes of small motions on the way.

Coordinates of a state are moves from the shape as drawn, in which equal blades are alike, see
`Chart`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import with_values
from ..core.validation import concrete
from ..dynamics.stepper import Stepper
from ..math.block_matrices import block_diagonal, with_identity
from ..nodal.moves import move_between, moved, remembered_count
from ..scene.effects import Inputs
from ..state.state import State, rest
from .bearing import Bearing
from .chart import Chart
from .chart_slopes import slopes
from .multiblade import SpinningModel
from .periodic import Exponents, of_turn

CHANGE = 1e-4  # m, rad and (times the speed) their rates, by which differences are taken
SAME = 1e-9  # likewise: a turn after which the state is the same
TURNS = 20  # of Newton's method
TOLERANCE = 1e-12  # of the steps


class Turn(NamedTuple):
    """Over a turn: the change of coordinates (..., m), the derivative of those after it (..., m,
    m), moves at the steps by coordinates at its start (steps, ..., moves, m).
    """

    change: Tensor
    by_start: Tensor
    moves: Tensor


@dataclass(frozen=True)
class Shooting:
    """Turns of a rotor at a speed (0-dim) rad/s by steps, under inputs."""

    bearing: Bearing
    spinning: SpinningModel
    chart: Chart
    stepper: Stepper
    speed: Tensor
    steps: int
    inputs: Inputs
    states: int

    @classmethod
    def of(
        cls, bearing: Bearing, spinning: SpinningModel, start: State, steps: int, inputs: Inputs
    ) -> Shooting:
        """From near the steady spin `start` at one speed; spinning: small motions as drawn."""
        scene, speed = bearing.model.scene, spinning.speed.flatten()[0]
        t, joints = start.t.flatten()[0], list(scene.joints)
        led = with_values(joints[bearing.joint], angle=lambda now: speed * (now - t))
        joints[bearing.joint] = led
        period = 2 * math.pi / speed.item()
        moves = spinning.mechanical.moves
        stepper = Stepper(replace(scene, joints=joints), period / steps, tolerance=TOLERANCE)
        chart = Chart.of(bearing.model, rest(scene).broadcast(start.batch_shape), moves)
        states = remembered_count(start)
        return cls(bearing, spinning, chart, stepper, speed, steps, inputs, states)

    @property
    def writes(self) -> Tensor:
        """(..., moves, m) by coordinates."""
        return self._of_moves(self.spinning.mechanical.moves)

    @property
    def reads(self) -> Tensor:
        """(..., m, moves)"""
        return self._of_moves(torch.linalg.pinv(self.spinning.mechanical.moves))

    def _of_moves(self, X: Tensor) -> Tensor:
        return with_identity(block_diagonal(X, X), self.states)

    @property
    def sizes(self) -> Tensor:
        """(m,) of coordinates: 1 of moves and internal states, the speed of rates."""
        n = self.spinning.mechanical.M.shape[-1]
        one = self.speed.new_ones
        return torch.cat((one(n), self.speed * one(n), one(self.states)))

    def moved(self, state: State, z: Tensor) -> State:
        """A public state moved by coordinates z (..., m)."""
        space = self.bearing.model.space
        reduced = space.to_reduced(state)
        by = (self.writes @ z[..., None])[..., 0]
        return space.to_public(self.chart.moved(reduced.broadcast(by.shape[:-1]), by)).broadcast()

    def turn(self, state: State) -> Turn:
        """From a public state (...)."""
        space, start = self.bearing.model.space, self.bearing.model.space.to_reduced(state)
        twice, m = 2 * CHANGE * self.sizes, len(self.sizes)
        _, moves = slopes(self.chart, start)
        up = (moves @ self.writes * twice / 2).movedim(-1, 0)
        now = moved(space, start, torch.cat((up, -up, torch.zeros_like(up[:1]))))
        now, on_the_way = space.to_public(now).broadcast(), []
        for k in range(self.steps + 1):
            up, down = (space.to_reduced(x) for x in (now[:m], now[m : 2 * m]))
            on_the_way.append(move_between(space, down, up).movedim(0, -1) / twice)
            now = now if k == self.steps else self.stepper.advance(now, self.inputs)
        end = space.to_reduced(now[-1])
        change = self.chart.coordinates(end) - self.chart.coordinates(start)
        by_moves, _ = slopes(self.chart, end)
        by_start = self.reads @ by_moves @ on_the_way.pop()
        if concrete(now.status != 0).any():
            by_start = by_start * torch.nan
        return Turn((self.reads @ change[..., None])[..., 0], by_start, torch.stack(on_the_way))

    def orbit(self, state: State) -> Turn:
        """The turn that ends as it begins, by Newton's method from a public state. Raises
        RuntimeError where it is not found.
        """
        for _ in range(TURNS):
            turn = self.turn(state)
            eye = torch.eye(turn.by_start.shape[-1], dtype=turn.by_start.dtype)
            if bool(concrete((turn.change / self.sizes).abs() <= SAME).all()):
                return turn
            if not bool(concrete(torch.isfinite(turn.by_start)).all()):
                break
            state = self.moved(
                state, torch.linalg.solve(eye - turn.by_start, turn.change[..., None])[..., 0]
            )
        raise RuntimeError(
            f"no periodic motion of the rotor was found at {self.speed.item():.4g} rad/s; loads "
            "that change less with the azimuth, or higher speeds, are wanted"
        )

    def exponents(self, turn: Turn, count: int, limit: Tensor) -> Exponents:
        """Of small motions about an orbit, as `periodic.exponents`."""
        spinning = self.spinning
        psi = torch.arange(self.steps).to(self.speed) * (2 * math.pi / self.steps)
        nodal, e = spinning.mechanical.moves_at(psi), 1e-4
        ahead, behind = (spinning.mechanical.moves_at(psi + x) for x in (e, -e))
        w, moves, back = nodal.shape[-2], turn.moves, torch.linalg.pinv(nodal)
        g = back @ moves[..., :w, :]
        turned = (ahead - behind) * self.speed / (2 * e)  # with the coordinates' axes
        rates = back @ (moves[..., w : 2 * w, :] - turned @ g)
        g = torch.cat((g, moves[..., 2 * w :, :]), -2)
        of = turn.by_start, g, rates, spinning.M, spinning.speed
        return of_turn(*of, count, limit, self.states)


def orbit_exponents(
    bearing: Bearing,
    spinning: SpinningModel,
    start: State,
    inputs: Inputs,
    steps: int,
    count: int,
    limit: Tensor,
) -> Exponents:
    """Of the orbit near the steady spin `start` at one speed."""
    with no_derivatives():
        shooting = Shooting.of(bearing, spinning, start, steps, inputs)
        return shooting.exponents(shooting.orbit(start), count, limit)
