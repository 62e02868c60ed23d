"""LQR, LQG: optimal feedback of the beam's linear model about its start, around the action that
holds the target.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions as quat

from ..core import BeamVectorEnv
from ..task import Task
from .holding import Controller, FeedForward, vector_env

DOUBLINGS = 60  # of the horizon of a Riccati recursion, at most
# standard deviations that the filter reckons with: of readings without noise; of the action
SENSOR, ACTION = 1e-3, 0.1


class LQR(Controller):
    """u = hold - K [z - z_hold; pending actions - hold], with K from the discrete Riccati equation.

    z is the whole state of the beam (displacements, turns and rates of all nodes), read off the
    simulation. The model is `tb.linearize` about the equilibrium without action, at the usual
    parameters, exact over control intervals with the action held, and with the delay in it; z_hold
    and hold are those of the nonlinear equilibria along the target's path, with the rates at which
    they follow each other. The cost is

        sum  |tip - target|^2 / (0.1 L)^2 + speed_weight |tip velocity|^2 / (L omega)^2 + effort
             |u - hold|^2

    Args:
        effort, speed_weight: of the cost

    Raises:
        ValueError: for a task whose targets no constant action holds (a hub or a hinge turns:
            `JointLQR`).
    """

    def __init__(self, env: BeamVectorEnv, effort: float = 0.01, speed_weight: float = 0.1) -> None:
        env = vector_env(env)
        if not env.task.HOLDS:
            raise ValueError(
                "a task whose targets no constant action holds was given (a hub turns); LQR "
                "wants one that does"
            )
        still = {name: env.high.new_zeros(1, size) for name, size in env.plant.scene.inputs.items()}
        self.rest = tb.equilibrium(env.plant.scene, inputs=still)
        # of the whole state, of the readings
        self.sizes = (12 * env.task.elements, env.sensors.size)
        self.forward = FeedForward(
            env, lambda state: torch.cat((self.whole(state), self.readings(env, state)), -1)
        )
        self.A, self.B, whole, self.C = self._model(env, still)
        self.decode = torch.linalg.pinv(whole)  # whole state -> z
        # displacement, turn, velocity, spin of the tip
        tip = whole.unflatten(0, (4, env.task.elements, 3))[:, -1]
        scale = 0.1 * env.task.length, env.task.speed[0].item() / speed_weight**0.5
        near = torch.cat((tip[0] / scale[0], tip[2] / scale[1]))
        self.K = delayed_gain(self.A, self.B, near.mT @ near, effort, env.config.delay)

    def _model(
        self, env: BeamVectorEnv, still: dict[str, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """A, B of a control interval, from actions; C of the whole state and of the readings."""
        sensors = [self.whole, lambda state: self.readings(env, state)]
        model = tb.linearize(env.plant.scene, self.rest, sensors, inputs=still).discrete(
            env.config.control_interval
        )
        A, B, C = (x[0] if x.ndim > 2 else x for x in (model.A, model.B, model.C))
        B = torch.cat(
            [B[:, model.inputs[drive.input]] @ drive.gain.mT for drive in env.task.drives], -1
        )
        return A, B, C[: self.sizes[0]], C[self.sizes[0] :]

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.forward.begin(env)

    def restart(self, fresh: Tensor) -> None:
        self.forward.restart(fresh)

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
        """Along the targets: hold (n, delay + 2, a); now: z at rest there (n, z), its rates (n, z)
        and, with them, the readings (n, s).
        """
        hold = self.forward.actions()
        if self.forward.held is None:
            none = hold.new_zeros(len(hold), len(self.A))
            return hold, none, none, hold.new_zeros(len(hold), self.sizes[1])
        whole, readings = self.forward.holding.at(hold[:, 0]).split(self.sizes, -1)
        after = self.forward.holding.at(hold[:, 1]).split(self.sizes, -1)[0]
        moved = (after - whole)[:, : self.sizes[0] // 2] / self.env.config.control_interval
        rates = torch.cat((torch.zeros_like(moved), moved), -1) @ self.decode.mT
        return hold, whole @ self.decode.mT, rates, readings + rates @ self.C.mT

    def feedback(self, hold: Tensor, z: Tensor) -> Tensor:
        """(n, a) from departures z (n, z) from the reference."""
        pending = (self.env.state.pending - hold[:, 1:-1]).flatten(1)
        return hold[:, -1] - torch.cat((z, pending), -1) @ self.K.mT

    def act(self, observation: Tensor) -> Tensor:
        hold, still, rates, _ = self.reference()
        return self.feedback(hold, self.whole(self.env.state.beam) @ self.decode.mT - still - rates)


class LQG(LQR):
    """LQR on the estimate of a steady Kalman filter, which sees the observation alone: z of the
    same linear model, from the env's sensors and the actions that it gave. It starts at the true
    state: at rest, undeflected.

    The filter reckons with white noise of the env's `noise` (at least 1e-3) on each reading and of
    0.1 on each action.
    """

    def __init__(self, env: BeamVectorEnv, effort: float = 0.01, speed_weight: float = 0.1) -> None:
        super().__init__(env, effort, speed_weight)
        env = vector_env(env)
        noise = max(env.config.noise, SENSOR) ** 2 * torch.eye(len(self.C), dtype=self.C.dtype)
        # covariance of the prediction
        P = riccati(self.A.mT, self.C.mT, ACTION**2 * self.B @ self.B.mT, noise)
        # what a reading says of z
        self.M = torch.linalg.solve(self.C @ P @ self.C.mT + noise, self.C @ P).mT

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.z = self._starts()  # the prediction of now

    def restart(self, fresh: Tensor) -> None:
        super().restart(fresh)
        self.z = torch.where(fresh[:, None], self._starts(), self.z)

    def _starts(self) -> Tensor:
        """(n, z): where the episodes start."""
        return self.whole(self.env.state.start) @ self.decode.mT

    def act(self, observation: Tensor) -> Tensor:
        env = self.env
        hold, still, rates, readings = self.reference()
        z = self.z - still - rates
        first = observation.shape[-1] - env.state.pending[0].numel() - len(self.C)
        error = observation[:, first : first + len(self.C)] - readings - z @ self.C.mT
        z = z + error @ self.M.mT
        action = self.feedback(hold, z).clamp(-1, 1)
        queue = torch.cat((env.state.pending, action[:, None]), 1)
        # the equilibrium stays where it is under its own action: still = A still + B hold, whatever
        # the amplitude
        self.z = still + (z + rates) @ self.A.mT + (queue[:, 0] - hold[:, 0]) @ self.B.mT
        return action


class JointLQR(Controller):
    """u = -K [z - z_rest; pending actions], of a task whose hinges rest at any angle: z is the
    state in the coordinates of `tb.linearize` about the start, at the usual parameters, z_rest that
    of the arm at rest where the targets want its hinges, at their rates (`Task.resting`). The cost
    is that of `LQR`.

    Args:
        effort, speed_weight: of the cost

    Raises:
        ValueError: for a task without hinges that rest anywhere.
    """

    def __init__(self, env: BeamVectorEnv, effort: float = 0.01, speed_weight: float = 0.1) -> None:
        env = vector_env(env)
        scene, task = env.plant.scene, env.task
        if type(task).resting is Task.resting:
            raise ValueError(
                "a task without hinges that rest at any angle was given; LQR is there for it"
            )
        still = {name: env.high.new_zeros(size) for name, size in scene.inputs.items()}
        tip = (lambda s: s.position[..., -1, :], lambda s: s.velocity[..., -1, :])
        self.model = tb.linearize(scene, tb.rest(scene), tip, inputs=still)
        held = self.model.discrete(env.config.control_interval)
        B = torch.cat(
            [held.B[:, held.inputs[drive.input]] @ drive.gain.mT for drive in task.drives], -1
        )
        scale = 0.1 * task.length, task.speed[0].item() / speed_weight**0.5
        near = torch.cat((held.C[:3] / scale[0], held.C[3:] / scale[1]))
        self.K = delayed_gain(held.A, B, near.mT @ near, effort, env.config.delay)

    def act(self, observation: Tensor) -> Tensor:
        now = self.env.state
        z = self.model.departure(now.beam) - self.model.departure(self.env.task.resting(now))
        return -torch.cat((z, now.pending.flatten(1)), -1) @ self.K.mT


def delayed_gain(A: Tensor, B: Tensor, Q: Tensor, effort: float, delay: int) -> Tensor:
    """K of u = -K [z; pending actions], of actions (a) that act `delay` intervals later: least sum
    of z'Qz + effort |u|^2.
    """
    n, actions = B.shape
    whole = A.new_zeros(n + actions * delay, n + actions * delay)
    whole[:n, :n] = A
    acts = A.new_zeros(len(whole), actions)
    if delay:
        whole[:n, n : n + actions] = B
        whole[n:-actions, n + actions :] = torch.eye(actions * (delay - 1), dtype=A.dtype)
        acts[-actions:] = torch.eye(actions, dtype=A.dtype)
    else:
        acts[:n] = B
    cost = torch.zeros_like(whole)
    cost[:n, :n] = Q
    return gain(whole, acts, cost, effort * torch.eye(actions, dtype=A.dtype))


def gain(A: Tensor, B: Tensor, Q: Tensor, R: Tensor) -> Tensor:
    """K (m, n) of u = -K x that minimises the sum of x'Qx + u'Ru for x_{k+1} = A x_k + B u_k."""
    P = riccati(A, B, Q, R)
    return torch.linalg.solve(R + B.mT @ P @ B, B.mT @ P @ A)


def riccati(A: Tensor, B: Tensor, Q: Tensor, R: Tensor) -> Tensor:
    """P (n, n): x'Px is the least sum of x'Qx + u'Ru from x on.

    Solution of the discrete algebraic Riccati equation by structure-preserving doubling (Chu, Fan,
    Lin and Wang 2004): each round doubles the horizon. Raises ValueError where it does not
    converge: the model cannot be stabilised.
    """
    X, G, H = A, B @ torch.linalg.solve(R, B.mT), Q
    eye = torch.eye(len(A), dtype=A.dtype, device=A.device)
    for _ in range(DOUBLINGS):
        W = torch.linalg.solve(eye + G @ H, torch.cat((X, G), -1))
        V, Z = W.split(len(A), -1)  # (I + G H)^-1 X, (I + G H)^-1 G
        more = X.mT @ H @ V
        X, G, H = X @ V, G + X @ Z @ X.mT, H + (more + more.mT) / 2
        G = (G + G.mT) / 2
        if not torch.isfinite(H).all():
            break
        if more.abs().amax() <= 1e-12 * H.abs().amax():
            return H
    raise ValueError(
        f"a model of {len(A)} states was given for which Riccati's equation has no solution; one "
        "that the actions can stabilise is wanted"
    )
