"""Gripper: hold a ball by fingers that tendons bend, and lift it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend import shown

from .actuators import Actuator
from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter
from .plant import first_frequency, varied
from .reach import distance, rounded, share_in_ball, travelled, uniform_numbers
from .single import SingleEnv
from .task import Task

OWN = "section", "direction", "up", "beam", "supports", "actuators", "force"
LAW = dict(thickness=1e-3, damping=2e-3, slip_speed=0.02)
PRESSED = 20.0, 5.0  # N of a finger on the ball, and of the table, at no gap
LEVER = 1.4  # of a tendon about a finger's axis, over the finger's radius
GAP = 0.004  # m between open fingers and a ball below the middle
NEAR = 0.005  # m from its target within which the ball is lifted


@dataclass(frozen=True, kw_only=True)
class GripperConfig(BeamEnvConfig):
    """Lengths in m, young in Pa, density in kg/m^3, pull and motor in N, hub and mass in kg, drag
    in N s/m: see `GripperVectorEnv`; the rest as in `BeamEnvConfig`.
    """

    length: float = 0.11
    elements: int = 4
    radius: float = 0.005
    young: float = 2e7
    density: float = 1100.0
    damping: float | None = 2e-3
    ball: float = 0.025
    mass: float = 0.05
    friction: float = 0.6
    pull: float = 10.0
    motor: float = 3.0
    hub: float = 0.3
    drag: float = 5.0
    lift: float = 0.035
    offset: float = 0.004
    delay: int = 0
    substeps: int = 8
    sensors: Any = ("tip",)
    randomize: bool | Mapping[str, Sequence[float]] | None = None
    max_episode_steps: int | None = 100
    params_in_info: bool | None = False

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = "radius", "young", "density", "ball", "mass", "pull", "motor", "hub", "lift"
        self.check_numbers(*positive, above=0.0)
        self.check_numbers("drag", "friction", least=0.0)
        self.check_numbers("offset", least=0.0, most=GAP)
        if self.length < 2.5 * self.ball:
            raise ValueError(
                f"length = {shown(self.length)} was given for a ball of {shown(self.ball)} m "
                f"radius; fingers that reach around it, at least {2.5 * self.ball:g} m, are wanted"
            )
        for name in OWN:
            if self.is_given(name):
                raise ValueError(f"{name} was given; Gripper has its own, and none is wanted")
        if self.form != "nodal":
            raise ValueError(f"form = {shown(self.form)} was given; 'nodal' is wanted")
        if self.randomize is None:
            drawn = {name: _range(getattr(self, name)) for name in ("mass", "friction")}
            renamed = {"ball": drawn["mass"], "friction": drawn["friction"]}
            object.__setattr__(self, "randomize", renamed)
        if self.solver is None:  # fingers that hold a ball on the table fast want short steps
            object.__setattr__(self, "solver", {"halvings": 5, "iterations": 60})


def _range(usual: float) -> tuple[float, float]:
    return 0.6 * usual, 1.4 * usual


@dataclass(frozen=True)
class Winch(Actuator):
    """A motor that pulls a tendon, of a finger that the scene has already."""

    def effects(self, varying: Any = ()) -> tuple[Any, ...]:
        return ()


class Gripper(Task):
    """Hold a ball by two or three fingers and lift it: `GripperVectorEnv` has the specification."""

    Config = GripperConfig
    PLANE = "xz"
    HOLDS = False  # the hub rests anywhere
    settles = False  # fingers hang straight
    straight = False

    def __init__(self, config: GripperConfig) -> None:
        super().__init__(config)
        self.length = config.length
        self.omega = first_frequency(self.usual, self.length)[..., None]
        self.speed = self.length * self.omega
        self.goal_size = self.directions - 1
        self.aim = self.usual.nodes.new_tensor((0.0, 0.0, config.ball + config.lift))

    # The structure

    @property
    def fingers(self) -> tuple[str, ...]:
        return ("left", "right") if self.config.planar else ("first", "second", "third")

    def row(self, name: str) -> int:
        """Of a part's first node."""
        return next(part.first_node for part in self.usual.parts if part.name == name)

    def tips(self) -> list[int]:
        """Rows of the nodes at the fingers' ends."""
        return [self.row(name) + self.config.elements for name in self.fingers]

    def parts(self) -> dict[str, tb.Beam | tb.Body]:
        """Hub, fingers and ball, at their usual parameters: fingers hang about the ball, whose
        lowest point they end a finger's radius above.
        """
        c = self.config
        numbers = c.radius, c.young, 0.4, c.density, c.length, c.hub, c.hub * c.radius**2, c.mass
        values = [torch.tensor(v, dtype=torch.float64) for v in numbers]
        r, young, nu, rho, length, hub, turning, mass = values
        section = tb.Section.circle(r, young, nu, rho)
        top = torch.stack((0 * r, 0 * r, length + 2 * r))
        parts: dict[str, tb.Beam | tb.Body] = {"hub": tb.Body(hub, turning, position=top)}
        for name, outward in zip(self.fingers, self.outward(), strict=True):
            root = top + (c.ball + c.radius + GAP) * outward
            up = outward.abs() if c.planar else outward  # in a plane all sections are alike
            parts[name] = tb.Beam.straight(length, c.elements, section, (0, 0, -1), up, root=root)
        centre = torch.stack((0 * r, 0 * r, 0 * r + c.ball))
        parts["ball"] = tb.Body(mass, 0.4 * mass * c.ball**2, position=centre)
        return parts

    def outward(self) -> Tensor:
        """(fingers, 3): from the hub's axis to each; in a plane two, opposite to each other."""
        angles = [math.pi, 0.0] if self.config.planar else [0.0, 2 * math.pi / 3, -2 * math.pi / 3]
        turn = torch.tensor(angles, dtype=torch.float64)
        return torch.stack((turn.cos(), turn.sin() * (not self.config.planar), 0 * turn), -1)

    def joints(self) -> list[tb.Weld]:
        return [tb.Weld("hub", (name, 0)) for name in self.fingers]

    def tendons(self) -> list[tb.Tendon]:
        """Along the inside of each finger."""
        parts, lever = self.parts(), LEVER * self.config.radius
        found = []
        for name, outward in zip(self.fingers, self.outward(), strict=True):
            inside = quat.matrix(parts[name].frames[0]).mT @ (-lever * outward)
            pull = tb.Input(f"{name} pull", 1)
            found.append(tb.Tendon.along(parts[name], inside, name, tension=pull))
        return found

    def beam(self) -> tb.Beam:
        """All rows of the structure: the fingers, the hub, and last the ball."""
        return tb.Scene(self.parts(), joints=self.joints()).beam

    def supports(self) -> tuple[tb.Support, ...]:
        return (tb.Support("hub", position="xy", rotation="xyz"),)

    def drawn_supports(self) -> list[tuple[int, bool]]:
        return []

    def scene(self, params: dict[str, Tensor], rows: Tensor, varying: set[str]) -> tb.Scene:
        parts = self.parts()
        parts |= {name: varied(parts[name], params, rows) for name in self.fingers}
        kg = params["ball"]
        J = (0.4 * kg * self.config.ball**2)[..., None, None] * torch.eye(3).to(kg)
        parts["ball"] = tb.Body(kg, J, position=parts["ball"].position)
        options = dict(joints=self.joints(), supports=self.supports(), plane=self.plane)
        return tb.Scene(parts, self.loads(params, varying), **options)

    def parameters(self) -> dict[str, Parameter]:
        c = self.config
        own = {
            "ball": Parameter(c.mass, *_range(c.mass), above=True),
            "friction": Parameter(c.friction, *_range(c.friction)),
        }
        usual = super().parameters()
        return own | {
            name: usual[name] for name in ("stiffness", "mass", "damping") if name in usual
        }

    def actuators(self) -> tuple[Actuator, ...]:
        c = self.config
        up = tb.PointLoad("hub", force=tb.Input("motor", 3))
        half = c.pull / 2  # from no tension at an action of -1 to all of it at 1
        pulls = (Winch(tendon, [[half]], bias=[half]) for tendon in self.tendons())
        return (Actuator(up, [[0.0, 0.0, c.motor]]), *pulls)

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        c, like = self.config, self.usual.nodes
        law = dict(LAW, friction=params["friction"])
        sizes = dict(radius=c.radius, other_radius=c.ball, force=PRESSED[0])
        table = tb.Plane(like.new_zeros(3), like.new_tensor((0.0, 0.0, 1.0)))
        own = (
            *self.tendons(),
            *(tb.Contact(name, "ball", **sizes, **law) for name in self.fingers),
            tb.Contact("ball", table, radius=c.ball, force=PRESSED[1], **law),
            tb.Spring("hub", 0.0, like[0], damping=c.drag),
        )
        if self.gravity is None:
            return own
        return (*own, tb.PointLoad("hub", force=-self.borne * like.new_tensor(self.gravity)))

    @property
    def borne(self) -> float:
        """kg of hub and fingers, which a balancer bears."""
        c = self.config
        return c.hub + len(self.fingers) * math.pi * c.radius**2 * c.density * c.length

    # Episodes

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 2) m, or (k, 1) in a plane: where balls lie beside the axis."""
        axes = self.goal_size
        unit = np.array([stream.uniform(size=uniform_numbers(axes)) for stream in streams])
        place = self.config.offset * share_in_ball(unit, axes)
        return torch.as_tensor(place, dtype=self.dtype, device=self.device)

    def initial_state(self, beam: tb.State, goal: Tensor) -> tb.State:
        """The ball where it lies, as deep in the table's reach as its usual weight has it."""
        c, thickness = self.config, LAW["thickness"]
        weight = 0.0 if self.gravity is None else -c.mass * self.gravity[2]
        gap = thickness * (1 - math.sqrt(min(1.0, max(0.0, weight) / PRESSED[1])))
        moved = torch.nn.functional.pad(goal, (0, 2 - self.goal_size))
        moved = torch.cat((moved, torch.full_like(moved[:, :1], gap)), -1)
        position = beam.position.expand(len(goal), -1, 3)
        place = position[:, -1:] + moved[:, None]
        return replace(beam, position=torch.cat((position[:, :-1], place), 1))

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return self.aim.expand(len(now.steps), ahead + 1, 3)

    def carried(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n,) m and m/s: by how much the hub has been lifted, and its velocity."""
        hub = self.row("hub")
        rise = now.beam.position[:, hub, 2] - self.usual.nodes[hub, 2]
        return rise, now.beam.velocity[:, hub, 2]

    def target_high(self) -> np.ndarray:
        places = np.full(self.directions * (1 + len(self.fingers)), 4.0)
        return np.concatenate((places, (4.0, 20.0)))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        ball = now.beam.position[:, -1]
        rise, rate = self.carried(now)
        ends = now.beam.position[:, self.tips()] - ball[:, None]
        places = torch.cat(((self.aim - ball)[:, None], ends), 1)[..., self.vector]
        hub = torch.stack((rise / self.length, rate / self.of(now, self.speed)[..., 0]), -1)
        return torch.cat((places.flatten(1) / self.length, hub), -1)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        far = distance(now.target[:, 0], now.beam.position[:, -1])
        return {"distance": far, "lifted": far < NEAR}

    def farthest(self) -> float:
        """As far as the motor takes the hub within an episode, and a hand with its ball beyond."""
        c, seconds = self.config, self.config.intervals * self.config.control_interval
        return travelled(c.motor, c.hub, c.drag, seconds) + c.lift + 2 * self.length

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def tracking_error(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """Of the height of the ball, over the length, and the rate of the hub."""
        rate = self.carried(now)[1][:, None]
        gap = (self.aim - now.beam.position[:, -1])[:, 2:]
        return gap / self.length, rate / self.of(now, self.speed)

    def drawn_curves(self) -> list[slice]:
        """Of the nodes' rows those of each finger."""
        return [slice(end - self.config.elements, end + 1) for end in self.tips()]

    def render_data(self, now: Episodes) -> dict[str, Any]:
        c, wide, n = self.config, self.length, len(now.steps)
        table = self.aim.new_tensor([[(-wide, -wide, -wide), (wide, wide, 0.0)]])
        roots = [curve.start for curve in self.drawn_curves()]
        place = now.beam.position
        middle = place[:, self.row("hub")][:, None].expand(-1, len(roots), -1)
        hub = torch.stack((place[:, roots], middle), 2)
        ball = torch.cat((place[:, -1:], torch.full_like(place[:, -1:, :1], c.ball)), -1)
        shown = {"solid": table.expand(n, -1, -1, -1), "bars": hub, "balls": ball}
        return {**super().render_data(now), **shown}


class GripperVectorEnv(BeamVectorEnv):
    """`num_envs` hands that are to lift a ball, stepped as one batch.

    ## Description
    Hold a ball by soft fingers, lift it by 35 mm, and keep it there. Three round fingers of rubber
    (0.11 m long, 10 mm thick, E = 20 MPa) hang from a hub, 34 mm from its axis; in a plane
    (planar=True) two. A motor moves the hub up and down, against a drag of its guide; a balancer
    bears the weight of hub and fingers. A tendon runs along the inside of each finger, 7 mm from
    its axis, to its end. A winch pulls it, and the finger bends inwards. A ball of 50 mm lies on a
    table between the fingers, up to 4 mm beside the axis. Its mass and the friction are not
    observed. The fingers close below the ball's middle. A light touch lifts a rough ball; a smooth
    one must be held from below.

    Contact is that of torchbeam (docs/contact.md), of the ball with the nearest place along each
    finger and with the table. Its force is 20 N and 5 N where surfaces meet, its thickness 1 mm,
    its damping 2 ms. Friction is Coulomb's beyond a slip speed of 0.02 m/s. A held ball creeps: at
    half of the largest friction by 6 mm/s. Implicit steps of control_interval / substeps.

    ## Action space
    `Box(-1, 1, (4,), float32)`, held over an interval. Values outside are clipped; a row that is
    not finite counts as zeros.

    | index | action | at -1 | at 1 |
    |---|---|---|---|
    | 0 | force on the hub along z | -motor = -3 N | 3 N |
    | 1-3 | tension of the tendon of each finger | 0 | pull = 10 N |

    ## Observation space
    `Box(-high, high, (20 + 4 delay,), float32)`: lengths over the length L of a finger, rates over
    the first frequency omega of one as a cantilever.

    | index | observation | high |
    |---|---|---|
    | 0-2 | where the ball's centre is to be - where it is, x y z | 4 |
    | 3-11 | ends of the fingers, from the ball's centre | 4 |
    | 12 | by how much the hub has been lifted | 4 |
    | 13 | its velocity | 20 |
    | 14-19 | displacement of the ball from the axis, velocity (or the `sensors` given) | 2, 20 |
    | then 4 delay | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d the distance from the ball's centre to its target:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000
    A failed solve costs as much as the farthest place that the motor can reach, for its interval
    and each remaining interval.

    ## Starting state At rest, fingers straight down and open. The ball lies on the table, uniformly
    in a circle of the radius `offset` = 4 mm about the axis (in a plane: on a line). The place
    comes from the sub-env's own generator.

    ## Episode end
    As in TipReach, after 100 steps (2 s).

    ## Information
    `distance` (m) of the ball from its target, `lifted` (within 5 mm of it), `solver_failed`,
    `action_invalid`; masks as in TipReach. With `params_in_info=True` `info["params"]` has the
    ball's mass (`ball`) and the friction.

    ## Arguments The fields of `BeamEnvConfig` (see `envs/config.py`), without section, direction,
    up, beam, supports, actuators and force. Its defaults hold, but length = 0.11, elements = 4 (of
    a finger), damping = 2e-3, delay = 0, substeps = 8, sensors = "tip", max_episode_steps = 100,
    randomize = {"ball": (0.03, 0.07), "friction": (0.36, 0.84)}, solver = {"halvings": 5,
    "iterations": 60}. Further arguments:

    - `radius`, `young`, `density`: of the fingers: 0.005 m, 2e7 Pa, 1100 kg/m^3
    - `ball`, `mass`: m and kg, 0.025 (radius) and 0.05
    - `friction`: 0.6, unless it varies
    - `pull`, `motor`: N, 10 and 3
    - `hub`, `drag`: kg and N s/m, 0.3 and 5
    - `lift`, `offset`: m, 0.035 and 0.004

    "torchbeam/GripperPlanar-v1" is this with planar=True: the plane x-z, two fingers, three
    actions, and 12 + 3 delay observations.

    ## Parameters
    ball (kg, 0.6 to 1.4 times the usual), friction (likewise, of fingers and table), stiffness,
    mass (of the fingers) and damping as in TipReach. The goal, for options={"goal": ...}, is where
    the ball lies: x, y (m); in the plane x.

    ## Version history
    v1: substeps = 8. In space four steps an interval, of 5 ms, are long for three fingers. In up to
        four of a hundred intervals rounding decides whether a step ends in one go or in parts, and
        rewards differ by 0.01. With eight it is none of 768. An interval's reward is up to 2.4 %
        (in the plane 0.5 %) from that of v0.
    v0: first version, substeps = 4: v1 with that argument.

    Examples:
        >>> env = envs.GripperVectorEnv(2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 12), (2,))
    """

    task_type = Gripper


class GripperEnv(SingleEnv):
    """One hand that is to lift a ball: `GripperVectorEnv` with one member, see there for
    everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.GripperEnv(planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((12,), (3,))
    """

    vector = GripperVectorEnv
