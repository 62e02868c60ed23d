"""Trials: a scene solved by settings, each once, with what it gave and took."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.derivatives import no_derivatives
from ...dynamics.simulate import simulate
from ...scene.effects import PerInterval
from ...scene.scene import Scene
from .reading import Reader
from .setting import Setting

END = 4  # nodes that a step of a beam without any would cost as much as, see `Trials.work`
SPAN = 1e-6  # of a step: how much longer an interval may be than a whole number of them


@dataclass(frozen=True)
class Trial:
    """One setting, tried. reading (time, ..., *) or (..., *); failed (...) samples; seconds of CPU
    time, without that of compiling; iterations of Newton's method, the mean of the samples (None =
    not counted).
    """

    setting: Setting
    reading: Tensor
    failed: Tensor
    seconds: float
    iterations: float | None
    result: Any


@dataclass
class Trials:
    """Runs settings of a problem and remembers them.

    mesh     (setting) -> the scene on its mesh
    t        (time,) s; None = statics, by `solve` of the scene
    share    of the samples in which an error has to be so small
    options  of `simulate` beside method and step; `initial` may be a function of the scene
    report   is called with the number of trials and a setting before it is run
    seconds  of CPU time that all runs may take
    """

    mesh: Callable[[Setting], Scene]
    reader: Reader
    t: Tensor | None
    solve: Callable[[Scene], Any] | None
    share: float
    options: dict[str, Any]
    report: Callable[[int, Setting], None] | None = None
    seconds: float = math.inf
    made: dict[Setting, Trial] = field(default_factory=dict)
    warm: set[tuple[str, str | None]] = field(default_factory=set)
    counts: dict[float, int] = field(default_factory=dict)  # of steps, by their length
    rates: dict[tuple[int, int], dict] = field(default_factory=dict)  # see `_rates`
    least: float = math.inf  # CPU s of a run of one step, which is setting up

    def __call__(self, setting: Setting) -> Trial:
        if setting not in self.made:
            if self.report is not None:
                self.report(len(self.made), setting)
            self.made[setting] = self._run(setting)
        return self.made[setting]

    def difference(self, setting: Setting, reference: Setting) -> float:
        """The relative error that `share` of the samples do not exceed; inf where a run failed."""
        return self.apart(self(setting), self(reference))

    def apart(self, trial: Trial, reference: Trial) -> float:
        """The same of two trials."""
        count = None if self.t is None else len(self.t)
        errors = self.reader.errors(trial.reading, reference.reading, count)
        failed = trial.failed | reference.failed
        errors = torch.where(failed if errors.ndim else failed.any(), math.inf, errors).flatten()
        return errors.kthvalue(max(1, math.ceil(self.share * errors.numel() - 1e-9))).values.item()

    def step_count(self, step: float | None) -> int:
        """How many steps of a length the instants ask for."""
        if step is None or self.t is None:
            return 1
        if step not in self.counts:
            self.counts[step] = sum(
                max(1, math.ceil(gap / step - SPAN)) for gap in self.t.diff().tolist()
            )
        return self.counts[step]

    def work(self, setting: Setting) -> float:
        """What a setting's time grows with: steps times nodes, and some more for what a step costs
        whatever their number.
        """
        return self.step_count(setting.step) * (setting.intervals + END)

    def cost(self, setting: Setting) -> float:
        """CPU seconds of a setting: measured, or predicted from the trial of its element and method
        that is nearest in its number of steps; of a pair that was not tried by those of its method
        and of its element.
        """
        if setting in self.made:
            return self.made[setting].seconds
        return self.least + self.work(setting) * self._rate(setting)

    def allowed(self, *settings: Setting, part: float = 1.0) -> bool:
        """Whether there is time for these, as predicted, in a part of the seconds."""
        if not self.made:
            return True
        spent = sum(trial.seconds for trial in self.made.values())
        more = sum(self.cost(s) for s in settings if s not in self.made)
        return spent + more <= part * self.seconds

    def _rate(self, setting: Setting) -> float:
        """CPU seconds a unit of work."""
        element, method, steps = setting.element, setting.method, self.step_count(setting.step)
        rates = self._rates(steps)
        if (element, method) in rates:
            return rates[element, method]
        by_method = {e: rate for (e, m), rate in rates.items() if m == method}
        by_element = {m: rate for (e, m), rate in rates.items() if e == element}
        pairs = [
            rate * by_method[e] / rates[e, m]
            for m, rate in by_element.items()
            for e in by_method
            if (e, m) in rates
        ]
        return min(pairs or [*by_method.values(), *by_element.values()] or rates.values())

    def _rates(self, steps: int) -> dict[tuple[str, str | None], float]:
        """By element and method, of those trials that are nearest to so many steps, of these the
        one with most work.
        """
        if (key := (len(self.made), steps)) in self.rates:
            return self.rates[key]

        def nearness(trial: Trial) -> tuple[float, float]:
            ratio = self.step_count(trial.setting.step) / steps
            return -abs(math.log(ratio)), self.work(trial.setting)

        rates = {}
        for trial in sorted(self.made.values(), key=nearness):  # the last one stays
            spent = max(trial.seconds - self.least, 1e-2 * self.least)
            name = trial.setting.element, trial.setting.method
            rates[name] = spent / self.work(trial.setting)
        self.rates = {k: v for k, v in self.rates.items() if k[0] == len(self.made)}
        self.rates[key] = rates
        return rates

    def _run(self, setting: Setting) -> Trial:
        with no_derivatives(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of samples that failed
            scene = self.mesh(setting)
            kind = setting.element, setting.method
            if kind not in self.warm:  # compile what the kind of setting runs by
                self.warm.add(kind)
                repeats = 2 if math.isinf(self.least) else 1
                for _ in range(repeats):
                    begun = time.process_time()
                    self._solve(scene, setting, short=True)
                    self.least = min(self.least, time.process_time() - begun)
            begun = time.process_time()
            result = self._solve(scene, setting)
            reading = self.reader(result, scene)
            seconds = time.process_time() - begun
        status = getattr(result, "status", None)
        failed = torch.zeros((), dtype=torch.bool) if status is None else status != 0
        if failed.ndim > len(self.reader.scene.batch_shape):
            failed = failed.any(0)
        counted = getattr(getattr(result, "stats", None), "iterations", None)
        iterations = None if counted is None else counted.double().sum(0).mean().item()
        return Trial(setting, reading, failed, seconds, iterations, result)

    def _solve(self, scene: Scene, setting: Setting, short: bool = False) -> Any:
        if self.t is None:
            if (result := self.solve(scene)) is None:
                raise ValueError("solve gave None; what `read` takes, as a state, is wanted")
            return result
        options = dict(self.options)
        if callable(initial := options.get("initial")):
            options["initial"] = initial(scene)
        t = self.t
        if short:
            t = t[0] + torch.stack((0 * t[0], t[0] * 0 + min(setting.step, (t[1] - t[0]).item())))
            options["inputs"] = {
                name: PerInterval(v.value[..., :1, :]) if isinstance(v, PerInterval) else v
                for name, v in (options.get("inputs") or {}).items()
            }
        return simulate(scene, t, **setting.steps, **options)
