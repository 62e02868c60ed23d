"""LQR, JointLQR: optimal feedback of the beam's linear model, around the action that holds the
target; where hinges turn, around the arm at rest.
"""

from __future__ import annotations

from math import floor, inf
from numbers import Real
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat
from torchbeam.extend import shown

from ..core import BeamVectorEnv
from ..task import Task
from .holding import Controller, FeedForward, vector_env
from .riccati import delayed_gain

# Of a joint regulator: it returns, on 16 training episodes, with 0.01, 0.2, 0.3, 0.5, 1 and 3
#   SlewPlanar     -996  -362  -186  -149  -141  -144   (no action -787)
#   TwoLinkPlanar   -17   -29   -32   -36   -42   -53   (no action -138)
EFFORT = 0.5


def mean_latency(env: BeamVectorEnv) -> int:
    """Whole intervals by which actions act later than the env's delay, on average."""
    return floor(sum(env.simulation.ranges.get("latency", (0.0,))) / 2 + 0.5)


class Late:
    """The actions that were given and, by a model with more latency than the env says, are still to
    act: `latency` of them, before those that the env has pending.
    """

    def __init__(self, latency: int) -> None:
        if isinstance(latency, bool) or not isinstance(latency, int) or latency < 0:
            raise ValueError(
                f"latency = {shown(latency)} was given; intervals, 0 or more, are wanted"
            )
        self.latency = latency

    def begin(self, env: BeamVectorEnv) -> None:
        self.past = env.high.new_zeros(env.num_envs, self.latency, env.task.actions)

    def restart(self, fresh: Tensor) -> None:
        self.past = torch.where(fresh[:, None, None], 0.0, self.past)

    def queue(self, pending: Tensor) -> Tensor:
        """(n, latency + delay, a), the next to act first."""
        return torch.cat((self.past, pending), 1) if self.latency else pending

    def give(self, pending: Tensor, action: Tensor) -> Tensor:
        """The queue with an action (n, a) that is given now behind it; an interval passes."""
        queue = torch.cat((self.queue(pending), action[:, None]), 1)
        self.past = queue[:, 1 : self.latency + 1]
        return queue


def amount(name: str, value: float, *, zero: bool = False) -> float:
    """A finite positive number, or 0 where that is one too; ValueError for anything else."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (0 < value < inf or (zero and value == 0)):
        wanted = "a finite number of at least 0" if zero else "a positive finite number"
        raise ValueError(f"{name} = {shown(value)} was given; {wanted} is wanted")
    return value


class Schedule:
    """Matrices of a grid of held actions, `count` along each, interpolated linearly between."""

    def __init__(self, count: int, actions: int, like: Tensor) -> None:
        if isinstance(count, bool) or not isinstance(count, int) or count < 1 or count % 2 == 0:
            raise ValueError(
                f"schedule = {shown(count)} was given; an odd number from 1 on is wanted"
            )
        self.line = (
            torch.linspace(-1, 1, count, dtype=like.dtype).to(like)
            if count > 1
            else like.new_zeros(1)
        )
        # (points, a)
        self.points = torch.cartesian_prod(*[self.line] * actions).reshape(-1, actions)

    def at(self, hold: Tensor, matrices: Tensor) -> Tensor:
        """(n, ...) of matrices (points, ...), at held actions (n, a); (1, ...) of one point."""
        if len(matrices) == 1:
            return matrices
        step = self.line[1] - self.line[0]
        hats = (1 - (hold.clamp(-1, 1)[..., None] - self.line).abs() / step).clamp(min=0)
        share = hats[:, 0]
        for hat in hats.unbind(1)[1:]:
            share = (share[..., None] * hat[:, None]).flatten(1)
        return (share @ matrices.flatten(1)).unflatten(-1, matrices.shape[1:])


def times(matrix: Tensor, vector: Tensor) -> Tensor:
    """(n, i) of matrices (n or 1, i, j) and vectors (n, j)."""
    return vector @ matrix[0].mT if len(matrix) == 1 else (matrix @ vector[..., None])[..., 0]


class LQR(Controller):
    """Linear quadratic regulator about the holding action: u = hold - K [z - z_hold; actions still
    to act - hold].

    K solves the discrete Riccati equation. z is the whole state of the beam (displacements, turns
    and rates of all nodes), read off the simulation. The model is `tb.linearize` about an
    equilibrium, at the usual parameters. It is exact over control intervals with the action held,
    and includes the delay. The state z_hold and action hold are the nonlinear equilibria along the
    target's path, with the rates at which they follow each other. The cost is

        sum  |tip - target|^2 / (0.1 L)^2 + speed_weight |tip velocity|^2 / (L omega)^2 + effort
             |u - hold|^2

    Args:
        effort, speed_weight: of the cost
        latency: number of intervals by which actions act later in the model than the env's delay;
            None = the mean if the env draws it
        schedule: number of models (odd) along each action, about the equilibria of constant actions
            from -1 to 1. Gains are interpolated between them at `hold`. 1 = a single model, without
            action

    Raises:
        ValueError: for a task whose targets no constant action holds (a hub or a hinge turns:
            `JointLQR`), and for numbers out of these ranges.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.LQR(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        effort: float = 0.01,
        speed_weight: float = 0.1,
        *,
        latency: int | None = None,
        schedule: int = 1,
    ) -> None:
        env = vector_env(env)
        latency = mean_latency(env) if latency is None else latency
        if not env.task.HOLDS:
            raise ValueError(
                "a task whose targets no constant action holds was given (a hub turns); LQR "
                "wants one that does"
            )
        amount("effort", effort)
        amount("speed_weight", speed_weight, zero=True)
        self.late = Late(latency)
        self.schedule = Schedule(schedule, env.task.actions, env.high)
        still = {name: env.high.new_zeros(1, size) for name, size in env.plant.scene.inputs.items()}
        self.rest = tb.equilibrium(env.plant.scene, inputs=still)
        # of the whole state, of the readings
        self.sizes = (12 * env.task.elements, env.sensors.size)
        self.forward = FeedForward(
            env,
            lambda state: torch.cat((self.whole(state), self.readings(env, state)), -1),
            latency,
        )
        self.A, self.B, wholes, self.C = self._models(env)
        tip = wholes.unflatten(1, (4, env.task.elements, 3))[:, :, -1]
        # displacement, turn, velocity, spin of the tip
        share = speed_weight**0.5 / env.task.speed[0].item()
        near = torch.cat((tip[:, 0] / (0.1 * env.task.length), share * tip[:, 2]), 1)
        delay = env.config.delay + latency
        self.K = torch.stack(
            [
                delayed_gain(A, B, N.mT @ N, effort, delay)
                for A, B, N in zip(self.A, self.B, near, strict=True)
            ]
        )

    def _models(self, env: BeamVectorEnv) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """(points, ...) A, B of a control interval, from actions; C of the whole state and of the
        readings: all by the z of the first of them, the model about the equilibrium without action.
        """
        points, scene = self.schedule.points, env.plant.scene
        sensors = [self.whole, lambda state: self.readings(env, state)]
        models = []
        for action in torch.cat((torch.zeros_like(points[:1]), points)):
            held = env.task.inputs(action[None])
            at = tb.equilibrium(scene, inputs=held)
            model = tb.linearize(scene, at, sensors, inputs=held)
            model = model.discrete(env.config.control_interval)
            A, B, C = (x[0] if x.ndim > 2 else x for x in (model.A, model.B, model.C))
            B = torch.cat(
                [B[:, model.inputs[drive.input]] @ drive.gain.mT for drive in env.task.drives], -1
            )
            models.append((A, B, *C.split(self.sizes)))
        whole = models[0][2]
        self.decode = torch.linalg.pinv(whole)  # whole state -> z
        # an equilibrium has coordinates of its own: what they are in those of the first
        common = [
            (S @ A @ torch.linalg.inv(S), S @ B, C @ torch.linalg.inv(S), D @ torch.linalg.inv(S))
            for A, B, C, D in models[1:]
            for S in [self.decode @ C]
        ]
        return tuple(torch.stack(each) for each in zip(*common, strict=True))

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.forward.begin(env)
        self.late.begin(self.env)

    def restart(self, fresh: Tensor) -> None:
        self.forward.restart(fresh)
        self.late.restart(fresh)

    def whole(self, state: tb.State) -> Tensor:
        """(..., 12 elements): displacement, turn, velocity and spin of every node but the clamped
        one, since the start.
        """
        rest = self.rest
        turn = quat.logarithm(quat.multiply(quat.conjugate(rest.rotation), state.rotation))
        parts = (state.position - rest.position, turn, state.velocity, state.spin)
        return torch.cat([part[..., 1:, :].flatten(-2) for part in parts], -1)

    def readings(self, env: BeamVectorEnv, state: tb.State) -> Tensor:
        """(..., sensors): readings of the env's sensors, without noise."""
        return env.simulation.observer.read(
            state, self.rest, env.scale if env.scale.ndim == 1 else env.scale[:1]
        )

    def reference(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Reference along the targets: hold (n, delay + latency + 2, a). For the present: z at rest
        (n, z), its rates (n, z), and the readings (n, s) with these.
        """
        hold = self.forward.actions()
        if self.forward.held is None:
            none = hold.new_zeros(len(hold), self.A.shape[-1])
            return hold, none, none, hold.new_zeros(len(hold), self.sizes[1])
        whole, readings = self.forward.holding.at(hold[:, 0]).split(self.sizes, -1)
        after = self.forward.holding.at(hold[:, 1]).split(self.sizes, -1)[0]
        moved = (after - whole)[:, : self.sizes[0] // 2] / self.env.config.control_interval
        rates = torch.cat((torch.zeros_like(moved), moved), -1) @ self.decode.mT
        C = self.schedule.at(hold[:, 0], self.C)
        return hold, whole @ self.decode.mT, rates, readings + times(C, rates)

    def feedback(self, hold: Tensor, z: Tensor) -> Tensor:
        """(n, a) from departures z (n, z) from the reference."""
        waiting = (self.late.queue(self.env.state.pending) - hold[:, 1:-1]).flatten(1)
        K = self.schedule.at(hold[:, 0], self.K)
        return hold[:, -1] - times(K, torch.cat((z, waiting), -1))

    def act(self, observation: Tensor) -> Tensor:
        hold, still, rates, _ = self.reference()
        z = self.whole(self.env.state.beam) @ self.decode.mT
        action = self.feedback(hold, z - still - rates).clamp(-1, 1)
        self.late.give(self.env.state.pending, action)
        return action


class JointLQR(Controller):
    """Linear quadratic regulator of a task whose hinges rest at any angle: u = -K [z - z_rest;
    actions still to act].

    z is the state in the coordinates of `tb.linearize` about the start, at the usual parameters.
    z_rest is the arm at rest with its hinges at the targets' angles and rates (`Task.resting`). The
    cost is that of `LQR`.

    Args:
        effort, speed_weight: of the cost. Half turns need an effort of 0.5 or more: a cheaper
            action asks for more than there is, and overshoots. Targets that stay near the arm need
            less
        latency: intervals by which actions act later in the model than the env's delay

    Raises:
        ValueError: for a task without hinges that rest anywhere.

    Examples:
        >>> env = envs.SlewVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.JointLQR(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 2)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        effort: float = EFFORT,
        speed_weight: float = 0.1,
        *,
        latency: int = 0,
    ) -> None:
        env = vector_env(env)
        scene, task = env.plant.scene, env.task
        if type(task).resting is Task.resting:
            raise ValueError(
                "a task without hinges that rest at any angle was given; LQR is there for it"
            )
        amount("effort", effort)
        amount("speed_weight", speed_weight, zero=True)
        self.late = Late(latency)
        still = {name: env.high.new_zeros(size) for name, size in scene.inputs.items()}
        tip = (lambda s: s.position[..., -1, :], lambda s: s.velocity[..., -1, :])
        self.model = tb.linearize(scene, tb.rest(scene), tip, inputs=still)
        held = self.model.discrete(env.config.control_interval)
        self.A = held.A
        self.B = torch.cat(
            [held.B[:, held.inputs[drive.input]] @ drive.gain.mT for drive in task.drives], -1
        )
        share = speed_weight**0.5 / task.speed[0].item()
        near = torch.cat((held.C[:3] / (0.1 * task.length), share * held.C[3:]))
        delay = env.config.delay + latency
        self.K = delayed_gain(self.A, self.B, near.mT @ near, effort, delay)

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.late.begin(self.env)

    def restart(self, fresh: Tensor) -> None:
        self.late.restart(fresh)

    def resting(self) -> Tensor:
        """(n, z) of the arm at rest where the targets want it."""
        return self.model.departure(self.env.task.resting(self.env.state))

    def feedback(self, z: Tensor) -> Tensor:
        """(n, a) from departures z (n, z) from the arm at rest."""
        waiting = self.late.queue(self.env.state.pending).flatten(1)
        return -torch.cat((z, waiting), -1) @ self.K.mT

    def act(self, observation: Tensor) -> Tensor:
        z = self.model.departure(self.env.state.beam)
        action = self.feedback(z - self.resting()).clamp(-1, 1)
        self.late.give(self.env.state.pending, action)
        return action
