"""Task: beam, actuators, goals, observations, rewards and ends of episodes. Derive from it:
docs/own_environment.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import map_leaves
from torchbeam.extend import quaternions as quat

from .actuators import Actuator, TipForce, driven
from .config import BeamEnvConfig
from .episodes import Episodes
from .parameters import Parameter
from .plant import Plant, first_frequency, section_named, softest, straight, varied
from .reach import Reach, rounded_square
from .sensors import PLANES, Observed, check_names, observed_parts

SOFT_CLAMP = 1e-3  # where `clamp` is given for some sub-envs: that of the others
STIFF = 1e4  # an elastic clamp against displacement, over its turning, in lengths
ALIGNED = 1e-6  # sine of the angle within which an axis counts as lying in a plane


class Task:
    """A beam and its goal: supports, actuators, starts, observation and cost.

    A task knows nothing of Gymnasium, random streams or pictures; `BeamVectorEnv` combines it with
    these. It is made of its configuration alone and keeps no episodes; `now` is an `Episodes`, n
    its sub-envs.

    A task defines these, or leaves them as they are here:

    - `Config`: dataclass of its keywords, derived from `BeamEnvConfig`
    - `GOAL`, `PREVIEW`: numbers in a goal; intervals by which the target is known ahead
    - `parameters()`: name -> `Parameter`, parameters that may change with the episode
    - `beam()`, `supports()`: by default those of the configuration
    - `actuators()`: driven by the actions; their number is the size of the action space
    - `effects(params)`: loads of the scene, beside damping, gravity and the actuators
    - `prepare(plant)`: called once, with the plant of the usual parameters
    - `sample_goal(streams, rows)`: (k, GOAL) of new episodes of the sub-envs rows (k,), each from
      its own generator
    - `initial_state(beam, goal)`: the state that episodes start in, of the beam at rest
    - `initial_memory(goal)`: (k, m) at the start, kept from interval to interval beside the beam
    - `next_memory(now, action)`: (n, m), an interval later
    - `RANDOM`: whether that draws random numbers: `noise.uniform` of `now.key`
    - `inputs(action, now)`: of the scene over an interval, or a list of them, one a substep
    - `idle_inputs()`: of the scene at rest without action, those that are not zero
    - `target(now, ahead)`: (n, ahead + 1, 3) m, the tip's target now and at the ends of the next
      intervals; None
    - `target_high()`: bounds of `target_observation`
    - `target_observation(now, tip)`: observation beside the sensors, (n, its size); tip: its
      displacement as it is observed
    - `cost(now)`: (n,), of an interval, at its end
    - `farthest()`: m; or `worst_cost()`: the largest cost of an interval. Either gives the cost of
      a failure
    - `task_failed(now)`: (n,) bool, or None: whether the task is lost; it costs as much as a failed
      solve
    - `measures(now)`: entries of `info`, name -> (n,)
    - `tracking_error(now)`: error for proportional and derivative feedback
    - `render_data(now)`: further content of a picture: see `envs/rendering.py`
    - `MESHED`: whether actions are the same inputs of the scene on every mesh, so that an accuracy
      can determine its elements

    Attributes:
        config, dtype, device: as given
        plane: "xy", "xz" or None
        vector: the components of a vector that change in it
        usual: the `torchbeam.Beam` at its usual parameters, of elements and length (m)
        axes: of the tip section, those across it along which it moves: 1 for y, 2 for z
        lateral: unit vectors along them at rest (1 or 2, 3), frame a
        omega, speed: rad/s, and length * omega (m/s), by which rates are scaled: (1,) or (num_envs,
            1)
        drives, actions: the actuators, and how many actions they take

    Examples:
        >>> class Still(envs.Task):
        ...     def cost(self, now):  # m, of the tip
        ...         return (now.beam.position[:, -1] - now.start.position[:, -1]).norm(dim=-1)
        >>> now = envs.functional.reset(envs.functional.simulation(Still, 2, elements=2), seed=0)
        >>> now.observation.shape
        torch.Size([2, 14])
    """

    Config: ClassVar[type[BeamEnvConfig]] = BeamEnvConfig
    PLANE: ClassVar[str] = "xy"
    GOAL: ClassVar[int] = 0
    PREVIEW: ClassVar[int] = 0
    HOLDS: ClassVar[bool] = True  # whether a constant action holds a target
    RANDOM: ClassVar[bool] = False  # whether an episode draws random numbers after its start
    # whether all start as the usual beam rests, whatever their parameters: nothing tells them
    STARTS_ALIKE: ClassVar[bool] = False
    MESHED: ClassVar[bool] = True  # whether actions are the same inputs on every mesh
    # of a picture, in lengths: x from, to; half its height
    VIEW: ClassVar[tuple[float, float, float] | None] = None
    UNITS: ClassVar[dict[str, str]] = {"distance": "m"}  # of what is measured

    def __init__(self, config: BeamEnvConfig) -> None:
        self.config = config
        self.goal_size, self.preview = self.GOAL, self.PREVIEW
        self.plane = self.PLANE if config.planar else None
        self.dtype = config.dtype or torch.float64
        self.usual = map_leaves(
            lambda x, axes: x.to(self.dtype) if isinstance(x, Tensor) else x, self.beam()
        )
        self.device = self.usual.nodes.device
        self.elements = self.usual.station_count
        ends = self.usual.nodes[..., -1, :] - self.usual.nodes[..., 0, :]
        along = (
            torch.linalg.vector_norm(ends, dim=-1) if self.straight else self.usual.length.sum(-1)
        )
        self.length = along.detach().max().item()
        self.omega = first_frequency(self.usual, self.length)[..., None]
        self.speed = self.length * self.omega
        self.gravity = self._in_plane(config.gravity)
        self.vector = PLANES[self.plane]
        self.axes, self.lateral, self.force = self._across(config.force)
        drives = self.actuators() if config.actuators is None else config.actuators
        self.drives = tuple(drive.to(self.usual.nodes) for drive in drives)
        self.actions = sum(drive.actions for drive in self.drives)

    # The beam

    def beam(self) -> tb.Beam:
        """At the usual parameters, unloaded."""
        c = self.config
        return (
            straight(c.length, c.elements, section_named(c.section), c.direction, c.up)
            if c.beam is None
            else c.beam
        )

    def supports(self) -> Any:
        return self.config.supports

    def drawn_supports(self) -> list[tuple[int, bool]]:
        """The nodes at which a picture shows a support, and whether the beam turns there; a clamp
        at node 0 where `supports` is None.
        """
        given = self.supports()
        given = (tb.Support(0),) if given is None else given
        given = (given,) if isinstance(given, tb.Support) else given
        return [(support.node, support.rotation != "xyz") for support in given]

    def drawn_curves(self) -> list[slice]:
        """Rows of the nodes that a picture joins to a curve each."""
        return [slice(None)]

    @property
    def straight(self) -> bool:
        """Whether the beam at rest is drawn as one straight line."""
        return not self.usual.curved

    def parameters(self) -> dict[str, Parameter]:
        tau, far = self.config.damping, 0.02 * self.length
        own = {
            "stiffness": Parameter(1.0, 0.8, 1.2, above=True),
            "mass": Parameter(1.0, 0.8, 1.2, above=True),
        }
        if any(isinstance(drive, TipForce) and not drive.follower for drive in self.drives):
            own["offset"] = Parameter(0.0, -far, far, least=-math.inf)
        if tau is not None:
            own["damping"] = Parameter(tau, tau / 2, 2 * tau)
        # in the scene where they vary; not drawn by randomize=True
        own["tip_mass"] = Parameter(0.0, 0.0, 0.0)
        if self.supports() is None:
            own["clamp"] = Parameter(SOFT_CLAMP, SOFT_CLAMP, SOFT_CLAMP, above=True)
        return own

    def actuators(self) -> tuple[Actuator, ...]:
        return (TipForce(gain=self.force[:, None] * self.lateral),)

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        return ()

    def scene(self, params: dict[str, Tensor], rows: Tensor, varying: set[str]) -> tb.Scene:
        """Scene of the sub-envs rows (k,), with parameters () or (k,); `varying`: names of those
        that change.
        """
        return tb.Scene(
            varied(self.usual, params, rows),
            self.loads(params, varying),
            plane=self.plane,
            supports=self.supports(),
        )

    def usual_scene(self) -> tb.Scene:
        """Of one sub-env with the usual parameters."""
        params = {
            name: torch.tensor(p.value, dtype=self.dtype, device=self.device)
            for name, p in self.parameters().items()
        }
        return self.scene(params, torch.arange(1, device=self.device), set()).to(self.dtype)

    def loads(self, params: dict[str, Tensor], varying: set[str]) -> list[Any]:
        """All effects of the scene, with parameters as in `scene`."""
        effects = [effect for drive in self.drives for effect in drive.effects(varying)]
        effects += self.effects(params)
        effects += [tb.PointMass(params["tip_mass"])] if "tip_mass" in varying else []
        effects += [self._clamp(params["clamp"])] if "clamp" in varying else []
        effects += [tb.Damping(params["damping"], six=False)] if "damping" in params else []
        return effects + ([] if self.gravity is None else [tb.Gravity(self.gravity)])

    def _clamp(self, clamp: Tensor) -> tb.RootSpring:
        """An elastic one, that turns by `clamp` (...) under the moment that bends the whole beam by
        1 rad; it hardly gives way otherwise.
        """
        turn = 1 / (clamp * self.length * softest(self.usual).detach().max())[..., None]
        return tb.RootSpring((STIFF * turn / self.length**2, turn))

    def prepare(self, plant: Plant) -> None:
        pass

    @property
    def settles(self) -> bool:
        """Whether episodes start in the equilibrium without action; else undeformed, which is the
        same without loads.
        """
        return self.config.form == "nodal" and self.gravity is not None

    # Actions

    def inputs(
        self, action: Tensor, now: Episodes | None = None
    ) -> dict[str, Tensor] | list[dict[str, Tensor]]:
        """Inputs of the scene over a control interval: name -> (..., size), from actions (..., a)
        within [-1, 1]. Or a list with the inputs of each substep. `now` is the episodes' present,
        None in statics.
        """
        return driven(self.drives, action, now)

    def idle_inputs(self) -> dict[str, Tensor]:
        return {}

    def tip_force(self, now: Episodes) -> Tensor | None:
        """(n, 3) N, frame a: the tip force of the actions that act, to be drawn; None where no
        actuator is one.
        """
        parts = now.acting.split([drive.actions for drive in self.drives], -1)
        forces = [
            f
            for drive, part in zip(self.drives, parts, strict=True)
            if (f := drive.tip_force(part, now)) is not None
        ]
        return sum(forces) if forces else None

    # Episodes

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        return self.speed.new_zeros(len(rows), self.goal_size)

    def initial_state(self, beam: tb.State, goal: Tensor) -> tb.State:
        return beam

    def initial_memory(self, goal: Tensor) -> Tensor:
        return goal.new_zeros(len(goal), 0)

    def next_memory(self, now: Episodes, action: Tensor) -> Tensor:
        return now.memory

    def target(self, now: Episodes, ahead: int = 0) -> Tensor | None:
        return None

    def target_high(self) -> np.ndarray:
        return np.zeros(0)

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        return self.speed.new_zeros(len(now.steps), 0)

    def cost(self, now: Episodes) -> Tensor:
        raise NotImplementedError

    def square_cost(self, square: Tensor) -> Tensor:
        """(...) `cost` as a function of the squared distance (...) m^2 between the tip and its
        target (else its start), for planning. It is concave, and smooth at 0.
        """
        return rounded_square(square, self.length)

    def farthest(self) -> float:
        """Largest distance (m) between the tip and a target within its reach, before a failure:
        twice the length of a beam with one end held.
        """
        return 2 * self.length

    def worst_cost(self) -> float:
        """Largest `cost` before the episode fails: the cost of the distance `farthest`."""
        return self.square_cost(self.omega.new_tensor(self.farthest() ** 2)).item()

    def task_failed(self, now: Episodes) -> Tensor | None:
        return None

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {}

    # For baselines and pictures

    def tracking_error(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(error, rate), both (n, k): the error that the first k actions reduce to zero, and its
        rate. Here the error is the gap across the beam from the tip to the target (else to its
        start), over the length. The rate is the velocity of the tip less that of the target, over
        `speed`.
        """
        target = self.target(now, 1)
        target = now.start.position[:, -1:].expand(-1, 2, -1) if target is None else target
        gap = (target[:, 0] - now.beam.position[:, -1]) @ self.lateral.T / self.length
        moving = (target[:, 1] - target[:, 0]) / self.config.control_interval
        return gap, (now.beam.velocity[:, -1] - moving) @ self.lateral.T / self.of(now, self.speed)

    def resting(self, now: Episodes) -> tb.State | None:
        """State (n,) that would follow the targets without bending, by turns of hinges; None
        without.
        """
        return None

    def render_data(self, now: Episodes) -> dict[str, Any]:
        return {} if now.target is None else {"target": now.target[:, 0]}

    # Helpers of tasks

    def of(self, now: Episodes, value: Tensor) -> Tensor:
        """Rows of a constant (num_envs, c) that belong to these episodes; one of shape (c,) is
        everybody's.
        """
        return value[now.member] if value.ndim > 1 else value

    def gap(self, now: Episodes, target: Tensor, tip: Tensor | None) -> Tensor:
        """(n, d): from the tip, or where no sensor sees it from its start, to the target (n, 3) m,
        over the length.
        """
        far = ((target - now.start.position[:, -1]) / self.length)[:, self.vector]
        return far if tip is None else far - tip

    def within_reach(
        self, plant: Plant, share: float = 1.0, read: Callable[[tb.State], Tensor] | None = None
    ) -> Reach:
        """Static tip positions under constant actions up to a share of their range (or values of
        `read` there).
        """
        weaker = [drive.scaled(share) for drive in self.drives]
        return Reach.of(plant.scene, self.actions, lambda action: driven(weaker, action), read)

    def observed(self) -> list[tuple[Observed, str]]:
        """The sensors of the configuration, with their kinds."""
        names = check_names(self.config.sensors, self.config.form)
        return observed_parts(names, self.usual, self.plane, self.length, self.omega)

    @property
    def directions(self) -> int:
        """Components of a vector that change: 3, or 2 in a plane."""
        return 3 if self.plane is None else 2

    def _in_plane(self, vector: Any) -> tuple[float, ...] | None:
        """(3,) without its component across the plane; None where nothing is left."""
        if vector is None or self.plane is None:
            return None if vector is None else tuple(vector)
        in_plane = tuple(
            v if axis in self.plane else 0.0 for axis, v in zip("xyz", vector, strict=True)
        )
        return in_plane if any(in_plane) else None

    def _across(self, force: Any) -> tuple[list[int], Tensor, Tensor]:
        """Axes of the tip section across the beam that lie in the motion, 1 for y and 2 for z; unit
        vectors (k, 3) along them at rest; and the force (k,) N.
        """
        frame = quat.matrix(
            self.usual.frames.reshape(-1, *self.usual.frames.shape[-2:])[0, -1].detach()
        )
        normal = (
            None
            if self.plane is None
            else ({0, 1, 2} - {"xyz".index(axis) for axis in self.plane}).pop()
        )
        axes_across = [i for i in (1, 2) if normal is None or abs(frame[normal, i]) < ALIGNED]
        if normal is not None and len(axes_across) != 1:
            raise ValueError(
                f"planar = True was given, by which {type(self).__name__} moves in the plane "
                f"{self.plane!r}, for a beam whose tip section has not one axis there; a beam in "
                "that plane, PLANE = 'xz' or 'xy' in the task's class, or planar = False is wanted"
            )
        if len(force) == 2:
            force = [force[i - 1] for i in axes_across]
        if len(force) != len(axes_across):
            raise ValueError(
                f"force = {tuple(force)} was given; two positive finite numbers (N, along y and "
                "z) are wanted"
            )
        return (
            axes_across,
            frame[:, axes_across].mT.contiguous(),
            torch.tensor(force, dtype=self.dtype, device=self.device),
        )
