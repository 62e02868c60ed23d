"""MPC: predictive control by Gauss-Newton steps, from the plan of the interval before."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchbeam.extend import count

from .. import imperfections
from ..core import BeamVectorEnv
from .holding import Controller, vector_env
from .linear import amount
from .trajectory import TipWay, within_bounds


class MPC(Controller):
    """Model predictive control: a Gauss-Newton step on the next actions in each interval.

    It starts from the plan of the interval before, keeps actions within their bounds, and returns
    the first action. This is the real-time iteration of Diehl, Bock and Schloeder (2005). The cost
    is the task's, of the tip's path and of the actions. A step takes a rollout, a sweep for all of
    its derivatives and a quadratic program. For a beam of few elements these take a few
    milliseconds (docs/environments.md).

    It reads the whole state of the beam off the simulation and knows the targets over its horizon.
    Its model is the beam at the usual parameters, with actions that are still to act. Informed, it
    knows more than a controller can: each episode's parameters, of the beam and of sensors and
    actuators. Its model is then exact, and its return shows how much there is to gain.

    Args:
        horizon: number of intervals
        iterations: number of Gauss-Newton steps in each interval
        terminal: weight of the last gap, in units of the weight of the others
        damping: of the steps, relative to the largest entry on the diagonal of their matrix
        informed: whether the model has each episode's own parameters

    Raises:
        ValueError: for a task with a memory beside its beam, a horizon that is not longer than the
            delay, no iterations, and negative weights.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.MPC(env, horizon=5)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        horizon: int = 25,
        *,
        iterations: int = 1,
        terminal: float = 5.0,
        damping: float = 1e-6,
        informed: bool = False,
    ) -> None:
        env = vector_env(env)
        count("horizon", horizon)
        count("iterations", iterations)
        amount("terminal", terminal, zero=True)
        amount("damping", damping, zero=True)
        if horizon <= env.config.delay:
            raise ValueError(
                f"horizon = {horizon} was given for a delay of {env.config.delay}; more is wanted"
            )
        self.horizon, self.iterations, self.damping = horizon, iterations, damping
        self.informed = informed
        self.weight = torch.ones(horizon, dtype=env.dtype, device=env.device)
        self.weight[-1] = terminal
        self.way = TipWay(env.task, env.plant)

    def begin(self, env: Any) -> None:
        super().begin(env)
        planned = self.horizon - self.env.config.delay
        # (n, horizon - delay, a), from the one that is given now
        self.plan = self.env.high.new_zeros(self.env.num_envs, planned, self.env.task.actions)

    def restart(self, fresh: Tensor) -> None:
        self.plan = torch.where(fresh[:, None, None], 0.0, self.plan)

    def act(self, observation: Tensor) -> Tensor:
        for _ in range(self.iterations):
            self.plan = self._better(self.plan)
        first = self.plan[:, 0]
        self.plan = torch.cat((self.plan[:, 1:], self.plan[:, -1:]), 1)
        return first

    def acting(self, plan: Tensor) -> Tensor:
        """(n, horizon, a): what acts in the next intervals; given over those of the delay at the
        end, an action would act after them.
        """
        now, simulation = self.env.state, self.env.simulation
        if not self.informed:
            return torch.cat((now.pending, plan), 1)
        late, params = () if now.late is None else (now.late,), now.plant.params
        queue = torch.cat((*late, now.pending, plan), 1)
        interval = self.env.config.control_interval
        acts = imperfections.acting_ahead(
            now.acting, queue, params["latency"], params["lag"], interval, simulation.spare
        )
        return params["gain"].reshape(-1, 1, 1) * acts

    def _better(self, plan: Tensor) -> Tensor:
        """The plan after a step."""
        now = self.env.state
        way = TipWay(self.env.task, now.plant) if self.informed else self.way
        tips, slopes = way.slopes(now, plan, self.acting)
        own = slopes.flatten(3)
        gap, flat = self.way.gaps(now, tips), plan.flatten(1)
        g, H = self.way.quadratic(gap, own, flat, self.weight)
        return within_bounds(g, H, flat, self.damping).view_as(plan)
