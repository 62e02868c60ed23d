"""Trial runs: a scene solved by settings, each once, with what it gave and took."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.derivatives import no_derivatives
from ...dynamics.simulate import simulate
from ...engine.compiler.library import Library
from ...scene.scene import Scene
from .reading import Reader
from .setting import ELEMENTS, METHODS, Setting

END = 4  # nodes that a step of a beam without any would cost as much as, see `TrialRuns.work`
SPAN = 1e-6  # of a step: how much longer an interval may be than a whole number of them


@dataclass(frozen=True)
class TrialRun:
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
class TrialRuns:
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
    made: dict[Setting, TrialRun] = field(default_factory=dict)
    counts: dict[float, int] = field(default_factory=dict)  # of steps, by their length
    setup: float = 0.0  # CPU s of a run without steps, as these runs tell
    scenes: dict[tuple[str, int], Scene] = field(default_factory=dict)  # by their meshes
    in_time: bool | None = None  # whether readings are histories, if their shape is that of one

    def __call__(self, setting: Setting) -> TrialRun:
        if setting not in self.made:
            if self.report is not None:
                self.report(len(self.made), setting)
            self.made[setting] = self._run(setting)
            self.setup = self._setup()
        return self.made[setting]

    def scene(self, setting: Setting) -> Scene:
        """On a setting's mesh."""
        mesh = setting.element, setting.elements
        if mesh not in self.scenes:
            self.scenes[mesh] = self.mesh(setting)
        return self.scenes[mesh]

    def difference(self, setting: Setting, reference: Setting) -> float:
        """The relative error that `share` of the samples do not exceed; inf where a run failed."""
        return self.apart(self(setting), self(reference))

    def apart(self, trial: TrialRun, reference: TrialRun) -> float:
        """The same of two trials."""
        count = len(self.t) if self.in_time else None
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
        whatever their number, by what elements and methods usually cost.
        """
        kind = ELEMENTS[setting.element].cost
        if setting.method is not None:
            kind *= METHODS[setting.method].cost
        return kind * self.step_count(setting.step) * (setting.intervals + END)

    def cost(self, setting: Setting) -> float:
        """CPU seconds of a setting: measured, or predicted from the trials of its element and
        method, else of its method, else of all: what setting up takes, and a rate.
        """
        if setting in self.made:
            return self.made[setting].seconds
        if not self.made:
            return self.work(setting)
        made = [*self.made.values()]
        like = [
            [trial for trial in made if trial.setting.method == setting.method],
            [trial for trial in made if trial.setting.element == setting.element],
        ]
        both = [trial for trial in like[0] if trial in like[1]]
        nearest = max(both or like[0] or made, key=lambda trial: self.work(trial.setting))
        rate = max(nearest.seconds - self.setup, 1e-2 * self.setup) / self.work(nearest.setting)
        return self.setup + rate * self.work(setting)

    def _setup(self) -> float:
        """CPU seconds of a run without steps, by those of one kind whose work differs most."""
        span, setup = 1.0, 0.0
        kinds: dict[tuple, list[tuple[float, float]]] = {}
        for trial in self.made.values():
            kind = kinds.setdefault((trial.setting.element, trial.setting.method), [])
            kind.append((self.work(trial.setting), trial.seconds))
        for kind in kinds.values():
            (w, s), (v, r) = min(kind), max(kind)
            if v > span * w:
                rate = min(max((r - s) / (v - w), 0.0), s / w)
                span, setup = v / w, s - rate * w
        return setup

    def allowed(self, *settings: Setting) -> bool:
        """Whether there is time for these, as predicted."""
        if not self.made:
            return True
        spent = sum(trial.seconds for trial in self.made.values())
        more = sum(self.cost(s) for s in settings if s not in self.made)
        return spent + more <= self.seconds

    def _run(self, setting: Setting) -> TrialRun:
        with no_derivatives(), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of samples that failed
            # the second time where the first one compiled, or was the first of all
            for _ in range(2):
                # a copy is prepared for anew, so that times tell what a first call takes
                scene, known = copy(self.scene(setting)), Library.count
                begun = time.process_time()
                result = self._solve(scene, setting)
                reading = self.reader(result, scene)
                seconds = time.process_time() - begun
                if Library.count == known and self.made:
                    break
        if self.in_time is None:
            self.in_time = self.t is not None and self.reader.in_time(reading, result, scene)
        status = getattr(result, "status", None)
        failed = torch.zeros((), dtype=torch.bool) if status is None else status != 0
        if failed.ndim > len(self.reader.scene.batch_shape):
            failed = failed.any(0)
        counted = getattr(getattr(result, "stats", None), "iterations", None)
        iterations = None if counted is None else counted.double().sum(0).mean().item()
        return TrialRun(setting, reading, failed, seconds, iterations, result)

    def _solve(self, scene: Scene, setting: Setting) -> Any:
        if self.t is None:
            if (result := self.solve(scene)) is None:
                raise ValueError("solve gave None; what `read` takes, as a state, is wanted")
            return result
        options = dict(self.options)
        if callable(initial := options.get("initial")):
            options["initial"] = initial(scene)
        return simulate(scene, self.t, **setting.steps, **options)
