"""Configuration common to all environments: the keywords of `gymnasium.make`, checked once."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch

import torchbeam as tb
from torchbeam.extend import ENGINES, FORMS, METHODS, ODE_METHODS, choice, count, shown

from .actuators import Actuator
from .parameters import numbers
from .plant import check_solver, section_named
from .sensors import Observed, check_names


@dataclass(frozen=True, kw_only=True)
class BeamEnvConfig:
    """The keywords that every task takes; tasks add their own.

    Defaults are those of `torchbeam/TipReach-v1`.

    Args:
        length: m, of a straight beam from the origin
        elements: of it, at least 2
        section: `torchbeam.Section`, or "aluminium strip" or "silicone rod" (see `envs/plant.py`).
            Its device is the simulation's. Batch axes (num_envs,) give each sub-env its own section
        direction: of the beam, frame a
        up: direction that determines the section's z axis; None: z, for a beam along z x
        beam: in place of the five above: a `torchbeam.Beam` of any shape; batch axes likewise
        supports: `torchbeam.Support`s; None = the task's own: clamped at node 0
        damping: s, or None; tau in [F; M] = S^-1 (strain + tau strain rate)
        gravity: (3,) m/s^2 in frame a, or None
        planar: motion, actions and observation in the plane of the task alone; gravity across it is
            ignored
        force: N at an action of 1, along the tip section's y and z axes (in a plane: its own axis)
        actuators: in place of the task's own, for instance that force: one or more `Actuator`s
        delay: control intervals from an action to its effect
        control_interval: s
        substeps: calls of the stepper in one interval
        accuracy: in place of elements and substeps, which it then determines: relative error of the
            tip's path under random actions, see `torchbeam.converge`
        form, method: "nodal" and "midpoint" (implicit); or, for a soft section, a form and a method
            of torchdiffeq as in `torchbeam.ExplicitStepper`
        solver: more arguments for the stepper, by name
        dtype: torch.float32 for motion in single precision; None = float64
        engine: of the implicit methods: "auto", "eager" or "compiled" (native code), see
            `torchbeam.Stepper`
        sensors: one or more of "tip", "middle", "gauges", "full" (see `envs/sensors.py`), and
            `Observed` sensors; None in a task with its own sensors
        noise: standard deviation of white noise on each entry of the sensors, in units of the
            observation
        frames: observations side by side, the oldest first, one control interval apart; after a
            reset all are the first one
        randomize: parameters drawn uniformly at each reset, from the sub-env's generator: name ->
            (low, high); True = every parameter, from its documented range; None
        control_cost: per interval and |action|^2
        failure_reward: of the interval in which the solver or the task fails. None = so low that
            going on is never worse: for this interval and each that the time limit leaves, the
            largest cost of one (`Task.worst_cost`)
        max_episode_steps: None = no end
        params_in_info: whether `info["params"]` has the varying parameters at each step. Policies
            must not know them, and wrappers that log `info` write them down. None = True, with a
            DeprecationWarning; False from the next minor version on

    Examples:
        >>> config = envs.BeamEnvConfig(elements=2, planar=True, sensors=("tip", "gauges"))
        >>> sim = envs.functional.Simulation(envs.Task(config), 2)
        >>> envs.functional.reset(sim, seed=0).observation.shape
        torch.Size([2, 7])
    """

    length: float = 1.5
    section: tb.Section | str = "aluminium strip"
    elements: int = 6
    direction: Sequence[float] = (1.0, 0.0, 0.0)
    up: Sequence[float] | None = None
    beam: tb.Beam | None = None
    supports: Sequence[tb.Support] | None = None
    damping: float | None = 1e-3
    gravity: Sequence[float] | None = (0.0, 0.0, -9.81)
    planar: bool = False
    force: Sequence[float] = (1.2, 2.0)
    actuators: Actuator | Sequence[Actuator] | None = None
    delay: int = 1
    control_interval: float = 0.02
    substeps: int = 2
    accuracy: float | None = None
    form: str = "nodal"
    method: str = "midpoint"
    solver: Mapping[str, Any] | None = None
    dtype: torch.dtype | None = None
    engine: str = "auto"
    sensors: str | Observed | Sequence[str | Observed] = ("tip", "middle")
    noise: float = 0.0
    frames: int = 1
    randomize: bool | Mapping[str, Sequence[float]] | None = None
    control_cost: float = 1e-3
    failure_reward: float | None = None
    max_episode_steps: int | None = 50
    params_in_info: bool | None = None

    def __post_init__(self) -> None:
        for name, least in (("substeps", 1), ("elements", 2), ("delay", 0), ("frames", 1)):
            count(name, getattr(self, name), least)
        if self.max_episode_steps is not None:
            count("max_episode_steps", self.max_episode_steps, 1)
        if self.failure_reward is not None:
            self.check_numbers("failure_reward")
        self.check_numbers("control_interval", "length", above=0.0)
        self.check_numbers("control_cost", "noise", least=0.0)
        if self.accuracy is not None:
            self.check_numbers("accuracy", above=0.0, most=0.5)
        if self.damping is not None:
            self.check_numbers("damping", least=0.0)
        gravity = np.zeros(3) if self.gravity is None else numbers("gravity", self.gravity)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise ValueError(
                f"gravity = {shown(self.gravity)} was given; three finite numbers (m/s^2) are "
                "wanted, or None"
            )
        if not isinstance(self.planar, (bool, np.bool_)):
            raise ValueError(f"planar = {shown(self.planar)} was given; True or False is wanted")
        if not (self.params_in_info is None or isinstance(self.params_in_info, (bool, np.bool_))):
            raise ValueError(
                f"params_in_info = {shown(self.params_in_info)} was given; True, False or None "
                "is wanted"
            )
        force = numbers("force", self.force)
        if (
            force.ndim != 1
            or len(force) not in (1, 2)
            or not ((force > 0) & np.isfinite(force)).all()
        ):
            raise ValueError(
                f"force = {shown(self.force)} was given; two positive finite numbers (N, along y "
                "and z) are wanted"
            )
        known = (type(None), torch.dtype)
        if not isinstance(self.dtype, known) or self.dtype not in (
            None,
            torch.float32,
            torch.float64,
        ):
            raise ValueError(
                f"dtype = {shown(self.dtype)} was given; torch.float32 or torch.float64 is wanted"
            )
        self._check_beam()
        self._check_method()
        if not (self.randomize is None or isinstance(self.randomize, (bool, Mapping))):
            raise ValueError(
                f"randomize = {shown(self.randomize)} was given; True, None or a dictionary of "
                "(low, high) is wanted"
            )
        if self.sensors is not None:
            check_names(self.sensors, self.form)
        if self.actuators is not None:
            given = (self.actuators,) if isinstance(self.actuators, Actuator) else self.actuators
            if (
                not isinstance(given, Sequence)
                or not given
                or not all(isinstance(a, Actuator) for a in given)
            ):
                raise ValueError(
                    f"actuators = {shown(self.actuators)} was given; one or more "
                    "torchbeam_envs.Actuator are wanted"
                )
            object.__setattr__(self, "actuators", tuple(given))

    def _check_beam(self) -> None:
        section_named(self.section)
        for name in ("direction", "up"):
            vector = (
                np.ones(3) if getattr(self, name) is None else numbers(name, getattr(self, name))
            )
            if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
                raise ValueError(
                    f"{name} = {shown(getattr(self, name))} was given; three finite numbers, not "
                    "all zero, are wanted"
                )
        if self.beam is None:
            return
        if not isinstance(self.beam, tb.Beam):
            raise ValueError(
                f"beam = {type(self.beam).__name__} was given; a torchbeam.Beam is wanted"
            )
        if self.beam.station_count < 2:
            raise ValueError("a beam of one element was given; at least 2 are wanted")
        beside = [
            f.name
            for f in fields(self)
            if f.name in ("length", "section", "elements", "direction", "up")
            and getattr(self, f.name) is not f.default
            and getattr(self, f.name) != f.default
        ]
        if beside:
            raise ValueError(f"beam and {' and '.join(beside)} were given; the beam has its own")

    def _check_method(self) -> None:
        choice("form", self.form, FORMS)
        methods = (*(METHODS if self.form == "nodal" else ()), *ODE_METHODS)
        if not isinstance(self.method, str) or self.method not in methods:
            raise ValueError(
                f"method = {shown(self.method)} with form = {shown(self.form)} was given; there "
                f"are {', '.join(methods)}"
            )
        if self.form != "nodal" and self.gravity is not None:
            raise ValueError(
                f"gravity with form = {shown(self.form)} was given; it starts undeformed: "
                "gravity=None is wanted"
            )
        choice("engine", self.engine, ENGINES)
        if self.engine == "compiled" and self.method not in METHODS:
            raise ValueError(
                f"engine = 'compiled' with method = {shown(self.method)} was given; 'midpoint' "
                "takes it"
            )
        if self.solver is not None:
            check_solver(self.form, self.method, self.solver)

    @property
    def intervals(self) -> int:
        """In an episode; where nothing ends it, as many as the task has by default."""
        usual = type(self).max_episode_steps or BeamEnvConfig.max_episode_steps
        return self.max_episode_steps or usual

    def is_given(self, name: str) -> bool:
        """Whether a keyword differs from its default."""
        value, usual = getattr(self, name), type(self).__dataclass_fields__[name].default
        return value is not usual and (type(value) is not type(usual) or value != usual)

    def check_numbers(
        self,
        *names: str,
        least: float = -math.inf,
        above: float = -math.inf,
        most: float = math.inf,
    ) -> None:
        """ValueError unless each of these is one finite real number within the bounds."""
        for name in names:
            value = getattr(self, name)
            if not is_number(value) or not (least <= value <= most and value > above):
                wanted = (
                    "a finite number"
                    if least == above == -math.inf
                    else (
                        "a finite non-negative number" if least == 0 else "a positive finite number"
                    )
                )
                wanted += "" if most == math.inf else f" up to {most:g}"
                raise ValueError(f"{name} = {shown(value)} was given; {wanted} is wanted")


def is_number(value: Any) -> bool:
    """Whether it is one finite real number."""
    return (
        isinstance(value, (int, float, np.integer, np.floating))
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )
