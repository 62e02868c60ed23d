"""Peg: push a flexible rod through a hole in a plate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import Obstacle, Value, leaf, shown

from .actuators import Actuator
from .config import BeamEnvConfig, is_number
from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter
from .reach import distance, rounded, travelled
from .single import SingleEnv
from .task import Task

OWN = "section", "direction", "up", "beam", "supports", "actuators", "force"
LAW = dict(thickness=1e-3, force=300.0, damping=2e-3, slip_speed=0.1, points=4)
NEAR = 0.005  # m from its target within which the tip is in
EDGE = 0.2  # radius of the plate's edges, over its thickness
AROUND = 0.5  # of the rod's length: how far a picture shows the plate


@dataclass(frozen=True, kw_only=True)
class PegConfig(BeamEnvConfig):
    """Lengths in m, young in Pa, density in kg/m^3, motor in N, carriage in kg, drag in N s/m: see
    `PegVectorEnv`; the rest as in `BeamEnvConfig`.
    """

    length: float = 0.3
    radius: float = 0.004
    young: float = 2e8
    density: float = 1200.0
    damping: float | None = 2e-3
    hole: float = 0.006
    plate: float = 0.02
    depth: float = 0.05
    height: float = 0.03
    offset: float = 0.08
    motor: float = 3.0
    carriage: float = 0.5
    drag: float = 5.0
    friction: float = 0.2
    substeps: int = 4
    randomize: bool | Mapping[str, Sequence[float]] | None = None
    max_episode_steps: int | None = 100
    params_in_info: bool | None = False

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = "radius", "young", "density", "plate", "depth", "height", "motor", "carriage"
        self.check_numbers(*positive, above=0.0)
        self.check_numbers("offset", "drag", "friction", least=0.0)
        if not self.check_hole():
            raise ValueError(
                f"hole = {shown(self.hole)} was given; a radius (m) that lets the rod and the "
                f"reach of its contact through, more than {self.radius + LAW['thickness']:g}, is "
                "wanted"
            )
        for name in OWN:
            if self.is_given(name):
                raise ValueError(f"{name} was given; Peg has its own, and none is wanted")
        if self.form != "nodal":
            raise ValueError(f"form = {shown(self.form)} was given; 'nodal' is wanted")
        if self.randomize is None:
            object.__setattr__(self, "randomize", {"friction": (0.0, 2 * self.friction)})
        if self.solver is None:  # what hits the edge of the hole wants short steps
            object.__setattr__(self, "solver", {"halvings": 5})

    def check_hole(self) -> bool:
        return is_number(self.hole) and self.hole > self.radius + LAW["thickness"]


@dataclass(frozen=True)
class PiercedPlate(Obstacle):
    """A plate without end, across z, with a round hole.

    centre    (..., 3) m, of the hole
    hole      (...) m, its radius
    plate     (...) m, how thick the plate is
    rounding  (...) m, radius of its edges, below half of that
    """

    centre: Value = leaf(1)
    hole: Value = leaf(0)
    plate: Value = leaf(0)
    rounding: Value = leaf(0)

    PLACE = "centre"

    def distance(self, x: Tensor) -> Tensor:
        q = self._beyond(x)[0]
        inside = q.amax(-1, keepdim=True).clamp(max=0)
        return _length(q.clamp(min=0)) + inside - self.rounding[..., None, None]

    def gradient(self, x: Tensor) -> Tensor:
        q, out, side = self._beyond(x)
        beyond = q.clamp(min=0)
        size = _length(beyond)
        nearest = (q >= q.amax(-1, keepdim=True)).to(q)
        n = torch.where(
            size > 0, beyond / torch.where(size > 0, size, torch.ones_like(size)), nearest
        )
        return torch.cat((-n[..., :1] * out, n[..., 1:] * side), -1)

    def _beyond(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(..., points, 2) m by which points are in the hole, and above or below the plate, both
        smaller by the rounding; (..., points, 2) unit vectors out of the hole's axis; and the side
        (..., points, 1) of the plate that points are on.
        """
        d = self._from(x)
        hole, half, c = (v[..., None, None] for v in (self.hole, self.plate / 2, self.rounding))
        across, up = d[..., :2], d[..., 2:]
        rho = (across.square().sum(-1, keepdim=True) + (1e-6 * hole) ** 2).sqrt()
        side = torch.where(up < 0, -1.0, 1.0).to(d)
        return torch.cat((hole + c - rho, side * up - (half - c)), -1), across / rho, side


def _length(v: Tensor) -> Tensor:
    """(..., 1), with a derivative of 0 where it is 0."""
    square = v.square().sum(-1, keepdim=True)
    some = square > 0
    return torch.where(
        some, torch.where(some, square, torch.ones_like(square)).sqrt(), 0.0 * square
    )


class Peg(Task):
    """Push a flexible rod through a hole: `PegVectorEnv` has the specification."""

    Config = PegConfig
    PLANE = "xz"
    HOLDS = False  # the carriage rests anywhere
    settles = False  # it hangs straight

    def __init__(self, config: PegConfig) -> None:
        super().__init__(config)
        self.goal_size = self.directions - 1
        self.aim = self.usual.nodes.new_tensor((0.0, 0.0, -config.depth))

    def beam(self) -> tb.Beam:
        c = self.config
        numbers = c.radius, c.young, 0.4, c.density, c.length, (0.0, 0.0, c.height + c.length)
        r, young, nu, rho, length, root = (torch.tensor(v, dtype=torch.float64) for v in numbers)
        section = tb.Section.circle(r, young, nu, rho)
        return tb.Beam.straight(length, c.elements, section, (0, 0, -1), (1, 0, 0), root=root)

    def supports(self) -> tuple[tb.Support, ...]:
        return (tb.Support(0, position="", rotation="xyz"),)

    def parameters(self) -> dict[str, Parameter]:
        mu = self.config.friction
        return {"friction": Parameter(mu, 0.0, 2 * mu), **super().parameters()}

    def actuators(self) -> tuple[Actuator, ...]:
        axes = torch.eye(3)[[0, 1, 2] if self.plane is None else [0, 2]]
        return (Actuator(tb.PointLoad(0, force=tb.Input("motors", 3)), self.config.motor * axes),)

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        c, like = self.config, self.usual.nodes
        sizes = c.hole - c.radius, c.plate + 2 * c.radius, EDGE * c.plate + c.radius
        centre = like.new_tensor((0.0, 0.0, -c.plate / 2))
        plate = PiercedPlate(centre, *(like.new_tensor(size) for size in sizes))
        own = (
            tb.PointMass(like.new_tensor(c.carriage), node=0),
            tb.Spring(0, 0.0, self.usual.nodes[0], damping=c.drag),
            tb.Contact(plate, friction=params["friction"], **LAW),
        )
        if self.gravity is None:
            return own
        kg = c.carriage + (self.usual.mass[..., 0, 0] * self.usual.length).sum(-1)
        return (*own, tb.PointLoad(0, force=-kg * like.new_tensor(self.gravity)))

    # Episodes

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 2) m, or (k, 1) in a plane: where rods start beside the hole."""
        far = self.config.offset * np.array([stream.uniform(0.25, 1) for stream in streams])
        angle = np.array([stream.uniform(0, 2 * np.pi) for stream in streams])
        across = np.stack((np.cos(angle), np.sin(angle)), -1)
        across = across if self.goal_size == 2 else np.sign(across[:, :1])
        return torch.as_tensor(far[:, None] * across, dtype=self.dtype, device=self.device)

    def initial_state(self, beam: tb.State, goal: Tensor) -> tb.State:
        moved = torch.nn.functional.pad(goal, (0, 3 - self.goal_size))
        return replace(beam, position=beam.position + moved[:, None])

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return self.aim.expand(len(now.steps), ahead + 1, 3)

    def carried(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 3) m and m/s: where the carriage is, from over the hole with the tip at its upper
        rim, and its velocity.
        """
        above = self.aim.new_tensor((0.0, 0.0, self.length))
        return now.beam.position[:, 0] - above, now.beam.velocity[:, 0]

    def target_high(self) -> np.ndarray:
        return np.repeat((4.0, 4.0, 20.0), self.directions)

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        at, velocity = self.carried(now)
        rates = velocity / self.of(now, self.speed)
        parts = (self.aim - now.beam.position[:, -1]) / self.length, at / self.length, rates
        return torch.cat([part[:, self.vector] for part in parts], -1)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        far = distance(now.target[:, 0], now.beam.position[:, -1])
        return {"distance": far, "inserted": far < NEAR}

    def farthest(self) -> float:
        """As far as the motors take the carriage within an episode, and a swinging rod beyond."""
        c, seconds = self.config, self.config.intervals * self.config.control_interval
        along = travelled(c.motor, c.carriage, c.drag, seconds)
        start = c.offset + c.height + c.depth
        return start + math.sqrt(self.directions) * along + 2 * self.length

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def tracking_error(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """The carriage's, over the length, and its rate."""
        at, velocity = (part[:, self.vector] for part in self.carried(now))
        return (self.aim[self.vector] - at) / self.length, velocity / self.of(now, self.speed)

    def render_data(self, now: Episodes) -> dict[str, Any]:
        c, wide = self.config, AROUND * self.length
        sides = [[(x, x, -c.plate), (y, y, 0.0)] for x, y in ((-wide, -c.hole), (c.hole, wide))]
        solid = self.aim.new_tensor(sides).expand(len(now.steps), -1, -1, -1)
        return {**super().render_data(now), "solid": solid}


class PegVectorEnv(BeamVectorEnv):
    """`num_envs` flexible rods to be pushed through holes, stepped as one batch.

    ## Description
    Push a flexible rod through a hole. A round rod of plastic (0.3 m, 8 mm thick, E = 0.2 GPa)
    hangs from a carriage. Three motors slide the carriage along x, y and z, against a drag of its
    guides; it does not turn. A balancer bears the weight of both. Below is a plate, 20 mm thick,
    with a hole of 12 mm, whose edges are rounded. The rod starts beside the hole and above the
    plate. Its tip is to come to a point in the axis of the hole, 50 mm below the plate's upper
    side, and to stay there. The plate blocks the straight way: the tip must first be over the hole,
    or slide along the plate. The rod swings (first frequency 5 Hz) and buckles under more than 4 N.
    The plate's friction is not observed.

    Contact is that of torchbeam (docs/contact.md), along all of the rod, at four points of each
    element. The last point is 3.5 mm before the tip, as if its end were round. The thickness is 1
    mm, the force 300 N/m where surfaces meet, the damping 2 ms. Friction is Coulomb's beyond a slip
    speed of 0.1 m/s, at the axis of the rod. Implicit steps of control_interval / substeps.

    ## Action space
    `Box(-1, 1, (3,), float32)`: forces on the carriage along x, y, z, motor = 3 N at 1, held over
    an interval, `delay` intervals later. Values outside are clipped; a row that is not finite
    counts as zeros.

    ## Observation space
    `Box(-high, high, (21 + 3 delay,), float32)`: lengths over the length L, rates over the first
    frequency omega of the rod as a cantilever.

    | index | observation | high |
    |---|---|---|
    | 0-2 | where the tip is to be - tip, x y z | 4 |
    | 3-5 | where the carriage is, from over the hole with the tip in the plate's upper side | 4 |
    | 6-8 | its velocity | 20 |
    | 9-20 | tip and mid-span displacement and velocity, as in TipReach (or the `sensors` given) | |
    | then 3 delay | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d the distance from the tip to its target:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000
    A failed solve costs as much as the farthest place that the motors can reach, for its interval
    and each that is left.

    ## Starting state
    Straight down and at rest, the tip 30 mm above the plate. It is a quarter of offset to offset =
    80 mm beside the axis of the hole, in any direction, from the sub-env's own generator.

    ## Episode end
    As in TipReach, after 100 steps (2 s).

    ## Information
    `distance` (m) of the tip from its target, `inserted` (within 5 mm of it), `solver_failed`,
    `action_invalid`; masks as in TipReach; with `params_in_info=True`
    `info["params"]["friction"]` is the plate's.

    ## Arguments The fields of `BeamEnvConfig` (see `envs/config.py`), without section, direction,
    up, beam, supports, actuators and force. Its defaults hold, but length = 0.3, damping = 2e-3,
    substeps = 4, max_episode_steps = 100, randomize = {"friction": (0, 0.4)}, solver = {"halvings":
    5}, and

    - `radius`, `young`, `density`: of the rod: 0.004 m, 2e8 Pa, 1200 kg/m^3
    - `hole`, `plate`: m, 0.006 (radius) and 0.02 (thickness)
    - `depth`, `height`, `offset`: m: 0.05 of the target, 0.03 and 0.08 of the start
    - `motor`: N, 3
    - `carriage`: kg, 0.5
    - `drag`: N s/m, 5
    - `friction`: 0.2, unless it varies

    "torchbeam/PegPlanar-v1" is this with planar=True: the plane x-z, in which the hole is a slot;
    two actions.

    ## Parameters
    friction (0 to twice the usual), and those of TipReach but offset. The goal, for
    options={"goal": ...}, is where the rod starts: x, y (m); in the plane x.

    ## Version history v1: a failure costs all remaining intervals; in v0 it cost 100, less than
    doing nothing. v0: first version.

    Examples:
        >>> env = envs.PegVectorEnv(2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 16), (2,))
    """

    task_type = Peg


class PegEnv(SingleEnv):
    """One flexible rod to be pushed through a hole: `PegVectorEnv` with one member, see there for
    everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.PegEnv(planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((16,), (2,))
    """

    vector = PegVectorEnv
