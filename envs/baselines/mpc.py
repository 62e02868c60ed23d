"""MPC: predictive control by Gauss-Newton steps, from the plan of the interval before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchbeam import State
from torchbeam.extend import count

from .. import imperfections
from ..core import BeamVectorEnv
from ..episodes import Episodes
from .holding import Controller, vector_env
from .linear import amount
from .trajectory import Linearised, TipWay, within_bounds


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
        self.about: Linearised | None = None  # what is expected; what has come
        self.here: Linearised | None = None

    def restart(self, fresh: Tensor) -> None:
        self.plan = torch.where(fresh[:, None, None], 0.0, self.plan)

    def expect(self, now: Episodes, changed: Callable[[Tensor], State], size: int) -> None:
        self.about = self._way(now).linearised(changed, self.acting(now), size)

    def arrive(self, change: Tensor) -> None:
        self.here = None if self.about is None else self.about.after(change)

    def act(self, observation: Tensor) -> Tensor:
        for _ in range(self.iterations):
            self.plan = self._better()
        first = self.plan[:, 0]
        self.plan = torch.cat((self.plan[:, 1:], self.plan[:, -1:]), 1)
        return first

    def acting(self, now: Episodes) -> Tensor:
        """(n, horizon, a): what acts in the next intervals by the plan; given over those of the
        delay at the end, an action would act after them.
        """
        late = () if now.late is None or not self.informed else (now.late,)
        queue = torch.cat((*late, now.pending, self.plan), 1)
        return self._ahead(now, now.acting, queue)

    def _ahead(self, now: Episodes, before: Tensor, queue: Tensor) -> Tensor:
        """(n, horizon, k): what acts by a queue (n, ..., k), oldest first, and by what acted last
        (n, k).
        """
        if not self.informed:
            return queue
        params, interval = now.plant.params, self.env.config.control_interval
        acts = imperfections.acting_ahead(
            before, queue, params["latency"], params["lag"], interval, self.env.simulation.spare
        )
        return params["gain"].reshape(-1, 1, 1) * acts

    def _by_plan(self, now: Episodes) -> Tensor:
        """(n, horizon, P): what acts, of each actuator, by the P actions of its plan."""
        n, planned = self.plan.shape[:2]
        waits = 0 if now.late is None or not self.informed else now.late.shape[1]
        waits += now.pending.shape[1]
        unit = torch.eye(planned).to(self.plan).expand(n, -1, -1)
        queue = torch.cat((unit.new_zeros(n, waits, planned), unit), 1)
        return self._ahead(now, unit.new_zeros(n, planned), queue)

    def _way(self, now: Episodes) -> TipWay:
        return TipWay(self.env.task, now.plant) if self.informed else self.way

    def _better(self) -> Tensor:
        """The plan after a step."""
        now, acting, about = self.env.state, self.acting(self.env.state), self.here
        self.about = self.here = None  # of this plan alone
        if about is None:
            about = self._way(now).linearised(now.beam, acting)
        own = torch.einsum("ntdsa,nsp->ntdpa", about.by_acting, self._by_plan(now)).flatten(3)
        gap, flat = self.way.gaps(now, about.at(acting)), self.plan.flatten(1)
        g, H = self.way.quadratic(gap, own, flat, self.weight)
        return within_bounds(g, H, flat, self.damping).view_as(self.plan)
