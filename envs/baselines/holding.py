"""Zero, Static, PD: no action, the action that holds the target in equilibrium, and feedback of the
tip around it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import Any

import torch
from torch import Tensor

from torchbeam import State

from ..core import BeamVectorEnv
from ..episodes import Episodes
from ..parameters import numbers
from ..reach import NEAR, Reach, nearest_action
from ..single import SingleEnv

ITERATIONS = 12  # from no force; two more a step follow a target that moves


def vector_env(env: Any) -> BeamVectorEnv:
    """The vector env behind a single one, or behind wrappers; ValueError where there is none."""
    inner = getattr(env, "unwrapped", env)
    inner = inner.one if isinstance(inner, SingleEnv) else inner
    if not isinstance(inner, BeamVectorEnv):
        raise ValueError(
            f"{type(env).__name__} was given; an environment of this package is wanted"
        )
    return inner


def _check_begun(controller: Controller) -> None:
    if controller.env is None:
        raise ValueError(
            f"{type(controller).__name__} was called before begin(env); begin(env) after the reset "
            "is wanted"
        )


def _after_begin(act: Callable[[Any, Tensor], Tensor]) -> Callable[[Any, Tensor], Tensor]:
    """The same, with a sentence where there was no `begin`."""

    @wraps(act)
    def checked(self: Controller, observation: Tensor) -> Tensor:
        _check_begun(self)
        return act(self, observation)

    return checked


class Controller:
    """A derived class defines `act(observation) -> (n, a)`, and `restart` where it remembers
    something of the episodes; `self.env` is the env that is controlled.

    Observations of a single env, (o,), give its action, (a,).

    Examples:
        >>> class Push(baselines.Controller):
        ...     def act(self, observation):
        ...         return torch.ones(len(observation), 1).double()
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = Push()
        >>> controller.begin(env)
        >>> controller(observation)
        array([[1.],
               [1.]])
    """

    env: BeamVectorEnv | None = None

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "act" in vars(cls):
            cls.act = _after_begin(cls.act)

    def begin(self, env: Any) -> None:
        """The env has been reset: all of its episodes start here."""
        self.env = vector_env(env)

    def restart(self, fresh: Tensor) -> None:
        """Episodes in the mask (n,) have been reset, by the env itself or by hand."""

    def act(self, observation: Tensor) -> Tensor:
        raise NotImplementedError

    def prepare(self) -> None:
        """Compute the part of the next decision that needs no observation. Call it while the
        interval passes, if decisions must come soon. Decisions do not change.
        """

    def expect(self, now: Episodes, changed: Callable[[Tensor], State], size: int) -> None:
        """Compute the part of the next decision that can be computed from `now`, the episodes as
        they are expected to be. Their beams will be changed(d) for a small change d (n, size).
        """

    def arrive(self, change: Tensor) -> None:
        """The beams are those of `expect`, but for this change (n, size)."""

    @torch.no_grad()
    def __call__(self, observation: Any) -> Any:
        _check_begun(self)
        seen = torch.as_tensor(observation, dtype=self.env.dtype)
        fresh = self.env.state.steps == 0
        if fresh.any():
            self.restart(fresh)
        action = self.act(torch.atleast_2d(seen)).clamp(-1, 1)
        action = action if seen.ndim > 1 else action[0]
        return action if isinstance(observation, Tensor) else action.cpu().numpy()


class Zero(Controller):
    """No action, in any env.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Zero(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(self, env: BeamVectorEnv | None = None) -> None:
        pass

    def act(self, observation: Tensor) -> Tensor:
        return observation.new_zeros(self.env.action_space.shape)


@dataclass(frozen=True)
class Holding:
    """Static tip positions and whatever else is wanted of the equilibria under the actions of
    [-1, 1]^a, interpolated.

    The way back, from a target to the action whose equilibrium has its tip nearest, is
    `nearest_action` on the polynomial.
    """

    reach: Reach

    @classmethod
    def of(cls, env: BeamVectorEnv, read: Callable[[State], Tensor] | None = None) -> Holding:
        """read: state -> (..., c), beside the tip. The env's beam at its usual parameters."""

        def both(state: State) -> Tensor:
            tip = state.tip.position
            return tip if read is None else torch.cat((tip, read(state)), -1)

        return cls(env.task.within_reach(env.plant, read=both))

    def action(self, target: Tensor, guess: Tensor | None = None) -> Tensor:
        """(n, a) for targets (n, 3) m; from a guess (n, a) near it two iterations do."""
        if guess is None:
            return nearest_action(
                self._slopes, target, target.new_zeros(len(target), self.reach.actions), ITERATIONS
            )
        return nearest_action(self._slopes, target, guess, 2, NEAR)

    def at(self, action: Tensor) -> Tensor:
        """(n, c): values of `read` at the equilibria under these actions."""
        return self.reach.tip(action)[:, 3:]

    def _slopes(self, action: Tensor) -> tuple[Tensor, Tensor]:
        return self.reach.tip(action)[:, :3], self.reach.slopes(action)[:, :3]


class FeedForward:
    """Along the targets of an env's episodes, the actions that hold them in static equilibrium.

    model  an env of the task: its beam at the usual parameters is what is known;  read: as in
           `Holding.of`;  latency: intervals by which actions act later than the env's delay
    """

    def __init__(
        self, model: BeamVectorEnv, read: Callable[[State], Tensor] | None = None, latency: int = 0
    ) -> None:
        self.model, self.read, self.latency = vector_env(model), read, latency

    @cached_property
    def holding(self) -> Holding:
        return Holding.of(self.model, self.read)

    def begin(self, env: Any) -> None:
        self.env = vector_env(env)
        self.held: Tensor | None = None  # the holding actions, flat, once there is a target
        self.fresh: Tensor | None = None  # (n,) of episodes to which the last ones do not belong

    def restart(self, fresh: Tensor) -> None:
        self.fresh = fresh

    def actions(self) -> Tensor:
        """(n, delay + latency + 2, a): the actions that hold the target now, and at the ends of the
        next intervals until an action that is given now has acted; zeros where the task has no
        target, or where none holds it.
        """
        env, ahead = self.env, self.env.config.delay + self.latency + 1
        target = env.task.target(env.state, ahead) if env.task.HOLDS else None
        if target is None:
            return env.high.new_zeros(env.num_envs, ahead + 1, env.task.actions)
        at = target.flatten(0, 1)
        held = self.holding.action(at, self.held)
        if self.held is not None and self.fresh is not None:
            fresh = self.fresh.repeat_interleave(ahead + 1)[:, None]
            held = torch.where(fresh, self.holding.action(at), held)
        self.held, self.fresh = held, None
        return self.held.unflatten(0, target.shape[:2])


class Static(Controller):
    """The action that holds the target in static equilibrium.

    The target is taken where it is when the action acts. The action is zero if the task has no
    target, or if no constant action holds it.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Static(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(self, env: BeamVectorEnv) -> None:
        self.forward = FeedForward(env)

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.forward.begin(env)

    def restart(self, fresh: Tensor) -> None:
        self.forward.restart(fresh)

    def act(self, observation: Tensor) -> Tensor:
        return self.forward.actions()[:, -1]


def pd(gains: Tensor, gap: Tensor, velocity: Tensor, hold: Tensor) -> Tensor:
    """hold + p gap - d velocity along each of k axes, all (n, k), within [-1, 1]; gains
    (n or 1, 2k): p, d of one axis after the other.
    """
    return (hold + gains[:, 0::2] * gap - gains[:, 1::2] * velocity).clamp(-1, 1)


class PD(Static):
    """Proportional and derivative feedback around the holding action, on the task's
    `tracking_error`.

    The error is the gap between tip and target (else the tip's start) and its rate. If a hub turns,
    it is its angle and rate. All other actions hold.

    Args:
        gains: (2k,) for an error of k numbers, or (n, 2k), each sub-env's own

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.PD(env, gains=[1.0, 3.0])
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(self, env: BeamVectorEnv, gains: Tensor | Sequence[float]) -> None:
        super().__init__(env)
        env = vector_env(env)
        given = gains if isinstance(gains, Tensor) else torch.from_numpy(numbers("gains", gains))
        self.gains = torch.atleast_2d(given.to(dtype=env.dtype, device=env.device))

    def act(self, observation: Tensor) -> Tensor:
        hold, (error, rate) = super().act(observation), self.env.task.tracking_error(self.env.state)
        k = error.shape[-1]
        return torch.cat((pd(self.gains, error, rate, hold[:, :k]), hold[:, k:]), -1)


def search(
    score: Callable[[Tensor], Tensor],
    first: Sequence[float],
    *,
    sets: int,
    seed: int,
    widths: Sequence[float] = (1.5, 0.7, 0.35),
) -> tuple[Tensor, float]:
    """Search positive numbers (k,) of least score. Each width has `sets` log-normal draws around
    the best so far, and the best itself first. Returns the numbers and their score.

    Args:
        score: (sets, k) -> (sets,)

    Examples:
        >>> bowl = lambda tried: (tried.log() - 1).square().sum(-1)  # least at e
        >>> best, least = baselines.search(bowl, [1.0], sets=200, seed=0)
        >>> round(best.item(), 1)
        2.7
    """
    generator = torch.Generator().manual_seed(seed)
    best, least = torch.tensor([first], dtype=torch.float64), float("inf")
    for width in widths:
        spread = torch.randn(sets, best.shape[-1], generator=generator, dtype=best.dtype)
        tried = best * torch.exp(width * spread * (torch.arange(sets) > 0)[:, None])
        scores = score(tried)
        best, least = tried[scores.argmin()][None], scores.min().item()
    return best[0], least
