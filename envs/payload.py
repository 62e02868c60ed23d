"""Payload: bring an unknown mass on the tip of a flexible cantilever to a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

import torchbeam as tb

from .core import BeamVectorEnv
from .episodes import Episodes
from .parameters import Parameter
from .single import SingleEnv
from .tip_reach import TipReach, TipReachConfig


@dataclass(frozen=True, kw_only=True)
class PayloadConfig(TipReachConfig):
    """payload  kg, the usual mass; randomize=None draws it from half to one and a half times that.
    The rest as in `TipReachConfig`.
    """

    payload: float = 0.1
    reach: float = 0.5
    max_episode_steps: int | None = 100
    randomize: bool | Mapping[str, Sequence[float]] | None = None
    params_in_info: bool | None = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("payload", least=0.0)
        if self.randomize is None:
            object.__setattr__(
                self, "randomize", {"payload": (self.payload / 2, 1.5 * self.payload)}
            )


class Payload(TipReach):
    """TipReach with a mass on the tip that is not told: `PayloadVectorEnv` has the
    specification.
    """

    Config = PayloadConfig
    PLANE = "xz"
    STARTS_ALIKE = True

    def parameters(self) -> dict[str, Parameter]:
        usual = self.config.payload
        return {"payload": Parameter(usual, usual / 2, 1.5 * usual), **super().parameters()}

    def effects(self, params: dict[str, Tensor]) -> tuple:
        return (tb.PointMass(params["payload"]),)

    def render_data(self, now: Episodes) -> dict[str, Any]:
        size = now.plant.params["payload"] / (self.config.payload or 1.0)
        return {**super().render_data(now), "payload": size.expand(len(now.steps))}


class PayloadVectorEnv(BeamVectorEnv):
    """`num_envs` flexible cantilevers that carry a mass on their tips, stepped as one batch.

    ## Description Bring a strip with an unknown mass on its tip to a target, and hold it there, by
    a force on the tip. The strip is that of `TipReachVectorEnv`: 1.5 m of aluminium flat bar of
    0.12 kg, clamped, under gravity. The point mass of 0.05 to 0.15 kg is drawn with the episode and
    not observed. The sag, the frequency (0.5 Hz sideways with 0.1 kg) and the force that holds the
    target depend on it. Only the motion reveals it, because every episode begins in the same shape.

    ## Action space, observation space, reward, episode end, information
    As in TipReach, but for 100 steps (2 s). With `params_in_info=True`
    `info["params"]["payload"]` (kg) is the mass.

    ## Starting state Still, in the shape in which the usual strip hangs with the usual mass.
    Another mass then sinks or rises. Displacements count from there. The target is the static tip
    position of the strip with the usual mass under a random force. The force is uniform in the
    ellipse with the half axes reach * force. To hold it with another mass takes up to 0.5 N more or
    less of the 2 N that the force has.

    ## Arguments
    The arguments of TipReach with its defaults but reach = 0.5, max_episode_steps = 100,
    randomize = {"payload": (0.05, 0.15)}, and

    - `payload`: kg, 0.1: the usual mass

    "torchbeam/PayloadPlanar-v2" is this with planar=True: the vertical plane x-z.

    ## Parameters
    payload (half to one and a half times the usual, kg), and those of TipReach.

    ## Version history v2: a failure costs all remaining intervals, see TipReach; in v1 it cost 100,
    less than doing nothing. v1: all start in one shape. v0 started in equilibrium with the mass of
    the episode. The distance
        of the target then told the mass, to 2 g of 29 g in the first observation.

    Examples:
        >>> env = envs.PayloadVectorEnv(2, elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 11), (2,))
    """

    task_type = Payload


class PayloadEnv(SingleEnv):
    """One flexible cantilever with a mass on its tip: `PayloadVectorEnv` with one member, see there
    for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.PayloadEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((11,), (1,))
    """

    vector = PayloadVectorEnv
