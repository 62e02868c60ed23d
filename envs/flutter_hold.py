"""FlutterHold: keep a cantilever under a follower thrust beyond Beck's load from fluttering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter
from .plant import softest
from .reach import distance, rounded
from .single import SingleEnv
from .task import Task

# P L^2 / EI at which the undamped cantilever flutters under a follower force (Beck 1952)
BECK = 20.05


@dataclass(frozen=True, kw_only=True)
class FlutterHoldConfig(BeamEnvConfig):
    """thrust (over Beck's load), kick (m/s): see `FlutterHoldVectorEnv`; the rest as in
    `BeamEnvConfig`.
    """

    thrust: float = 1.2
    kick: float = 0.2
    force: Sequence[float] = (0.5, 0.5)
    gravity: Sequence[float] | None = None
    max_episode_steps: int | None = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("thrust", "kick", least=0.0)


class FlutterHold(Task):
    """Hold a strip straight under a follower thrust beyond Beck's load: `FlutterHoldVectorEnv` has
    the specification.
    """

    Config = FlutterHoldConfig
    VIEW = (-0.12, 1.3, 0.5)

    def __init__(self, config: FlutterHoldConfig) -> None:
        super().__init__(config)
        self.goal_size = len(self.lateral)
        self.beck = BECK / (softest(self.usual).amin() * self.length**2)  # N

    def parameters(self) -> dict[str, Parameter]:
        return {"thrust": Parameter(self.config.thrust, 1.15, 1.35), **super().parameters()}

    def effects(self, params: dict[str, Tensor]) -> tuple:
        none = torch.zeros_like(params["thrust"])
        return (
            tb.TipLoad(
                force=torch.stack((-self.beck * params["thrust"], none, none), -1), follower=True
            ),
        )

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, directions) m/s: the kicks."""
        most = self.config.kick
        drawn = np.stack([stream.uniform(-most, most, 2)[: self.goal_size] for stream in streams])
        return torch.as_tensor(drawn, dtype=self.dtype, device=self.device)

    def initial_state(self, beam: tb.State, goal: Tensor) -> tb.State:
        along = (
            torch.linalg.vector_norm(beam.position - beam.position[..., :1, :], dim=-1)[..., None]
            / self.length
        )
        return replace(beam, velocity=beam.velocity + along**2 * (goal @ self.lateral)[:, None])

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def farthest(self) -> float:
        return self.length / 4  # beyond it is lost

    def task_failed(self, now: Episodes) -> Tensor:
        return now.measures["lost"]

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        off = distance(now.beam.position[:, -1], now.start.position[:, -1])
        return {"distance": off, "lost": off > self.farthest()}

    def render_data(self, now: Episodes) -> dict[str, Any]:
        return {"thrust": now.plant.params["thrust"].expand(len(now.steps))}


class FlutterHoldVectorEnv(BeamVectorEnv):
    """`num_envs` cantilevers that flutter unless they are held, stepped as one batch.

    ## Description
    Hold a strip straight that flutters by itself. It is 1.5 m of aluminium flat bar, 3 mm x 10 mm,
    clamped at one end. A thrust presses on its free end against its axis and turns with it. Beyond

        P = 20.05 EI / L^2,  EI the softer bending stiffness    (13.8 N; Beck 1952)

    the straight strip is unstable: two modes join and grow into flutter. A small force across the
    tip is to hold it straight. Internal damping, which is always present here, lowers that load. A
    coarse mesh raises it: without damping six elements flutter from 1.11 times that load, eight
    from 1.06, twelve from 1.03. The thrust is 1.2 times Beck's. Motion in the soft direction then
    grows by a factor of e in 0.2 s at 3.5 Hz. Up and down the strip is eleven times stiffer and
    stable. No gravity.

    ## Action space
    `Box(-1, 1, (2,), float32)`: force across the tip along y and z, of fixed direction, 0.5 N each
    at 1; held over an interval, `delay` intervals later. Values outside are clipped; a row that is
    not finite counts as zeros.

    ## Observation space
    `Box(-high, high, (12 + 2 delay,), float32)`: the `sensors`, and actions that are still to act,
    as in TipReach.

    | index | observation | high |
    |---|---|---|
    | 0-2 | tip displacement, x y z, over the length | 2 |
    | 3-5 | tip velocity, over L omega, omega the first natural frequency without thrust | 20 |
    | 6-8, 9-11 | the same of node elements // 2 (mid span) | 2, 20 |
    | 12-13 ... | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d the tip's distance from its place on the straight strip:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000
    If the strip is lost, or the solver fails, the reward is -2.5, the largest cost. It counts for
    this interval and for each that remains until the time limit; `failure_reward` replaces it.

    ## Starting state
    Straight, kicked: velocities kick (x/L)^2 along y and z, each uniform in [-kick, kick], from the
    sub-env's own generator.

    ## Episode end
    Termination where the tip is more than L/4 off: the strip is lost (`info["lost"]`); or where the
    solver fails. Truncation after 100 steps (2 s).

    ## Information
    `distance` (m) of the tip from its place, `lost`, `solver_failed`, `action_invalid`, masks as in
    TipReach.

    ## Arguments
    The fields of `BeamEnvConfig` (see `envs/config.py`), with its defaults but gravity = None,
    force = (0.5, 0.5) and max_episode_steps = 100, and

    - `thrust`: 1.2, in units of Beck's load of the section at its usual stiffness
    - `kick`: m/s, 0.2: of the tip at the start, at most, in each direction

    "torchbeam/FlutterHoldPlanar-v1" is this with planar=True: the horizontal plane, the soft
    direction.

    ## Parameters
    thrust (1.15 to 1.35), and those of TipReach. The goal, for options={"goal": ...}, is the kick
    (m/s) along y and z.

    ## Version history v1: a failure costs all remaining intervals; in v0 it cost 100, as with
    failure_reward = -100 (which the studies of learning are made with). v0: first version.

    Examples:
        >>> env = envs.FlutterHoldVectorEnv(2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 9), (2,))
    """

    task_type = FlutterHold


class FlutterHoldEnv(SingleEnv):
    """One cantilever to keep from fluttering: `FlutterHoldVectorEnv` with one member, see there for
    everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    ends only when it is lost.

    Examples:
        >>> env = envs.FlutterHoldEnv(planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((9,), (1,))
    """

    vector = FlutterHoldVectorEnv
