"""The search: errors of mesh and of step apart, from nested levels, and the cheapest pair of both.

What a mesh is off by is told at equal steps and what a step is off by on one mesh, against the
finest level: where both would cancel that is no accuracy. Each falls by a power (`Law`), so that
the cost of what is fine enough can be told before it is run. What is chosen is then run with twice
the elements, and with half the step: what these change is the error that it is accepted by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import takewhile

from .law import Law, observed_order, remaining
from .setting import ELEMENTS, METHODS, Setting
from .trials import Trials

SAFETY = 0.7  # share of the wanted error that a choice is predicted to have
# numbers of elements and of steps: 1, 2, 3, 4, 6, 8, 12, ...
LEVELS = sorted({k * 2**j for k in (1, 3) for j in range(24)} - {3 * 2**23})
FIRST_INTERVALS, FIRST_STEPS = 4, 32
# of the seconds that all runs may take: how much until errors of steps, and of meshes, are known
STEPS_PART, MESHES_PART = 0.2, 0.5
CHECKS = 8  # choices that are checked, at most
REFUSALS = (ValueError, NotImplementedError)  # of an element or a method that a scene does not take
DEAR = 16  # times the cheapest steps' time: midpoint4's cost five times midpoint's where native
CHEAPER = 0.6  # share of the cost that makes another check worth its while


@dataclass
class Checked:
    """A choice, and the errors that its mesh and its step leave, as twice the elements and half the
    step tell.
    """

    setting: Setting
    space: float
    time: float

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
    observed  orders, by the name of an element or a method; None = told by fewer than three levels
    """

    trials: Trials
    rtol: float
    base: int
    interval: float | None
    elements: list[str]
    methods: list[str]
    most: tuple[int, int]
    refused: dict[str, str] = field(default_factory=dict)
    space: dict[str, Law] = field(default_factory=dict)
    time: dict[str, Law] = field(default_factory=dict)
    checked: list[Checked] = field(default_factory=list)
    observed: dict[str, float | None] = field(default_factory=dict)

    def run(self) -> Checked:
        """The setting accepted; where there is none the best that was checked."""
        steps = self._first_steps()
        if self.methods:
            self._measure_steps(steps)
        self._measure_meshes()
        accepted: list[Checked] = []
        for _ in range(CHECKS):
            choice = self._choice()
            if choice is None or any(c.setting == choice for c in self.checked):
                break
            if accepted and (
                len(accepted) > 1
                or self.trials.cost(choice) > CHEAPER * self.trials.cost(accepted[0].setting)
            ):
                break
            check = self._check(choice)
            self.checked.append(check)
            if check.error <= self.rtol:
                accepted.append(check)
            elif accepted:
                break
        if accepted:
            return min(accepted, key=lambda c: self.trials.cost(c.setting))
        if not self.checked:
            self.checked.append(self._check(self._finest()))
        return min(self.checked, key=lambda c: c.error)

    # fineness of steps is their number over all instants

    def step_lengths(self) -> list[float]:
        """Steps that are whole parts of the shortest interval, from long to short."""
        parts = (float(f"{self.interval / parts:.9g}") for parts in LEVELS)
        return list(takewhile(lambda h: self.trials.step_count(h) <= self.most[1], parts))

    def element_counts(self) -> list[int]:
        """Multiples of `base`."""
        return [self.base * n for n in LEVELS if self.base * n <= self.most[0]] or [self.base]

    def _first_steps(self) -> float | None:
        if not self.methods:
            return None
        steps = self.step_lengths() or [self.interval]
        return next((h for h in steps if self.trials.step_count(h) >= FIRST_STEPS), steps[-1])

    def _first_elements(self, element: str, intervals: int = FIRST_INTERVALS) -> int:
        counts = self.element_counts()
        order = ELEMENTS[element].order
        return next((n for n in counts if n * order >= intervals), counts[-1])

    def _measure_steps(self, step: float) -> None:
        """Errors of steps by each method, on one coarse mesh, against the finest of the best."""
        element = self._possible_element(step)
        mesh = self._first_elements(element)
        count = self.trials.step_count

        def at(method: str, h: float) -> Setting:
            return Setting(element, mesh, method, h)

        levels, methods = [step, step / 2], list(self.methods)
        while True:
            methods = self._not_dear([at(m, levels[-2]) for m in methods])
            best = max(methods, key=lambda m: METHODS[m])
            changes = [self.trials.difference(at(best, h), at(best, h / 2)) for h in levels[:-1]]
            law = Law(METHODS[best])
            for h, change in zip(levels, changes, strict=False):
                law.errors[count(h)] = remaining(change, law.trusted())
            self.observed[best] = observed_order(changes)
            left = law.predicted(count(levels[-1]))
            finer = [at(m, levels[-1] / 2) for m in methods]
            too_many = count(levels[-1] / 2) > self.most[1]
            if left <= self.rtol / 2 or too_many or not self._room(finer, STEPS_PART):
                break
            levels.append(levels[-1] / 2)
        for method in self.methods:
            self.time[method] = Law(METHODS[method])
            for h in levels[:-1]:
                if at(method, h) in self.trials.made:
                    error = self.trials.difference(at(method, h), at(best, levels[-1]))
                    self.time[method].errors[count(h)] = error
        self.time[best].errors[count(levels[-1])] = left

    def _room(self, settings: list[Setting], part: float) -> bool:
        return self.trials.allowed(*settings, part=part)

    def _not_dear(self, tried: list[Setting]) -> list[str]:
        """Methods whose steps, of one length, cost no more than `DEAR` times the cheapest's."""
        least = self.trials.least
        times = {s.method: max(self.trials(s).seconds - least, 0.1 * least) for s in tried}
        return [m for m, time in times.items() if time <= DEAR * min(times.values())]

    def _measure_meshes(self) -> None:
        """Errors of meshes of each element, by steps that are fine enough, against the finest of
        the best.
        """
        steps = self._fine_steps()

        def at(element: str, count: int) -> Setting:
            return Setting(element, count, *steps)

        while True:
            best = max(self.elements, key=lambda e: (ELEMENTS[e].rate, ELEMENTS[e].order))
            try:
                counts, law = self._mesh_levels(best, at)
                break
            except REFUSALS as error:
                self._drop(best, error)
        for element in list(self.elements):
            if element == best:
                self.space[element] = law
                continue
            count = self._first_elements(element, 2 * FIRST_INTERVALS)
            try:
                error = self.trials.difference(at(element, count), at(best, counts[-1]))
            except REFUSALS as refusal:
                self._drop(element, refusal)
                continue
            self.space[element] = Law(ELEMENTS[element].rate, {count: error})

    def _mesh_levels(
        self, element: str, at: Callable[[str, int], Setting]
    ) -> tuple[list[int], Law]:
        """Nested meshes of an element, until the finest is good enough, and its errors."""
        counts, law = [self._first_elements(element)], Law(ELEMENTS[element].rate)
        changes: list[float] = []
        while True:
            counts.append(2 * counts[-1])
            change = self.trials.difference(at(element, counts[-2]), at(element, counts[-1]))
            law.errors[counts[-2]] = remaining(change, law.trusted())
            changes.append(change)
            self.observed[element] = observed_order(changes)
            left = law.predicted(counts[-1])
            too_many = 2 * counts[-1] > self.most[0]
            room = self._room([at(element, 2 * counts[-1])], MESHES_PART)
            if left <= self.rtol / 2 or too_many or not room:
                law.errors[counts[-1]] = left
                return counts, law

    def _drop(self, element: str, error: Exception) -> None:
        """Without an element that the scene does not take."""
        self.elements.remove(element)
        self.space.pop(element, None)
        self.refused[element] = str(error).splitlines()[0]
        if not self.elements:
            raise error

    def _possible_element(self, step: float) -> str:
        """The first element by which the scene runs."""
        while True:
            element = self.elements[0]
            try:
                self.trials(Setting(element, self._first_elements(element), self.methods[0], step))
                return element
            except REFUSALS as error:
                self._drop(element, error)

    def _fine_steps(self) -> tuple[str, float] | tuple[()]:
        """The cheapest method and step whose error does not hide that of meshes, which are told
        at equal steps.
        """
        if not self.methods:
            return ()
        element = self.elements[0]
        mesh = self._first_elements(element)
        pairs = [Setting(element, mesh, m, h) for m in self.methods for h in self.step_lengths()]
        enough = [s for s in pairs if self._time_error(s) <= 2 * self.rtol]
        if enough:
            chosen = min(enough, key=self.trials.cost)
        else:
            chosen = min(pairs, key=self._time_error)
        return chosen.method, chosen.step

    def _time_error(self, setting: Setting) -> float:
        if setting.method is None:
            return 0.0
        return self.time[setting.method].predicted(self.trials.step_count(setting.step))

    def _space_error(self, setting: Setting) -> float:
        return self.space[setting.element].predicted(setting.elements)

    def settings(self) -> Iterator[Setting]:
        """All that may be chosen."""
        steps = [(m, h) for m in self.methods for h in self.step_lengths()] or [(None, None)]
        for element in self.elements:
            for count in self.element_counts():
                if count * ELEMENTS[element].order > 1:
                    yield from (Setting(element, count, *step) for step in steps)

    def _choice(self) -> Setting | None:
        """The cheapest setting that is predicted to be good enough; None where there is none, or no
        time to check it.
        """
        enough = [s for s in self.settings() if self.error(s) <= SAFETY * self.rtol]
        choice = min(enough, key=self.trials.cost, default=None)
        return choice if choice is not None and self._checkable(choice) else None

    def _finest(self) -> Setting:
        """Of all that there is time to check the one of the least predicted error."""
        all_ = list(self.settings())
        return min(
            filter(self._checkable, all_), key=self.error, default=min(all_, key=self.trials.cost)
        )

    def error(self, setting: Setting) -> float:
        """As the laws predict it."""
        return self._space_error(setting) + self._time_error(setting)

    def _checkable(self, setting: Setting) -> bool:
        return self.trials.allowed(setting, *(s for s in finer(setting) if s is not None))

    def _check(self, choice: Setting) -> Checked:
        """By twice the elements, and by half the step; the laws then know better."""
        finer_mesh, finer_steps = finer(choice)
        change = self.trials.difference(choice, finer_mesh)
        space = self._told(self.space, choice.element, choice.elements, change)
        if finer_steps is None:
            return Checked(choice, space, 0.0)
        change = self.trials.difference(choice, finer_steps)
        steps = self.trials.step_count(choice.step)
        return Checked(choice, space, self._told(self.time, choice.method, steps, change))

    @staticmethod
    def _told(laws: dict[str, Law], name: str, fineness: float, change: float) -> float:
        """The error that a change by a finer level tells of, by an order of 1 to 2, so that it is
        not told too small where the order is less than it was. All laws of the kind are scaled
        where it is more than was expected, that of the name at any rate.
        """
        law = laws[name]
        order = min(max(law.trusted(), 1.0), 2.0)
        error, expected = remaining(change, order), law.predicted(fineness)
        if error == math.inf:
            law.errors[fineness] = math.inf
            return error
        ratio = error / expected if 0 < expected < math.inf else 1.0
        for other, of_other in laws.items():
            if other == name or ratio > 1:
                of_other.scale(ratio)
        law.errors = {n: e for n, e in law.errors.items() if not fineness <= n <= 2 * fineness}
        law.errors |= {fineness: error, 2 * fineness: error * 2**-order}
        return error


def finer(setting: Setting) -> tuple[Setting, Setting | None]:
    """The levels by which a setting is checked: of twice the elements, and of half the step (None
    in statics).
    """
    return (
        replace(setting, elements=2 * setting.elements),
        None if setting.step is None else replace(setting, step=setting.step / 2),
    )
