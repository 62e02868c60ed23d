"""LQG, JointLQG: the feedback of LQR on what a Kalman filter makes of the observation, which also
estimates a disturbance of the actions and cancels it: integral action.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from .holding import vector_env
from .linear import EFFORT, LQR, JointLQR, amount, times
from .riccati import riccati

# standard deviations that a filter reckons with: of readings without noise; of the actions
SENSOR, ACTION = 1e-3, 0.1
STEP = 1e-5  # of differences, in units of z (m, rad; with rates times a second)


class Noise:
    """What a filter reckons with: white noise of `readings` on each reading and of `action` on each
    action, and a disturbance of the actions that walks at random by `disturbance` an interval.
    """

    def __init__(self, readings: float, action: float, disturbance: float) -> None:
        amount("action", action)
        amount("disturbance", disturbance, zero=True)
        self.readings, self.action, self.disturbance = readings, action, disturbance

    def model(self, A: Tensor, B: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """A, B of [z; disturbance of the actions], or of z alone without, and the covariance of
        what an interval adds to them.
        """
        Q = self.action**2 * B @ B.mT
        if not self.disturbance:
            return A, B, Q
        a, eye = B.shape[-1], torch.eye(B.shape[-1], dtype=B.dtype, device=B.device)
        whole = torch.block_diag(A, eye)
        whole[:-a, -a:] = B
        walk = torch.block_diag(Q, self.disturbance**2 * eye)
        return whole, torch.cat((B, torch.zeros_like(eye))), walk


class LQG(LQR):
    """LQR on the estimate of a steady Kalman filter, which reads the observation alone.

    It estimates z of the same linear models, from the env's sensors and its own actions. It starts
    at the true state: at rest, undeflected.

    With a `disturbance` above 0 the filter assumes that a constant addition to the actions explains
    the misfit of its model, and the feedback subtracts it. This is integral action, one for each
    action, which does not wind up at their limits. Errors that no action resembles (another
    stiffness of the whole beam) leave an offset all the same.

    Args:
        effort, speed_weight, latency, schedule: as in `LQR`
        action: standard deviation of the white noise on each action in the filter; on each reading
            it is the env's `noise`, at least 1e-3
        disturbance: standard deviation of the change of the disturbance in an interval; 0 = none

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.LQG(env)
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
        action: float = ACTION,
        disturbance: float = 0.0,
    ) -> None:
        super().__init__(env, effort, speed_weight, latency=latency, schedule=schedule)
        env = vector_env(env)
        self.noise = Noise(max(env.config.noise, SENSOR), action, disturbance)
        R = self.noise.readings**2 * torch.eye(self.C.shape[-2]).to(self.C)
        gains = []
        for A, B, C in zip(self.A, self.B, self.C, strict=True):
            A, B, Q = self.noise.model(A, B)
            C = torch.nn.functional.pad(C, (0, len(A) - C.shape[-1]))
            # covariance of the prediction
            P = riccati(A.mT, C.mT, Q, R)
            # what a reading says of z and of the disturbance
            gains.append(torch.linalg.solve(C @ P @ C.mT + R, C @ P).mT)
        self.M = torch.stack(gains)

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.z = self._starts()  # the prediction of now
        self.d = self.env.high.new_zeros(self.env.num_envs, self.env.task.actions)

    def restart(self, fresh: Tensor) -> None:
        super().restart(fresh)
        self.z = torch.where(fresh[:, None], self._starts(), self.z)
        self.d = torch.where(fresh[:, None], 0.0, self.d)

    def _starts(self) -> Tensor:
        """(n, z): where the episodes start."""
        return self.whole(self.env.state.start) @ self.decode.mT

    def act(self, observation: Tensor) -> Tensor:
        env, at = self.env, self.schedule.at
        hold, still, rates, readings = self.reference()
        z, now = self.z - still - rates, hold[:, 0]
        error = sensed(env, observation) - readings - times(at(now, self.C), z)
        change = times(at(now, self.M), error)
        z = z + change[:, : z.shape[-1]]
        if self.noise.disturbance:
            self.d = self.d + change[:, z.shape[-1] :]
        action = (self.feedback(hold, z) - self.d).clamp(-1, 1)
        acts = self.late.give(env.state.pending, action)[:, 0] - now + self.d
        # the equilibrium stays where it is under its own action: still = A still + B hold, whatever
        # the amplitude
        self.z = still + times(at(now, self.A), z + rates) + times(at(now, self.B), acts)
        return action


class JointLQG(JointLQR):
    """JointLQR on the estimate of an extended Kalman filter, which reads the observation alone.

    It uses the env's sensors, and the errors of the hinges' angles and rates in the observation
    (`Task.tracking_error`). Its model is JointLQR's, whose coordinates turn with the arm. Readings
    and their derivatives are evaluated at the estimate itself. It starts at the true state.

    Args:
        effort, speed_weight, latency: as in `JointLQR`
        action, disturbance: as in `LQG`

    Examples:
        >>> env = envs.SlewVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.JointLQG(env)
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
        action: float = ACTION,
        disturbance: float = 0.0,
    ) -> None:
        super().__init__(env, effort, speed_weight, latency=latency)
        self.noise = Noise(max(vector_env(env).config.noise, SENSOR), action, disturbance)
        self.whole, self.acts, self.Q = self.noise.model(self.A, self.B)

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.x, self.P = self._starts()
        for name in ("hinges", "turns"):
            self.__dict__.pop(name, None)

    def restart(self, fresh: Tensor) -> None:
        super().restart(fresh)
        x, P = self._starts()
        self.x = torch.where(fresh[:, None], x, self.x)
        self.P = torch.where(fresh[:, None, None], P, self.P)

    def _starts(self) -> tuple[Tensor, Tensor]:
        """[z; disturbance] (n, x) where the episodes start, and its covariance (n, x, x)."""
        z = self.model.departure(self.env.state.start)
        x = torch.nn.functional.pad(z, (0, len(self.whole) - z.shape[-1]))
        return x, self.Q.expand(len(x), -1, -1)

    @cached_property
    def hinges(self) -> Tensor:
        """(e, z): derivatives of the hinges' errors and of their rates by z, the same everywhere:
        their turns are coordinates.
        """
        size = len(self.A)
        moves = STEP * torch.eye(size, dtype=self.A.dtype, device=self.A.device)
        return torch.stack([(self._errors(m) - self._errors(-m)) / (2 * STEP) for m in moves], -1)

    @cached_property
    def turns(self) -> Tensor:
        """(z, k): moves that turn a hinge each, its error growing by 1 rad, and rest there."""
        at = self.hinges[: len(self.hinges) // 2]
        loose = torch.linalg.svd(self.A - torch.eye(len(self.A)).to(self.A))[2][-len(at) :].mT
        return loose @ torch.linalg.inv(at @ loose)

    def _within_a_turn(self, z: Tensor) -> Tensor:
        """z (n, z), whole turns of hinges less: those are no coordinates of a state."""
        errors = z @ self.hinges[: len(self.hinges) // 2].mT
        return z - 2 * math.pi * torch.round(errors / (2 * math.pi)) @ self.turns.mT

    def _errors(self, z: Tensor) -> Tensor:
        """(e,) of the first episode, with its beam at z."""
        now = self.env.state
        beam = self.model.state_at(z.expand(self.env.num_envs, -1))
        now = replace(now, beam=beam)
        now = replace(now, measures=self.env.task.measures(now))
        return torch.cat(self.env.task.tracking_error(now), -1)[0]

    def readings(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """(n, s) of the sensors, without noise, in states z (n, z), and derivatives (n, s, z)."""
        simulation, now = self.env.simulation, self.env.state
        with torch.enable_grad():
            z = z.detach().requires_grad_()
            seen = simulation.observer.read(
                self.model.state_at(z), now.start, self.env.task.of(now, simulation.observer.scale)
            )
            slopes = [
                torch.autograd.grad(one.sum(), z, retain_graph=True)[0] for one in seen.unbind(-1)
            ]
        return seen.detach(), torch.stack(slopes, 1)

    def act(self, observation: Tensor) -> Tensor:
        env, size = self.env, len(self.A)
        z, rest = self.x[:, :size], self.resting()
        seen, slopes = self.readings(z)
        errors = torch.cat(env.task.tracking_error(env.state), -1)
        away = errors - (z - rest) @ self.hinges.mT
        angles, rates = away.split(away.shape[-1] // 2, -1)
        angles = angles - 2 * math.pi * torch.round(angles / (2 * math.pi))  # read modulo a turn
        gap = torch.cat((sensed(env, observation) - seen, angles, rates), -1)
        C = torch.cat((slopes, self.hinges.expand(len(z), -1, -1)), 1)
        C = torch.nn.functional.pad(C, (0, len(self.whole) - size))
        R = torch.cat(
            (torch.full_like(seen[0], self.noise.readings), torch.full_like(errors[0], SENSOR))
        )
        CP = C @ self.P
        M = torch.linalg.solve(CP @ C.mT + torch.diag(R**2), CP).mT
        x = self.x + times(M, gap)
        P = self.P - M @ CP
        d = x[:, size:]
        action = self.feedback(x[:, :size] - rest)
        action = (action - d if d.shape[-1] else action).clamp(-1, 1)
        acts = self.late.give(env.state.pending, action)[:, 0]
        x = x @ self.whole.mT + acts @ self.acts.mT
        self.x = torch.cat((self._within_a_turn(x[:, :size]), x[:, size:]), -1)
        P = self.whole @ P @ self.whole.mT + self.Q
        self.P = (P + P.mT) / 2
        return action


def sensed(env: BeamVectorEnv, observation: Tensor) -> Tensor:
    """(n, s): what the sensors show, of a whole observation (n, o)."""
    size = env.sensors.size
    first = observation.shape[-1] - env.state.pending[0].numel() - size
    return observation[:, first : first + size]
