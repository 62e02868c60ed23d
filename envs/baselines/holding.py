"""Zero, Static, PD: no action, the action that holds the target in equilibrium, and feedback of the tip around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchbeam import State

from ..core import BeamVectorEnv
from ..reach import Reach

ITERATIONS = 12  # of Gauss-Newton at most, from no force; two more a step follow a target that moves


class Controller:
    """A derived class defines `act(observation) -> (n, a)`; `self.env` is the env that is controlled."""

    def begin(self, env: BeamVectorEnv) -> None:
        """The env has been reset: all of its episodes start here."""
        self.env = env

    def act(self, observation: Tensor) -> Tensor:
        raise NotImplementedError

    @torch.no_grad()
    def __call__(self, observation: Any) -> Any:
        action = self.act(torch.as_tensor(observation, dtype=self.env.dtype)).clamp(-1, 1)
        return action if isinstance(observation, Tensor) else action.cpu().numpy()


class Zero(Controller):
    """No action."""

    def act(self, observation: Tensor) -> Tensor:
        return observation.new_zeros(self.env.action_space.shape)


@dataclass(frozen=True)
class Holding:
    """Static tip positions and whatever else is wanted of the equilibria under the actions of [-1, 1]^a, interpolated.

    The way back, from a target to the action whose equilibrium has its tip nearest, is Gauss-Newton on the polynomial.
    """

    reach: Reach

    @classmethod
    def of(cls, env: BeamVectorEnv, read: Callable[[State], Tensor] | None = None) -> Holding:
        """read: state -> (..., c), beside the tip. The env's beam at its usual parameters."""
        def both(state: State) -> Tensor:
            tip = state.tip.position
            return tip if read is None else torch.cat((tip, read(state)), -1)
        return cls(Reach.of(env.plant.scene, env.force, env.axes, both))

    def action(self, target: Tensor, guess: Tensor | None = None) -> Tensor:
        """(n, a) for targets (n, 3) m; from a guess (n, a) near it two iterations do."""
        axes = 1 if self.reach.coefficients.shape[-2] == 1 else 2
        action = target.new_zeros(len(target), axes) if guess is None else guess
        for _ in range(ITERATIONS if guess is None else 2):
            tip, J = self._slopes(action)
            change = torch.linalg.lstsq(J, (target - tip)[..., None]).solution[..., 0]
            action = (action + change).clamp(-1, 1)
        return action

    def at(self, action: Tensor) -> Tensor:
        """(n, c): what `read` said of the equilibria under these actions."""
        return self.reach.tip(action)[:, 3:]

    def _slopes(self, action: Tensor) -> tuple[Tensor, Tensor]:
        def tip(a: Tensor) -> Tensor:
            return self.reach.tip(a)[:, :3]
        ways = torch.eye(action.shape[-1], dtype=action.dtype, device=action.device)
        J = [torch.func.jvp(tip, (action,), (way.expand_as(action),))[1] for way in ways]
        return tip(action), torch.stack(J, -1)


class Static(Controller):
    """The action that holds the target in static equilibrium, where the target is when the action acts; none where the task has
    no target.
    """

    def __init__(self, env: BeamVectorEnv, read: Callable[[State], Tensor] | None = None) -> None:
        self.model, self.read = env, read

    @cached_property
    def holding(self) -> Holding:
        return Holding.of(self.model, self.read)

    def begin(self, env: BeamVectorEnv) -> None:
        super().begin(env)
        self.held: Tensor | None = None  # the holding actions, flat, once there is a target

    def targets(self) -> Tensor | None:
        """(n, delay + 2, 3) m: now, and at the ends of the next intervals until an action that is given now has acted."""
        env, now = self.env, self.env.state
        if hasattr(env, "target"):
            return env.target(now, env.instants(now, env.delay + 1))
        target = env.sketch(now).get("target")
        return None if target is None else target[:, None].expand(-1, env.delay + 2, -1)

    def hold(self) -> Tensor:
        """(n, delay + 2, tip forces): the actions that hold `targets`; none where a hub turns: it rests at any angle."""
        env, targets = self.env, self.targets()
        if targets is None or env.HUB:
            return env.high.new_zeros(env.num_envs, env.delay + 2, len(env.force))
        self.held = self.holding.action(targets.flatten(0, 1), self.held)
        return self.held.unflatten(0, targets.shape[:2])

    def whole_action(self, force: Tensor) -> Tensor:
        """(n, a): with no action of the hub."""
        return torch.cat((force.new_zeros(len(force), self.env.HUB), force), -1)

    def act(self, observation: Tensor) -> Tensor:
        return self.whole_action(self.hold()[:, -1])


def pd(gains: Tensor, gap: Tensor, velocity: Tensor, hold: Tensor) -> Tensor:
    """hold + p gap - d velocity along each of k axes, all (n, k), within [-1, 1]; gains (n or 1, 2k): p, d of one axis after
    the other.
    """
    return (hold + gains[:, 0::2] * gap - gains[:, 1::2] * velocity).clamp(-1, 1)


class PD(Static):
    """`pd` around the holding action, from the gap between tip and target over the length, and the tip's velocity less the
    target's over length * first frequency. Where there is no target, it is the tip's place at the start. Where a hub turns, it
    is `pd` of its angle (rad) and rate (over the first frequency) instead, and there is no force on the tip.

    gains  (2k,) for k force axes or one hub, or (n, 2k), each sub-env's own
    """

    def __init__(self, env: BeamVectorEnv, gains: Tensor | Sequence[float]) -> None:
        super().__init__(env)
        self.gains = torch.atleast_2d(torch.as_tensor(gains, dtype=env.dtype, device=env.device))

    def act(self, observation: Tensor) -> Tensor:
        env, now, targets = self.env, self.env.state, self.targets()
        if env.HUB:
            angle, rate = env.measures(now)["angle"][:, None], now.beam.node(0).spin[:, 2:] * (env.length / env.speed)
            torque = pd(self.gains, angle, rate, torch.zeros_like(angle))
            return torch.cat((torque, torque.new_zeros(len(torque), len(env.force))), -1)
        targets = now.start.tip.position[:, None].expand(-1, 2, -1) if targets is None else targets
        gap = (targets[:, 0] - now.beam.tip.position) @ env.axes.T / env.length
        moving = (targets[:, 1] - targets[:, 0]) / env.control_interval
        velocity = (now.beam.tip.velocity - moving) @ env.axes.T / env.speed
        return self.whole_action(pd(self.gains, gap, velocity, self.hold()[:, -1]))


def search(score: Callable[[Tensor], Tensor], first: Sequence[float], *, sets: int, seed: int,
           widths: Sequence[float] = (1.5, 0.7, 0.35)) -> tuple[Tensor, float]:
    """Positive numbers (k,) of least score, and that score: for each width `sets` log-normal draws around the best so far,
    the first being the best itself.

    score  (sets, k) -> (sets,)
    """
    generator = torch.Generator().manual_seed(seed)
    best, least = torch.tensor([first], dtype=torch.float64), float("inf")
    for width in widths:
        spread = torch.randn(sets, best.shape[-1], generator=generator, dtype=best.dtype)
        tried = best * torch.exp(width * spread * (torch.arange(sets) > 0)[:, None])
        found = score(tried)
        best, least = tried[found.argmin()][None], found.min().item()
    return best[0], least
