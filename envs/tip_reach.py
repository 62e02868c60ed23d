"""TipReach: bring the tip of a flexible cantilever to a point and hold it there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .plant import Plant
from .reach import distance, rounded, share_in_ball, uniform_numbers
from .single import SingleEnv
from .task import Task


@dataclass(frozen=True, kw_only=True)
class TipReachConfig(BeamEnvConfig):
    """reach  share of the actions' range that targets need at most on the usual beam, above 0 and
    up to 1; the rest as in `BeamEnvConfig`.
    """

    reach: float = 0.8

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("reach", above=0.0, most=1.0)


class TipReach(Task):
    """Bring the tip to a point and hold it there: `TipReachVectorEnv` has the specification."""

    Config = TipReachConfig
    GOAL = 3
    VIEW = (-0.12, 1.12, 0.6)

    def prepare(self, plant: Plant) -> None:
        self.reach = self.within_reach(plant, self.config.reach)

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 3) m: targets that forces in the ellipse hold."""
        drawn = uniform_numbers(self.actions)
        share = share_in_ball(np.array([stream.random(drawn) for stream in streams]), self.actions)
        return self.reach.tip(torch.as_tensor(share, dtype=self.dtype, device=self.device), rows)

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return now.goal[:, None].expand(-1, ahead + 1, -1)

    def target_high(self) -> np.ndarray:
        return np.full(self.directions, 4.0)

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        return self.gap(now, now.goal, tip)

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {"distance": distance(now.goal, now.beam.position[:, -1])}


class TipReachVectorEnv(BeamVectorEnv):
    """`num_envs` flexible cantilevers, stepped as one batch.

    ## Description
    Bring the tip of a strip to a target and hold it there, by a bounded force on its free end. An
    aluminium strip is clamped at one end and reaches out along x; gravity pulls along -z. The force
    acts across the undeformed strip. The target changes with the episode, and a static force within
    the bounds can hold it.

    By default the strip is 1.5 m of 6061-T6 flat bar, 3 mm x 10 mm. It is soft sideways (y): its
    first frequency is 1.1 Hz, and a static force of 1.2 N moves the tip by 0.67 m. Up and down it
    is eleven times stiffer (z: 3.6 Hz). At these deflections bending and torsion couple the two
    directions. It stays elastic: statically the bounds stress it to about 160 of 276 MPa. An
    episode is 1 s, little more than one period. The strip is geometrically exact (torchbeam's nodal
    form), with implicit steps of control_interval / substeps, unless `form` and `method` say
    otherwise.

    ## Action space
    `Box(-1, 1, (2,), float32)`: the tip force, held over one control interval; it keeps its
    direction in space. It acts `delay` intervals later: sensing, computing and actuating take time.
    Until then no force acts.

    | index | action | at 1 |
    |---|---|---|
    | 0 | tip force along y | force[0] = 1.2 N |
    | 1 | tip force along z | force[1] = 2 N |

    Values outside are clipped. An action that holds NaN or infinity counts as (0, 0) for that
    sub-env alone, and `info["action_invalid"]` says so.

    ## Observation space
    `Box(-high, high, (15 + 2 delay,), float32)`: lengths over the strip's length L, velocities over
    L omega, with omega its first natural frequency (L omega = 10.3 m/s by default). Values are
    clipped to the bounds; motion within reach does not touch them.

    | index | observation | high |
    |---|---|---|
    | 0-2 | target - tip, x y z | 4 |
    | 3-5 | tip displacement since the start, x y z | 2 |
    | 6-8 | tip velocity, x y z | 20 |
    | 9-11 | displacement of node elements // 2 (mid span), x y z | 2 |
    | 12-14 | velocity of that node, x y z | 20 |
    | 15-16 ... | actions that are still to act, the next one first | 1 |

    ## Reward
    Per control interval, with d = |target - tip| at its end and a the clipped action given:
        - (sqrt(d^2 + s^2) - s) / (0.1 L) - control_cost |a|^2,   s = L / 1000
    so 15 cm from the target cost 1 a step. A failed solve costs as much as a distance of 2 L, 20,
    for its interval and each that remains until the time limit. Going on is never worse. This
    reward is not discounted; `failure_reward` replaces it.

    ## Starting state Always the same: at rest under gravity, without tip force. The target is the
    static tip position under a random force from the sub-env's own generator (see `envs/reach.py`).
    The force is uniform in the ellipse with the half axes reach * force.

    ## Episode end
    Truncation after `max_episode_steps` intervals. Termination only where the solver fails
    (`info["solver_failed"]`): the observation is then the last finite one, and the other sub-envs
    do not notice.

    ## Information `distance` (m) from tip to target, `solver_failed`, `action_invalid`; each
    (num_envs,) with a mask `_name`, False for sub-envs that did not move. SAME_STEP adds
    `final_obs` (num_envs, 17) and `final_info` with their masks. After the end of an episode all
    other entries, `params` too, belong to the next one.

    ## Arguments
    The fields of `BeamEnvConfig`, with its defaults (see `envs/config.py`), and

    - `reach`: 0.8, share of the force bounds that targets need at most on the usual strip, above 0
      and up to 1

    "torchbeam/TipReachPlanar-v1" is this with planar=True: the horizontal plane, one action,
    9 + delay observations. "torchbeam/TipReachBlockRate-v1" is the silicone rod, 0.3 m, in two
    elements of the index-reduced block rate form, by rk4, without gravity and damping.

    ## Parameters
    For `randomize` and reset(options={"params": ...}): stiffness (0.8 to 1.2) and mass (0.8 to
    1.2), factors; damping (half to twice the usual, s); offset (-0.03 to 0.03 m). They do not move
    the target, so a stiffer strip takes a larger share of the force to hold it: up to reach *
    stiffness. The goal, for options={"goal": ...}, is the target (3,) m in frame a. A target out of
    reach is allowed; its distance stays positive.

    ## Version history v1: a failure costs all remaining intervals; in v0 it cost 100, as with
    failure_reward = -100. v0: first version.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 11), (2,))
    """

    task_type = TipReach


class TipReachEnv(SingleEnv):
    """One flexible cantilever whose tip is to reach a point: `TipReachVectorEnv` with one member,
    see there for everything.

    `gymnasium.make` ends the episode after 50 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.TipReachEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((11,), (1,))
    """

    vector = TipReachVectorEnv
