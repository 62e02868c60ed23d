"""Estimated, AdaptiveMPC: controllers of the whole state and plant, on what a filter makes of the
readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.distributions import LogNormal, Normal
from torch.nn.functional import softplus

import torchbeam as tb

from .. import imperfections
from ..core import BeamVectorEnv
from ..episodes import Episodes
from ..plant import Plant
from ..task import Task
from .holding import Controller, vector_env
from .lqg import SENSOR, sensed
from .mpc import MPC

LAST = 0.2  # s, for which a disturbance of the actions lasts
FACTOR = 10.0  # from the largest down to the least, for which logarithms are estimated
SOFT = 12.0  # a parameter comes no nearer to zero than some of such a share of its range
SETTLING = 10  # intervals in which a plant is left to itself
STARTS = 64  # draws of the task's, where its episodes start differently
LATENCIES = 4  # candidates, evenly over their range, each of which is estimated from there
GATE = 1 - 1e-9  # probability of an error that is no fault of a sensor
ROWS = {"x": 1, "factor": 2, "log_likelihood": 0, "lately": 1, "missed": 1}  # axes of a sample's
LASTING = 8.0  # lags, for which an action is remembered


class Estimated(Controller):
    """Another controller, with estimates in place of the true state. It reads `env.state` as usual,
    but beam, plant and acting loads come from a `torchbeam.KalmanFilter`. The filter sees the
    sensors in the observation, and the actions. It estimates the parameters that the env draws, the
    sensors' bias and a disturbance of the actions. Candidates of the latency run side by side, and
    the most likely counts. The ranges of all these, and the targets, are known. All episodes begin
    at the known start.

    Args:
        controller: of the whole state (`LQR`), or of the whole plant (`MPC(informed=True)`)
        known: whether the plant, its latency, lag and gain are known: the state alone is estimated.
            The return then shows the best that the sensors allow
        modes: number of modes whose amplitudes are estimated
        disturbance: deviation of the disturbance of the actions: what the plant, with the
            parameters that are estimated, does not explain
        estimator: `tb.KalmanFilter`, or `tb.MovingHorizon` where all episodes start together
        ranges: name -> (low, high) of the parameters; None = the ranges from which the env draws.
            An estimate goes beyond by the range's width at most, of latency not at all
        gate: as in `torchbeam.KalmanFilter`: a reading so far off is left out

    `prepare` computes most of a decision before its observation arrives.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True, noise=0.005)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Estimated(baselines.LQR(env))
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(
        self,
        controller: Controller,
        *,
        known: bool = False,
        modes: int = 4,
        disturbance: float = 0.002,
        estimator: type[tb.KalmanFilter] = tb.KalmanFilter,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        gate: float | None = GATE,
    ) -> None:
        self.gate = gate
        self.controller, self.known, self.modes = controller, known, modes
        self.disturbance, self.estimator, self.ranges = disturbance, estimator, ranges

    def begin(self, env: Any) -> None:
        super().begin(env)
        self.controller.begin(env)
        self.z: tb.Filtered | None = None
        self.stands: tuple[Tensor, tb.Stepper] | None = None
        self.predicted: Any = None

    def restart(self, fresh: Tensor) -> None:
        self.controller.restart(fresh)

    def act(self, observation: Tensor) -> Tensor:
        env, now = self.env, self.env.state
        if self.z is None:
            self._begin()
        else:
            y = torch.where(self.heard, sensed(env, observation) * self.scale, math.nan)
            self.prepare()
            predicted, self.predicted = self.predicted, None
            self.z = self.filter.update(predicted, y)
            begun = now.steps == 0
            over = now.done if self.z.window is None else torch.zeros_like(begun)
            if (fresh := begun | over).any():  # what is over goes on nowhere
                self._begin(fresh)
            if predicted.after is not None and not begun.any():
                z = self.z.x[self._likely()][:, : self.filter.moves]
                self.controller.arrive(z - predicted.after.z[self.foreseen])
        env.set_state(self.believed())
        try:
            action = self.controller.act(observation).clamp(-1, 1)
        finally:
            env.set_state(now)
        self.asked = torch.cat((action[:, None], self.asked[:, :-1]), 1)
        return action

    @torch.no_grad()
    def prepare(self) -> None:
        """Predict the next observation; the controller prepares its decision about it."""
        if self.z is None or self.predicted is not None:
            return
        self.predicted = self.filter.predict(self.z, self.asked.flatten(1))
        after, about = self.predicted.after, self.predicted.about
        if after is None:
            return
        at = self.foreseen = self._likely()
        beam, place = after.state[at], after.places[1]
        place = place._make(part[at] for part in place)

        def changed(z: Tensor) -> tb.State:
            return self.filter.interval.changed(beam, z, place)

        now = self._now(self.predicted.x[at], beam, None if about is None else about[at])
        if (w := now.pending.shape[1]) or now.late is not None:
            waits = self.asked[:, : self.env.simulation.spare + w].flip(1)
            late = None if now.late is None else waits[:, : waits.shape[1] - w]
            now = replace(now, late=late, pending=waits[:, waits.shape[1] - w :])
        self.controller.expect(now, changed, self.filter.moves)

    def _likely(self) -> tuple[Tensor, Tensor]:
        """Where the most likely latencies stand among the estimates of the episodes (n,)."""
        likely = self.z.log_likelihood.nan_to_num(nan=-math.inf).argmax(0)
        return likely, torch.arange(len(likely), device=likely.device)

    def believed(self) -> Episodes:
        """The episodes (n,), by the most likely latencies."""
        at, about = self._likely(), self.z.about
        return self._now(self.z.x[at], self.z.state[at], None if about is None else about[at])

    def _now(self, x: Tensor, beam: tb.State, about: Tensor | None) -> Episodes:
        """The episodes as estimates x (n, size), and the structure at `about`, say."""
        now, own, params = self.env.state, self.filter.unknowns, dict(self.told)
        x = x[:, self.filter.moves :]
        if own.of_model:
            params |= self.values(own.given(x[:, : own.of_model]))
            params["latency"] = params["latency"].clamp(*self.late)
        plant = now.plant if self.known else self._plant(params, x if about is None else about)
        return replace(now, plant=plant, beam=beam, acting=self.acting(params, self.asked))

    def _plant(self, params: dict[str, Tensor], about: Tensor) -> Plant:
        """Of these parameters; of its beam, that of those of coordinates `about` (n, p, ...), at
        which the filter's structure stands, and the last one where it is that.
        """
        f = self.filter
        if not f.unknowns.of_model:
            return Plant(params, f.interval.stepper)
        stands, stepper = self.stands or (None, None)
        if stands is None or not stands.equal(about):
            scene = self._scene(f.unknowns.given(about[:, : f.unknowns.of_model]))
            stepper = tb.Stepper(scene, f.interval.stepper.dt, self.method)
            self.stands = about, stepper
        return Plant(params, stepper)

    def acting(self, params: dict[str, Tensor], asked: Tensor) -> Tensor:
        """Acting actions (..., a), before the gain, from commands (..., H, a), the last first."""
        config, latency = self.env.config, params["latency"].clamp(*self.late)
        due, spare = asked[..., config.delay :, :], self.env.simulation.spare
        return imperfections.acting(due, latency, params["lag"], config.control_interval, spare)

    def drive(self, params: dict[str, Tensor], asked: Tensor) -> dict[str, Tensor]:
        """Inputs by name for commands (..., H a)."""
        params = self.told | self.values(params)
        asked = asked.unflatten(-1, (-1, self.env.task.actions))
        return self.env.task.inputs(params["gain"][..., None] * self.acting(params, asked))

    def values(self, coordinates: dict[str, Tensor]) -> dict[str, Tensor]:
        """Parameters of their coordinates in the filter: above zero, and else the same."""
        return {
            name: softplus(x / self.soft[name]) * self.soft[name] if name in self.soft else x
            for name, x in coordinates.items()
        }

    def _scene(self, coordinates: dict[str, Tensor]) -> tb.Scene:
        return self.scene(self.values(coordinates))

    def scene(self, params: dict[str, Tensor]) -> tb.Scene:
        """Of parameters by name; the others as usual."""
        env = self.env
        row, usual = env.simulation.members[:1], env.simulation.usual
        return env.task.scene(usual | params, row, env.simulation.varying).to(env.dtype)

    def _begin(self, fresh: Tensor | None = None) -> None:
        """The filter, and what is known at the start of the episodes in the mask (n,), None = all;
        the others go on.
        """
        env, now = self.env, self.env.state
        if fresh is None or (self.known and (now.steps == 0).any()):
            self._make(env)
        start = self.whole.state_at(self.whole.departure(now.start))  # held as the model's is
        shape = len(self.latencies), env.num_envs
        first = self.filter.start(shape, state=start, covariance=self.covariance)
        if "latency" in (names := self.filter.unknowns.names):
            first.x[..., self.filter.moves + names.index("latency")] = self.latencies[:, None]
        if fresh is None or fresh.all():
            self.z = first
            self.asked = env.high.new_zeros(env.num_envs, self.memory, env.task.actions)
            return
        if self.z.window is not None:
            raise ValueError(
                "episodes that begin one by one were given to Estimated with tb.MovingHorizon; "
                "tb.KalmanFilter, or autoreset_mode='Disabled', is wanted"
            )
        rows = {
            name: torch.where(fresh.reshape(-1, *axes * [1]), a, b)
            for name, axes in ROWS.items()
            for a, b in [(getattr(first, name), getattr(self.z, name))]
        }
        if (about := self.z.about) is not None:
            start = first.x[..., self.filter.moves :][..., : about.shape[-1]]
            rows["about"] = torch.where(fresh[:, None], start, about)
        self.z = replace(self.z, state=first.state.where(fresh, self.z.state), **rows)
        self.asked = torch.where(fresh[:, None, None], 0.0, self.asked)

    def _make(self, env: BeamVectorEnv) -> None:
        simulation, config, task = env.simulation, env.config, env.task
        drawn = simulation.ranges if self.ranges is None else self.ranges
        if task.settles and not task.STARTS_ALIKE and not self.known:
            raise ValueError(
                f"{type(task).__name__} was given, each of whose plants starts in an equilibrium "
                "of its own; known=True, or no gravity, is wanted"
            )
        own = {n: r for n, r in drawn.items() if n not in imperfections.PARAMETERS}
        self.scale, self.method = env.scale, config.method
        self.soft = {
            name: (high - low) / SOFT
            for name, (low, high) in drawn.items()
            if name != "latency" and not _by_logarithm(low, high)
        }
        self.late, self.latencies = drawn.get("latency", (0.0, math.inf)), env.high.new_zeros(1)
        if self.known:
            self.told, scene, parameters = env.state.plant.params, env.state.plant.scene, {}
        else:
            self.told, scene = simulation.usual, self._scene if own else env.plant.scene
            parameters = {n: _prior(*r) for n, r in drawn.items() if n not in ("latency", "bias")}
            if "latency" in drawn:
                ends = torch.linspace(*self.late, LATENCIES + 1, dtype=torch.float64).to(env.high)
                self.latencies = (ends[1:] + ends[:-1]) / 2
                law = Normal(ends.mean(), (ends[1] - ends[0]) / 2)
                parameters["latency"] = tb.Parameter(ends.mean(), bounds=self.late, prior=law)
        slowest = max(drawn.get("lag", (0.0,))) if not self.known else float(self.told["lag"].max())
        lasting = math.ceil(LASTING * slowest / config.control_interval)
        self.memory = config.delay + simulation.spare + 2 + lasting
        means = {name: torch.as_tensor(_prior(*bounds).start) for name, bounds in own.items()}
        usual = self.scene({name: x.to(env.dtype) for name, x in means.items()})
        still = {name: env.high.new_zeros(size) for name, size in usual.inputs.items()}
        rest = simulation.rest[0][0]
        if task.HOLDS:  # else a hub that turns
            rest = tb.equilibrium(usual, inputs=still)
        self.whole = tb.linearize(usual, rest, inputs=still)
        model = self.whole.reduced(min(self.modes, self.whole.A.shape[-1] // 2))
        bias = drawn["bias"][1] / 3**0.5 if "bias" in drawn else 0.0
        self.filter = self.estimator(
            scene,
            env.sensors,
            dt=config.control_interval,
            noise=self.scale * max(config.noise, SENSOR),
            bias=self.scale * bias,
            parameters=parameters or None,
            process={
                drive.input: (self.disturbance * drive.gain.abs().sum(0), LAST)
                for drive in task.drives
            },
            steps=config.substeps,
            model=model,
            method=config.method,
            drive=self.drive,
            second_order=False,  # the returns on record are without
            gate=self.gate,
        )
        self.heard = self._heard(own)
        self.covariance = None
        if type(task).initial_state is not Task.initial_state:
            streams = [np.random.default_rng(k) for k in range(STARTS)]
            goals = task.sample_goal(streams, torch.arange(STARTS))
            z = model.departure(task.initial_state(rest.broadcast((STARTS,)), goals))
            self.covariance = z.mT @ z / STARTS

    def _heard(self, own: dict[str, tuple[float, float]]) -> Tensor:
        """(m,) bool: readings of which the motion that is not estimated is less than their noise,
        in plants of parameters between these that are left to themselves. No filter follows the
        phase of what is quicker than its readings.
        """
        env, f = self.env, self.filter
        stream = np.random.default_rng(0)
        draws = {
            name: torch.as_tensor(stream.uniform(*bounds, STARTS), dtype=env.dtype)
            for name, bounds in own.items()
        }
        step = tb.Stepper(self.scene(draws), f.interval.stepper.dt, self.method)
        state = env.state.start[:1]
        read, state = env.simulation.observer.sensors(state), state.broadcast((STARTS,))
        still = {name: env.high.new_zeros(size) for name, size in step.scene.inputs.items()}
        beside = []
        for _ in range(SETTLING):
            for _ in range(f.interval.steps):
                state = step(state, inputs=still)
            follows = f.interval.model.state_at(f.interval.model.departure(state))
            beside.append(read(state) - read(follows))
        return torch.stack(beside).square().mean((0, 1)).sqrt() < f.interval.instruments.noise


def _by_logarithm(low: float, high: float) -> bool:
    """Whether a number between these is estimated by its logarithm: where it is not near zero."""
    return low * FACTOR > high


def _prior(low: float, high: float) -> tb.Parameter:
    """Of a number that is drawn evenly between these: mean and variance of what is estimated, which
    comes no farther beyond than these are apart.
    """
    wide = torch.tensor(max(high - low, 1e-3 * high), dtype=torch.float64)
    if not _by_logarithm(low, high):
        mean = (low + high) / 2 + 0 * wide
        ends = (low - wide, low + 2 * wide)
        return tb.Parameter(mean, bounds=ends, prior=Normal(low + wide / 2, wide / 12**0.5))
    log, ratio = math.log(low) + 0 * wide, ((low + wide) / low).log()
    mean = log + (low + wide) / wide * ratio - 1
    variance = 1 - low * (low + wide) * (ratio / wide) ** 2
    return tb.Parameter(
        mean.exp(),
        transform="log",
        bounds=((log - ratio).exp(), (log + 2 * ratio).exp()),
        prior=LogNormal(mean, variance.sqrt()),
    )


class AdaptiveMPC(Estimated):
    """`MPC` by the plant that is estimated while it is controlled: see `Estimated`.

    Args:
        horizon: intervals
        known, modes, disturbance, estimator, ranges, gate: as in `Estimated`
        terminal, iterations, damping: as in `MPC`

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True, noise=0.005)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.AdaptiveMPC(env, horizon=5)
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
        known: bool = False,
        modes: int = 4,
        disturbance: float = 0.002,
        estimator: type[tb.KalmanFilter] = tb.KalmanFilter,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        gate: float | None = GATE,
    ) -> None:
        inner = MPC(
            vector_env(env), horizon, iterations=iterations, terminal=terminal, damping=damping,
            informed=True,
        )  # fmt: skip
        super().__init__(
            inner, known=known, modes=modes, disturbance=disturbance, estimator=estimator,
            ranges=ranges, gate=gate,
        )  # fmt: skip
