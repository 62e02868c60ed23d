"""TwoLink: let the tip of two flexible links follow a moving target by motors in their hinges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend import shown

from .actuators import Actuator
from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter, numbers
from .plant import Plant, section_named, varied
from .single import SingleEnv
from .tip_track import TipTrack, TipTrackConfig

LINKS = "upper arm", "forearm"
OWN = "direction", "up", "beam", "supports", "actuators", "force"
ANGLE, RATE = 2 * math.pi, 20.0  # bounds of the observed angles (rad) and rates (of omega)


@dataclass(frozen=True, kw_only=True)
class TwoLinkConfig(TipTrackConfig):
    """angle (rad), torque (N m), motor (kg m^2 and kg), payload (kg): see `TwoLinkVectorEnv`; the
    rest as in `TipTrackConfig`.
    """

    length: float = 1.0
    elements: int = 3
    angle: float = math.pi / 3
    torque: Sequence[float] = (1.5, 0.5)
    inertia: float = 0.02
    motor: float = 0.05
    payload: float = 0.05
    gravity: None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("angle", above=0.0, most=math.pi / 2)
        self.check_numbers("inertia", "motor", above=0.0)
        self.check_numbers("payload", least=0.0)
        torque = numbers("torque", self.torque)
        if torque.shape != (2,) or not (np.isfinite(torque) & (torque > 0)).all():
            raise ValueError(
                f"torque = {shown(self.torque)} was given; two positive finite numbers (N m, at "
                "the shoulder and at the elbow) are wanted"
            )
        for name in OWN:
            if self.is_given(name):
                raise ValueError(f"{name} was given; TwoLink has its own, and none is wanted")
        if self.gravity is not None or self.form != "nodal":
            raise ValueError(
                "gravity or another form was given; TwoLink is without gravity and in the form "
                "'nodal'"
            )


@dataclass(frozen=True)
class Motor(Actuator):
    """A motor in a joint: `effect` is that joint, which the scene has already."""

    def effects(self, varying: Any = ()) -> tuple[Any, ...]:
        return ()


class TwoLink(TipTrack):
    """Let the tip follow by two motors: `TwoLinkVectorEnv` has the specification."""

    Config = TwoLinkConfig
    HOLDS = False  # the hinges rest at any angle
    VIEW = (-0.4, 1.0, 0.8)
    straight = False  # drawn at a right angle

    @property
    def swing(self) -> float:
        """By how much targets turn either hinge at most, rad."""
        return self.config.angle * self.config.reach

    # The structure

    def links(self) -> dict[str, tb.Beam]:
        """As drawn, at a right angle, at their usual parameters."""
        c = self.config
        section = section_named(c.section)
        half = torch.tensor(c.length / 2, dtype=section.compliance.dtype)
        elbow = torch.stack((half, 0 * half, 0 * half))
        return {
            LINKS[0]: tb.Beam.straight(half, c.elements, section),
            LINKS[1]: tb.Beam.straight(half, c.elements, section, (0, 1, 0), root=elbow),
        }

    def hinges(self) -> list[tb.Hinge]:
        """Shoulder and elbow, with their motors."""
        (upper, fore), z = LINKS, (0, 0, 1)
        axis = z if self.config.planar else (1, 0, 0)
        return [
            tb.Hinge(None, (upper, 0), axis=z, torque=tb.Input("shoulder", 1)),
            tb.Hinge((upper, -1), (fore, 0), axis=axis, torque=tb.Input("elbow", 1)),
        ]

    def beam(self) -> tb.Beam:
        """All rows of the structure, those of the forearm, and its tip, the last."""
        return tb.Scene(self.links(), joints=self.hinges()).beam

    def scene(self, params: dict[str, Tensor], rows: Tensor, varying: set[str]) -> tb.Scene:
        parts = {name: varied(link, params, rows) for name, link in self.links().items()}
        loads = self.loads(params, varying)
        return tb.Scene(parts, loads, joints=self.hinges(), plane=self.plane)

    def parameters(self) -> dict[str, Parameter]:
        kg = self.config.payload
        return {"payload": Parameter(kg, 0.0, 2 * kg), **super().parameters()}

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        c, (upper, fore) = self.config, LINKS
        rotor = c.inertia * torch.eye(3, dtype=self.dtype, device=self.device)
        return (
            tb.PointMass(torch.zeros_like(rotor[0, 0]), inertia=rotor, node=(upper, 0)),
            tb.PointMass(torch.full_like(rotor[0, 0], c.motor), inertia=rotor, node=(upper, -1)),
            tb.PointMass(params["payload"], node=(fore, -1)),
        )

    def actuators(self) -> tuple[Actuator, ...]:
        torques = zip(self.hinges(), self.config.torque, strict=True)
        return tuple(Motor(hinge, [[torque]]) for hinge, torque in torques)

    def drawn_supports(self) -> list[tuple[int, bool]]:
        return [(0, True), (self.usual.node_count // 2, True)]

    # Targets

    def prepare(self, plant: Plant) -> None:
        pass  # a resting arm is straight: targets want no equilibria

    def static_tip(self, share: Tensor, rows: Tensor) -> Tensor:
        half = self.config.length / 2
        (cos, c), (sin, s) = (f(self.swing * share).unbind(-1) for f in (torch.cos, torch.sin))
        zero = torch.zeros_like(s)
        x, y, z = (-s, c, zero) if self.plane else (zero, c, s)  # of the forearm
        x = 1 + x
        return half * torch.stack((cos * x - sin * y, sin * x + cos * y, z), -1)

    # What is seen, and fed back

    def resting(self, now: Episodes) -> tb.State:
        """The arm, unbent, with its hinges where the targets want them, at their rates (n,)."""
        start, n, (angle, rate) = now.start, self.usual.node_count // 2, self.wanted(now)
        shoulder, elbow = start.position[:, :1], start.position[:, n : n + 1]
        z, axis = torch.eye(3, dtype=self.dtype, device=self.device)[[2, 2 if self.plane else 0]]
        turn = quat.exponential(angle[:, :1, None] * z)
        bend = quat.multiply(turn, quat.exponential(angle[:, 1:, None] * axis))
        spin = rate[:, :1, None] * z
        spins = spin, spin + rate[:, 1:, None] * quat.rotate(turn, axis)

        def moved(q: Tensor, w: Tensor, rows: slice, about: Tensor, to: Tensor, v: Tensor):
            arm = quat.rotate(q, start.position[:, rows] - about)
            rotation = quat.multiply(q, start.rotation[:, rows])
            body = quat.rotate(quat.conjugate(rotation), w.expand_as(arm))
            return to + arm, rotation, v + torch.linalg.cross(w, arm), body

        upper = moved(turn, spins[0], slice(n), shoulder, shoulder, 0 * shoulder)
        tip = upper[0][:, -1:], upper[2][:, -1:]
        fore = moved(bend, spins[1], slice(n, None), elbow, *tip)
        names = "position", "rotation", "velocity", "spin"
        return replace(
            start, **{k: torch.cat(pair, 1) for k, *pair in zip(names, upper, fore, strict=True)}
        )

    def wanted(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 2): the hinges' angles (rad) at the targets now, and their rates over the next
        interval (rad/s).
        """
        dt = self.config.control_interval
        t = (now.steps[:, None] + torch.arange(2, dtype=self.dtype, device=self.device)) * dt
        angle, after = (self.swing * self.share(now, t)).unbind(1)
        return angle, (after - angle) / dt

    def hinge_motion(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 2): angles (rad) of shoulder and elbow since the start, and their rates (rad/s)."""
        joints = now.beam.joint
        return tuple(
            torch.stack([getattr(j, x) for j in joints], -1) for x in ("coordinate", "rate")
        )

    def target_high(self) -> np.ndarray:
        return np.concatenate((super().target_high(), np.repeat((ANGLE, RATE), 2)))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        angle, rate = self.hinge_motion(now)
        rate = rate / self.of(now, self.omega)
        return torch.cat((super().target_observation(now, tip), angle, rate), -1)

    def tracking_error(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """The hinges': angles to go (rad) to where the resting arm would have them, and the rates
        at which they fall, over omega.
        """
        angle, rate = self.hinge_motion(now)
        wanted, wanted_rate = self.wanted(now)
        return wanted - angle, (rate - wanted_rate) / self.of(now, self.omega)


class TwoLinkVectorEnv(BeamVectorEnv):
    """`num_envs` arms of two flexible links, stepped as one batch.

    ## Description
    Follow a target along a closed path with the tip of an arm of two flexible links. Each link is
    0.5 m of aluminium flat bar, 3 mm x 10 mm. A hinge, the elbow, joins them; another, the
    shoulder, holds the first to the ground and turns about z. The elbow turns about the upper arm's
    own axis, so its motor twists the upper arm. In a plane (planar=True) it turns about z as well.
    Each hinge has a motor; its torque acts on the part beyond it, and backwards on the part before.
    Both motors have inertia, the elbow's also mass, and the tip carries a payload. No gravity: an
    arm in orbit, or, in the plane, on a level table.

    The target is the tip of the resting arm with its hinges at the angles

        q(t) = reach * angle * ramp(t) * sum_k [a_k cos(k phi) + b_k sin(k phi)],
            phi = 2 pi t / period,  k = 1, 2, 3

    with the ramp of TipTrack: it starts at the tip. Resting hinges need no torque. The links are
    geometrically exact beams (torchbeam's nodal form), and the hinges hold exactly. Steps are
    implicit, of control_interval / substeps.

    ## Action space
    `Box(-1, 1, (2,), float32)`, held over an interval, `delay` intervals later. Values outside are
    clipped; a row that is not finite counts as zeros.

    | index | action | at 1 |
    |---|---|---|
    | 0 | torque of the shoulder | torque[0] = 1.5 N m |
    | 1 | torque of the elbow | torque[1] = 0.5 N m |

    ## Observation space
    `Box(-high, high, (22 + 3 preview + 2 delay,), float32)`: lengths over the length L of both
    links together, rates over omega, the first frequency of a cantilever of that length.

    | index | observation | high |
    |---|---|---|
    | 0-2 | target - tip, x y z | 4 |
    | 3-5 | target's velocity over the next interval, over L omega | 20 |
    | 6 ... 5 + 3 preview | target less its start after 1 ... preview intervals | 2 |
    | then 2 | angles of shoulder and elbow since the start, rad | 2 pi |
    | then 2 | their rates, over omega | 20 |
    | then 12 | displacement and velocity, of the tip and of the elbow (or `sensors`) | 2, 20 |
    | then 2 delay | actions that are still to act, the next one first | 1 |

    ## Reward
    As in TipTrack: with d the distance from the tip to the target at the end of the interval and a
    the clipped action,
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000

    ## Starting state
    At rest, the upper arm along x, the forearm at a right angle to it along y. The path, of the
    two angles, is drawn as in TipTrack: an ellipse, a figure of eight or a random one.

    ## Episode end
    As in TipTrack, after 100 steps.

    ## Information
    `distance` (m) from tip to target, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments The arguments of TipTrack, without direction, up, beam, supports, actuators and
    force. Its defaults hold, but gravity = None, length = 1 (m, of both links together) and
    elements = 3 (in each). Further arguments:

    - `angle`: rad, pi / 3: `reach` (0.5) is the share of it that targets turn either hinge by at
      most
    - `torque`: N m, (1.5, 0.5): of shoulder and elbow at an action of 1
    - `inertia`: kg m^2, 0.02: of either motor
    - `motor`: kg, 0.05: the elbow's mass
    - `payload`: kg, 0.05: on the tip

    "torchbeam/TwoLinkPlanar-v1" is this with planar=True: two actions and 16 + 2 preview + 2 delay
    observations.

    ## Parameters
    payload (0 to 0.1 kg), and those of TipReach but offset. They do not move the target. The goal,
    for options={"goal": ...}, is a_1 b_1 a_2 b_2 a_3 b_3, each of shoulder and elbow: (12,).

    ## Version history v1: a failure costs all remaining intervals, see TipReach; in v0 it cost 100,
    less than doing nothing. v0: first version.

    Examples:
        >>> env = envs.TwoLinkVectorEnv(2, elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 24), (2,))
    """

    task_type = TwoLink


class TwoLinkEnv(SingleEnv):
    """One arm of two flexible links: `TwoLinkVectorEnv` with one member, see there for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.TwoLinkEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((24,), (2,))
    """

    vector = TwoLinkVectorEnv
