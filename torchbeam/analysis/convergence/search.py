"""The search: errors of mesh and of step apart, from nested levels, and the cheapest pair of both.

A setting is run, and one with twice the elements, and one with half the step: what these change are
the errors that it is accepted by, each told at equal steps or on one mesh: where both would cancel
that is no accuracy. Errors fall by powers (`ErrorLaw`), so that the cost of what is fine enough can
be told before it is run. What was run serves again wherever it tells the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import takewhile

from ...dynamics.step_solver import mixes_ends
from ...nodal.discretise import discretise
from .law import ErrorLaw
from .setting import ELEMENTS, METHODS, Setting
from .trials import TrialRuns

SAFETY = 0.7  # share of the wanted error that a choice is predicted to have
# numbers of elements and of steps: 1, 2, 3, 4, 6, 8, 12, ...
LEVELS = sorted({k * 2**j for k in (1, 3) for j in range(24)} - {3 * 2**23})
# of the first setting: intervals between nodes at least, whose error is guessed by `GUESSED`
# intervals; steps at least
FIRST_INTERVALS, GUESSED, FIRST_STEPS = 4, 8, 32
CHECKS = 8  # choices that are checked, at most
REFUSALS = (ValueError, NotImplementedError)  # of an element or a method that a scene does not take
# error of the step by which a mesh's error is told, and of the mesh by which a step's is: what both
# have in common is of the order of their product
LOOSE = 0.05
CHEAPER = 0.5  # share of the cost that makes another check worth its while
CHECKING = 0.5  # share of the cost of what a choice is to be checked by that counts as its own
SINGLE = 20  # times the cost of steps that are made one by one


@dataclass
class Checked:
    """A choice, and the errors that its mesh and its step leave, as `levels` tell: pairs of
    settings, the second with twice the elements, or half the step, of the first.
    """

    setting: Setting
    space: float
    time: float
    levels: tuple[tuple[Setting, Setting], ...]

    @property
    def error(self) -> float:
        return self.space + self.time


@dataclass
class Search:
    """A search for the cheapest setting whose error is `rtol` at most.

    base      numbers of elements are multiples of it
    interval  s, the shortest of the output's, of which a step is a whole part
    elements, methods  that are tried, by name; refused: sentences of those that are not possible
    most      elements and steps at most
    failed    by how many elements, or steps, and fewer, runs fail
    space, time  laws of the errors, by the name of an element and of a method, that were measured
    """

    trials: TrialRuns
    rtol: float
    base: int
    interval: float | None
    elements: list[str]
    methods: list[str]
    most: tuple[int, int]
    refused: dict[str, str] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    space: dict[str, ErrorLaw] = field(default_factory=dict)
    time: dict[str, ErrorLaw] = field(default_factory=dict)
    checked: list[Checked] = field(default_factory=list)

    def run(self) -> Checked:
        """The setting accepted; where there is none the best that was checked."""
        accepted: list[Checked] = []
        choice = self._first()
        for _ in range(CHECKS):
            check = self._check(choice)
            if check is not None and check.error <= self.rtol:
                accepted.append(check)
            elif accepted:
                break
            choice = self._choice() if self.checked else self._first()
            if choice is None or len(accepted) > 1:
                break
            if accepted:
                if self.trials.cost(choice) > CHEAPER * self.trials.cost(accepted[0].setting):
                    break
        if accepted:
            return min(accepted, key=lambda c: self.trials.cost(c.setting))
        finest = self._finest()
        if finest is not None:
            self._check(finest)
        return min(self.checked, key=lambda c: c.error)

    # fineness of steps is their number over all instants

    def step_lengths(self) -> list[float]:
        """Steps that are whole parts of the shortest interval, from long to short."""
        parts = (float(f"{self.interval / parts:.9g}") for parts in LEVELS)
        lengths = takewhile(lambda h: self.trials.step_count(h) <= self.most[1], parts)
        return list(lengths) or [self.interval]

    def element_counts(self) -> list[int]:
        """Multiples of `base`."""
        return [self.base * n for n in LEVELS if self.base * n <= self.most[0]] or [self.base]

    def settings(self) -> Iterator[Setting]:
        """All that may be chosen."""
        for element in self.elements:
            for count in self._counts(element):
                yield from (replace(s, elements=count) for s in self._steps(element))

    def _counts(self, element: str) -> list[int]:
        return [n for n in self.element_counts() if n * ELEMENTS[element].order > 1]

    def _steps(self, element: str) -> list[Setting]:
        """Of all methods and lengths, the longest first; one of none in statics."""
        steps = [(m, h) for m in self.methods for h in self.step_lengths()] or [(None, None)]
        return [Setting(element, self.base, *step) for step in steps]

    def error(self, setting: Setting) -> float:
        """As the laws predict it."""
        return self._space_error(setting) + self._time_error(setting)

    def _time_error(self, setting: Setting) -> float:
        """As the method's law predicts it, or that of another one: errors are c (omega h)^p."""
        name = setting.method
        if name is None:
            return 0.0
        steps = self.trials.step_count(setting.step)
        if steps <= self.failed.get(name, 0):
            return math.inf
        if name in self.time:
            return self.time[name].predicted(steps)
        kind = METHODS[name]
        guesses = [
            kind.factor
            * (law.predicted(steps) / METHODS[other].factor) ** (kind.rate / METHODS[other].rate)
            for other, law in self.time.items()
        ]
        return min(guesses, default=0.0)

    def _space_error(self, setting: Setting) -> float:
        """As the element's law predicts it, or a guess, by how far off that of another one is."""
        name, count = setting.element, setting.elements
        if count <= self.failed.get(name, 0):
            return math.inf
        if name in self.space:
            return self.space[name].predicted(count)
        off = [
            law.predicted(finest) / guess(other, finest)
            for other, law in self.space.items()
            for finest in [max(law.changes)]
        ]
        return guess(name, count) * max(off, default=1.0)

    def _first(self) -> Setting:
        """The cheapest mesh that is guessed to do, by the longest steps, which are not guessed."""
        method = min(self.methods, key=lambda m: METHODS[m].cost, default=None)
        step = None
        if method is not None:
            lengths = self.step_lengths()
            step = next(
                (h for h in lengths if self.trials.step_count(h) >= FIRST_STEPS), lengths[-1]
            )
        meshes = [
            Setting(element, count, method, step)
            for element in self.elements
            for count in self.element_counts()
        ]
        enough = [
            s
            for s in meshes
            if s.intervals >= FIRST_INTERVALS and self._space_error(s) <= SAFETY * self.rtol / 2
        ]
        return min(enough, key=self.trials.work, default=min(meshes, key=self._space_error))

    def _choice(self) -> Setting | None:
        """The cheapest setting that is predicted to do; None = there is none, or no time for it."""
        choice = min(self._good_enough(), key=self._cost, default=None)
        return choice if choice is not None and self._checkable(choice) else None

    def _good_enough(self) -> Iterator[Setting]:
        """Settings whose predicted error is allowed, of each element and method those of which no
        other has fewer elements and no shorter steps.
        """
        checked = {check.setting for check in self.checked}
        steps = {(s.method, s.step): self._time_error(s) for s in self._steps(self.elements[0])}
        for element in self.elements:
            longest = dict.fromkeys(self.methods or [None], 0.0)
            for count in self._counts(element):
                error = self._space_error(Setting(element, count))
                for (method, step), of_step in steps.items():
                    setting = Setting(element, count, method, step)
                    if (
                        (step or 1.0) > longest[method]
                        and error + of_step <= self._allowed(setting)
                        and setting not in checked
                    ):
                        longest[method] = step or 1.0
                        yield setting

    def _allowed(self, setting: Setting) -> float:
        """Error that a choice may have: all that is wanted where both parts were measured."""
        known = setting.element in self.space and (
            setting.elements in self.space[setting.element].changes
        )
        if known and setting.method is not None:
            steps = self.trials.step_count(setting.step)
            known = setting.method in self.time and steps in self.time[setting.method].changes
        return self.rtol if known else SAFETY * self.rtol

    def _cost(self, setting: Setting) -> float:
        """CPU seconds of a setting, and a share of those of what checks it."""
        untried = setting.method == "midpoint4" and "midpoint4" not in self.time
        cost = self.trials.cost(setting) * (SINGLE if untried and self._single else 1)
        more = [fine for fine in finer(setting) if fine and not self._known_by(setting, fine)]
        return cost + CHECKING * sum(map(self.trials.cost, more))

    def _finest(self) -> Setting | None:
        """Of all that there is time to check the one of the least predicted error, where that is
        less than what was reached.
        """
        reached = min((check.error for check in self.checked), default=math.inf)
        better = [s for s in self.settings() if self.error(s) < reached / 2]
        return min(filter(self._checkable, better), key=self.error, default=None)

    def _checkable(self, setting: Setting) -> bool:
        return self.trials.allowed(setting, *(s for s in finer(setting) if s is not None))

    @cached_property
    def _single(self) -> bool:
        """Whether steps of several compositions are made one by one."""
        scene = self.trials.scene(next(iter(self.trials.made)))
        return scene.damping is not None and not mixes_ends(discretise(scene))

    def _check(self, choice: Setting) -> Checked | None:
        """By twice the elements, and by half the step; the laws then know better. None where the
        scene does not take the element or the method, which is not chosen again.
        """
        mesh, steps = finer(choice)
        try:
            if self.trials.difference(choice, choice) > 0:
                self._fails(choice, choice)
                levels = []
            else:
                levels = [self._level(choice, fine) for fine in (mesh, steps) if fine is not None]
        except REFUSALS as error:
            self._refuse(choice, error)
            return None
        changes = [self.trials.difference(*level) for level in levels]
        space = time = math.inf
        if changes and changes[0] < math.inf:
            kind = ELEMENTS[choice.element]
            law = self.space.setdefault(choice.element, ErrorLaw(kind.rate, kind.expected))
            law.changes[choice.elements] = changes[0]
            space = law.error(choice.elements)
        if steps is None:
            time = 0.0
        elif changes and changes[1] < math.inf:
            method, count = METHODS[choice.method], self.trials.step_count(choice.step)
            law = self.time.setdefault(choice.method, ErrorLaw(method.rate, method.expected))
            law.changes[count] = changes[1]
            time = law.error(count)
        self.checked.append(Checked(choice, space, time, tuple(levels)))
        return self.checked[-1]

    def _level(self, setting: Setting, fine: Setting) -> tuple[Setting, Setting]:
        """Two settings whose difference tells what one changes that is as fine twice as fine."""
        known = self._known_by(setting, fine)
        if known is not None:
            return known
        if self.trials.difference(fine, fine) > 0:
            self._fails(setting, fine)
        return setting, fine

    def _known_by(self, setting: Setting, fine: Setting) -> tuple[Setting, Setting] | None:
        """The same of those that were run: by themselves, other steps or meshes of small error."""
        made = self.trials.made
        if fine in made:
            return setting, fine
        pairs = []
        for trial in made:
            if fine.step == setting.step:
                like = (trial.element, trial.elements) == (setting.element, setting.elements)
                other, error = replace(trial, elements=fine.elements), self._time_error
            else:
                like = (trial.method, trial.step) == (setting.method, setting.step)
                other, error = replace(trial, step=fine.step), self._space_error
            if like and other in made and self.trials.difference(trial, other) < math.inf:
                pairs.append((error(trial), trial, other))
        error, *pair = min(pairs, key=lambda pair: pair[0], default=(math.inf,))
        return tuple(pair) if error <= LOOSE else None

    def _fails(self, setting: Setting, run: Setting) -> None:
        """A run has failed: of the setting, or of one that was to check it. Other choices have at
        least twice the elements, or half the step.
        """
        checking = run != setting
        if run.method is None or not checking:
            self.failed[run.element] = 2 * setting.elements - 1 + checking
        if run.method is not None:
            self.failed[run.method] = 2 * self.trials.step_count(setting.step) - 1 + checking

    def _refuse(self, choice: Setting, error: Exception) -> None:
        """Without an element, or a method, that the scene does not take."""
        ran = any(s.element == choice.element for s in self.trials.made)
        by_method = choice.method is not None and (ran or len(self.elements) == 1)
        names, name = (
            (self.methods, choice.method) if by_method else (self.elements, choice.element)
        )
        names.remove(name)
        self.refused[name] = str(error).splitlines()[0]
        if not names:
            raise error


def guess(element: str, count: int) -> float:
    """The error of a mesh, as soft rods have it."""
    kind = ELEMENTS[element]
    return kind.guess * (GUESSED / (count * kind.order)) ** kind.expected


def finer(setting: Setting) -> tuple[Setting, Setting | None]:
    """Levels by which a setting is checked: twice the elements, half the step (None in statics)."""
    return (
        replace(setting, elements=2 * setting.elements),
        None if setting.step is None else replace(setting, step=setting.step / 2),
    )
